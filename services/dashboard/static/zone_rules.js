// One rule of a zone as a form: what is told, of whom, when, and from which limit on.

import { KINDS } from "./alert_words.js";
import { element } from "./dom.js";
import { field } from "./fields.js";
import { idFor } from "./zone_draft.js";

const OF = { area: ["enter", "exit", "dwell", "crowd", "proximity", "speed"], line: ["cross"] };
const WORDS = {
  enter: "Somebody enters",
  exit: "Somebody leaves",
  dwell: "Somebody stays too long",
  cross: "Somebody crosses the line",
  crowd: "Too many people are inside",
  proximity: "People come too close",
  speed: "Somebody is too fast",
};
const LIMITS = {
  dwell: { label: "Longer than", unit: "seconds", first: 300, step: "1" },
  crowd: { label: "More than", unit: "people", first: 20, step: "1" },
  proximity: { label: "Closer than", unit: "metres", first: 2, step: "0.1" },
  speed: { label: "Faster than", unit: "m/s", first: 2.5, step: "0.1" },
};
const DIRECTIONS = { both: "In both directions", forward: "Forward, as the arrow points", backward: "Backward, against the arrow" };
const AUDIENCES = { everybody: "Everybody", phones: "People with a located phone", anonymous: "People without one" };
const DAYS = ["Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun"];
const OFFICE = { days: [0, 1, 2, 3, 4, 5, 6], since: "18:00", until: "09:00" };

export function newRule(zone) {
  const kind = OF[zone.shape].find((one) => zone.rules.every((rule) => rule.kind !== one)) ?? OF[zone.shape][0];
  return limited({ id: idFor(kind, zone.rules.map((rule) => rule.id)), kind });
}

// `change(act(rule), label, rebuild)`; `remove()`.
export function ruleForm(rule, number, shape, change, remove) {
  const at = `rules[${number}]`;
  const id = (name) => `rule-${number}-${name}`;
  const kinds = OF[shape].includes(rule.kind) ? OF[shape] : [...OF[shape], rule.kind];
  const rows = [
    field("Tell when", `${at}.kind`, choice(id("kind"), kinds.map((kind) => [kind, WORDS[kind] ?? KINDS[kind]]), rule.kind,
      (kind) => change((now) => limited(Object.assign(now, { kind, limit: null })), null, true))),
  ];
  const limit = LIMITS[rule.kind];
  if (limit !== undefined) {
    rows.push(field(limit.label, `${at}.limit`, numberInput(id("limit"), rule.limit, limit.step,
      (value) => change((now) => (now.limit = value), `${at}.limit`), limit.step), limit.unit));
  }
  if (rule.kind === "cross") {
    rows.push(field("Direction", `${at}.direction`, choice(id("direction"), Object.entries(DIRECTIONS), rule.direction ?? "both",
      (direction) => change((now) => (now.direction = direction)))));
  }
  if (rule.kind === "proximity") {
    rows.push(field("To the hazard", `${at}.target`, text(id("target"), rule.target ?? "", "A phone's id; empty: any two people", 64,
      (target) => change((now) => (now.target = target), `${at}.target`))));
  }
  rows.push(field("Of whom", `${at}.audience`, choice(id("audience"), Object.entries(AUDIENCES), rule.audience ?? "everybody",
    (audience) => change((now) => (now.audience = audience)))));
  const confidence = Math.round(100 * (rule.confidence ?? 0.5));
  const details = element("details", { class: "more", open: unusual(rule) },
    element("summary", {}, "When, which phones, how sure"),
    ...schedule(rule, at, id, change),
    field("Only the phones", `${at}.devices`, text(id("devices"), (rule.devices ?? []).join(", "), "Ids with commas; empty: all", null,
      (words) => change((now) => (now.devices = words.split(/[\s,]+/).filter((word) => word !== "")), `${at}.devices`))),
    field("At least sure by", `${at}.confidence`, numberInput(id("confidence"), confidence, "1",
      (value) => change((now) => (now.confidence = value === null ? 0.5 : value / 100), `${at}.confidence`), "50", "99"), "%"),
    field("Not again within", `${at}.quiet`, numberInput(id("quiet"), rule.quiet ?? 0, "1",
      (value) => change((now) => (now.quiet = value ?? 0), `${at}.quiet`), "0", "86400"), "seconds"),
    field("Rule's id", `${at}.id`, text(id("id"), rule.id, "", 64, (words) => change((now) => (now.id = words), `${at}.id`))));
  return element("div", { class: "rule", role: "group", "aria-label": `Rule ${number + 1}` }, ...rows, details,
    element("button", { type: "button", class: "danger", "aria-label": `Remove rule ${number + 1}`, onclick: remove }, "Remove this rule"));
}

function schedule(rule, at, id, change) {
  const always = rule.schedule === null || rule.schedule === undefined;
  const box = element("input", { type: "checkbox", id: id("scheduled"), checked: !always, onchange: (event) => {
    change((now) => (now.schedule = event.target.checked ? structuredClone(OFFICE) : null), null, true);
  } });
  const rows = [element("label", { class: "check" }, box, "Only at certain times (the site's own)")];
  if (always) return rows;
  const days = element("span", { class: "days", role: "group", "aria-label": "Days" }, ...DAYS.map((name, day) => element("label", {},
    element("input", { type: "checkbox", id: id(`day-${day}`), checked: rule.schedule.days.includes(day), onchange: (event) => change((now) => {
      const others = now.schedule.days.filter((one) => one !== day);
      now.schedule.days = (event.target.checked ? [...others, day] : others).sort();
    }) }), name)));
  const clock = (name) => element("input", { type: "time", id: id(name), value: rule.schedule[name], onchange: (event) => (
    change((now) => (now.schedule[name] = event.target.value || "00:00"))
  ) });
  return [
    ...rows,
    element("div", { class: "field" }, days, element("span", { class: "problem", role: "alert", "data-for": `${at}.schedule`, hidden: true })),
    field("From", `${at}.schedule.since`, clock("since")),
    field("Until", `${at}.schedule.until`, clock("until")),
  ];
}

function limited(rule) {
  const limit = LIMITS[rule.kind];
  if (limit === undefined) delete rule.limit;
  else rule.limit ??= limit.first;
  if (rule.kind !== "cross") delete rule.direction;
  if (rule.kind !== "proximity") delete rule.target;
  return rule;
}

function unusual(rule) {
  return Boolean(rule.schedule || rule.devices?.length || rule.quiet || (rule.confidence ?? 0.5) !== 0.5);
}

function choice(id, options, value, chosen) {
  return element("select", { id, onchange: (event) => chosen(event.target.value) },
    ...options.map(([key, words]) => element("option", { value: key, selected: key === value }, words)));
}

export function numberInput(id, value, step, typed, least = "0", most = null) {
  return element("input", { id, type: "number", step, min: least, max: most, required: true, value: value === null || value === undefined ? "" : String(value),
    oninput: (event) => typed(Number.isFinite(event.target.valueAsNumber) ? event.target.valueAsNumber : null) });
}

function text(id, value, placeholder, most, typed) {
  return element("input", { id, type: "text", value, placeholder, maxlength: most === null ? null : String(most), autocomplete: "off",
    oninput: (event) => typed(event.target.value.trim()) });
}
