// Parts of a form that have a place for what the API did not like about them.

import { element } from "./dom.js";

// Where words about something without an input stand.
export function slot(name) {
  return element("p", { class: "problem standing", role: "alert", "data-for": name, hidden: true });
}

// A labelled input and the place for what is wrong with it.
export function field(label, name, input, unit = "") {
  const problem = element("span", { class: "problem", role: "alert", "data-for": name, hidden: true });
  return element("label", { class: "field" }, element("span", { class: "label" }, label), input,
    unit ? element("span", { class: "unit" }, unit) : null, problem);
}
