// A form of one line: labelled inputs and the button that sends them.

import { element } from "./dom.js";

// `inputs`: {name: [label, input]}, or [null, element] for what has labels of its own; `send(values)` gets the values by name; returns the form.
export function formRow(inputs, words, send) {
  return element("form", { class: "controls", onsubmit: (event) => {
    event.preventDefault();
    const valueOf = (input) => (input.type === "password" ? input.value : input.value?.trim());
    send(Object.fromEntries(Object.entries(inputs).map(([name, [, input]]) => [name, valueOf(input)])));
  } }, ...Object.values(inputs).map(([label, input]) => (label === null ? input : element("label", {}, label, input))),
  element("button", { type: "submit", class: "primary" }, words));
}

export function textInput(attributes = {}) {
  return element("input", { type: "text", autocomplete: "off", maxlength: "200", required: true, ...attributes });
}

export function orderButton(words, label, act, kind = "") {
  return element("button", { type: "button", class: kind, "aria-label": label, onclick: act }, words);
}
