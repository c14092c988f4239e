// A question that somebody must answer before anything happens.

import { element } from "./dom.js";

// Whether somebody said yes. `dialog`: a <dialog> of class "ask"; `more`: what else stands in it.
export function question(dialog, words, yes, no, ...more) {
  return new Promise((resolve) => {
    const button = (text, value, kind) => element("button", { type: "button", class: kind, onclick: () => dialog.close(value) }, text);
    dialog.replaceChildren(element("p", {}, words), ...more, element("div", { class: "orders" }, button(no, "no", ""), button(yes, "yes", "primary")));
    dialog.returnValue = "no";
    dialog.addEventListener("close", () => resolve(dialog.returnValue === "yes"), { once: true });
    dialog.showModal();
  });
}
