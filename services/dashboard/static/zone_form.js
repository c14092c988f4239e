// The form of one zone or exhibit: its name, its corners as numbers, its rules or what it is looked at from; and what the API did not like, where it belongs.

import { element } from "./dom.js";
import { field, slot } from "./fields.js";
import { numberInput, ruleForm, newRule } from "./zone_rules.js";
import { areaOf, lengthOf, whatIsWrong } from "./zone_geometry.js";

const NEW = { area: "New area", line: "New line", point: "New exhibit" };
const TOLD = {
  area: (points) => `${points.length} corners, ${areaOf(points).toFixed(1)} m²`,
  line: (points) => `${points.length} corners, ${lengthOf(points).toFixed(1)} m long`,
  point: ([[x, y]]) => `At ${x}, ${y} m`,
};

export class ZoneForm {
  #form;
  #hooks;
  #draft = null;
  #refusal = null;
  readOnly = false; // shown, and nothing of it can be changed

  // `hooks`: changed(), save(), discard(), remove(), corner(index), insertAfter(index), removeCorner(index).
  constructor(form, hooks) {
    this.#form = form;
    this.#hooks = hooks;
  }

  // Build it anew for a draft, or hide it.
  show(draft, refusal = null) {
    this.#draft = draft;
    this.#refusal = refusal;
    this.#form.hidden = draft === null;
    if (draft === null) {
      this.#form.replaceChildren();
      return;
    }
    this.#form.inert = this.readOnly;
    const focused = document.activeElement?.id;
    this.#form.replaceChildren(...this.#parts());
    this.refresh();
    this.#place(refusal);
    if (focused) document.getElementById(focused)?.focus({ preventScroll: true });
  }

  // Numbers and buttons follow what is drawn; what somebody types in stays as it is.
  refresh() {
    if (this.#draft === null) return;
    const { points, shape } = this.#draft.zone;
    const inputs = [...this.#form.querySelectorAll(".corners input")];
    if (inputs.length !== 2 * points.length) {
      this.show(this.#draft, this.#refusal);
      return;
    }
    points.flat().forEach((value, i) => {
      if (inputs[i] !== document.activeElement) inputs[i].value = String(value);
    });
    const wrong = whatIsWrong(points, shape);
    const words = this.#form.querySelector(".size");
    words.textContent = wrong || TOLD[shape](points);
    words.classList.toggle("problem", wrong !== "");
    if (this.readOnly) return;
    const save = this.#form.querySelector(".save");
    save.disabled = wrong !== "" || !this.#draft.changed;
    this.#form.querySelector(".discard").disabled = !this.#draft.changed;
  }

  // Whether all fields hold what they may; the first that does not is told, and in focus.
  check() {
    for (const input of this.#form.querySelectorAll("input")) {
      const { badInput, patternMismatch, rangeOverflow, rangeUnderflow, valueMissing } = input.validity;
      const wrong = badInput || patternMismatch || rangeOverflow || rangeUnderflow || valueMissing;
      const problem = input.closest(".field")?.querySelector(".problem");
      if (!wrong || !problem) continue;
      problem.textContent = patternMismatch ? input.title : input.validationMessage;
      problem.hidden = false;
      input.setAttribute("aria-invalid", "true");
      input.closest("details")?.setAttribute("open", "");
      input.focus();
      return false;
    }
    return true;
  }

  #parts() {
    const draft = this.#draft;
    const { zone } = draft;
    const button = (words, act, kind = "") => element("button", { type: "button", class: kind, onclick: act }, words);
    const name = field("Name", "name", element("input", {
      id: "zone-name", type: "text", maxlength: "200", value: zone.name, autocomplete: "off",
      oninput: (event) => this.#change((now) => (now.name = event.target.value), "name"),
    }));
    const id = field("Id", "id", element("input", {
      id: "zone-id", type: "text", maxlength: "64", value: zone.id, autocomplete: "off", readonly: draft.fresh ? null : "",
      required: true, pattern: "[A-Za-z0-9][A-Za-z0-9_.\\-]*", title: "Letters, digits, . _ and -; stays as it is once saved",
      oninput: (event) => this.#change((now) => (now.id = event.target.value), "id"),
    }));
    return [
      element("h2", {}, draft.fresh ? NEW[zone.shape] : zone.name || zone.id),
      element("p", { class: "problem general", role: "alert", hidden: true }),
      name,
      id,
      slot("floor"), slot("shape"),
      element("p", { class: "size", role: "status" }),
      slot("points"),
      this.#corners(zone),
      zone.shape === "line" ? element("div", { class: "orders" }, button("Turn the arrow round", () => {
        this.#change((now) => now.points.reverse());
        this.show(draft);
      })) : null,
      ...(zone.shape === "point" ? this.#looking(zone) : [this.#rules(zone)]),
      this.readOnly ? null : element("div", { class: "orders" },
        button("Save", () => this.#hooks.save(), "save primary"),
        button("Discard changes", () => this.#hooks.discard(), "discard"),
        draft.fresh ? null : button(zone.shape === "point" ? "Delete exhibit…" : "Delete zone…", () => this.#hooks.remove(), "danger")),
    ].filter((part) => part !== null);
  }

  #looking(zone) {
    const number = (name, unset, least, most, step) => numberInput(`zone-${name}`, zone[name], step,
      (value) => this.#change((now) => (now[name] = value ?? unset), name), least, most);
    const facing = number("facing", null, "-360", "360", "1");
    facing.required = false;
    facing.placeholder = "none";
    return [
      field("Looked at from", "reach", number("reach", null, "0.1", "100", "0.1"), "metres at most"),
      field("Its front looks", "facing", facing, "° from x to y"),
    ];
  }

  #corners(zone) {
    const fixed = zone.shape === "point";
    const rows = zone.points.map((point, i) => element("li", {},
      element("span", {}, `${i + 1}`),
      ...["x", "y"].map((axis, j) => element("input", {
        type: "number", step: "0.1", value: String(point[j]), "aria-label": `Corner ${i + 1}, ${axis}, metres`, id: `corner-${i}-${axis}`,
        onfocus: () => this.#hooks.corner(i),
        oninput: (event) => {
          const value = event.target.valueAsNumber;
          if (Number.isFinite(value)) this.#change((now) => (now.points[i][j] = value), `corner ${i} ${axis}`);
        },
      })),
      fixed ? null : element("button", { type: "button", "aria-label": `Insert a corner after corner ${i + 1}`, title: "Insert a corner after this one", onclick: () => this.#hooks.insertAfter(i) }, "+"),
      fixed ? null : element("button", { type: "button", "aria-label": `Delete corner ${i + 1}`, title: "Delete this corner", onclick: () => this.#hooks.removeCorner(i) }, "✕"),
    ));
    const open = this.#form.querySelector("details.corners")?.open ?? false;
    return element("details", { class: "corners", open }, element("summary", {}, fixed ? "Its place as numbers (x, y in metres)" : "Corners as numbers (x, y in metres)"),
      element("ol", {}, ...rows));
  }

  #rules(zone) {
    const rows = zone.rules.map((rule, i) => ruleForm(rule, i, zone.shape, (act, label, rebuild) => {
      this.#change((now) => act(now.rules[i]), label);
      if (rebuild) this.show(this.#draft);
    }, () => {
      this.#change((now) => now.rules.splice(i, 1));
      this.show(this.#draft);
    }));
    const add = element("button", { type: "button", id: "zone-add-rule", onclick: () => {
      this.#change((now) => now.rules.push(newRule(now)));
      this.show(this.#draft);
      document.getElementById(`rule-${zone.rules.length - 1}-kind`)?.focus();
    } }, "Add a rule");
    return element("fieldset", { class: "rules" },
      element("legend", {}, "What is told"),
      zone.rules.length === 0 ? element("p", { class: "empty" }, "Nothing yet: add a rule.") : null,
      ...rows, element("div", { class: "orders" }, add), slot("rules"));
  }

  #change(act, label = null) {
    this.#draft.change(act, label);
    this.#hooks.changed();
    this.refresh();
  }

  // Put what the API says to the field it names, or on top.
  #place(refusal) {
    if (refusal === null) return;
    const slots = [...this.#form.querySelectorAll("[data-for]")];
    const fitting = slots
      .filter((one) => refusal.field !== null && (refusal.field === one.dataset.for || refusal.field.startsWith(`${one.dataset.for}.`)
        || refusal.field.startsWith(`${one.dataset.for}[`)))
      .sort((a, b) => b.dataset.for.length - a.dataset.for.length)[0];
    const shown = fitting ?? this.#form.querySelector(".general");
    shown.textContent = refusal.message;
    shown.hidden = false;
    const input = fitting?.parentElement.querySelector("input, select");
    if (fitting && input && !fitting.classList.contains("standing")) {
      input.setAttribute("aria-invalid", "true");
      fitting.closest("details")?.setAttribute("open", "");
      input.focus();
    } else shown.scrollIntoView({ block: "nearest" });
  }
}
