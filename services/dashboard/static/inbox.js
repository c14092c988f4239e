// The alert inbox: one row per alert, newest first, live; and who has looked at it.

import { inWords, KINDS } from "./alert_words.js";
import { ask, lacking } from "./ask.js";
import { appeared, arrange, count, element, spoken, timeOf } from "./dom.js";
import { Identities } from "./identities.js";
import { question } from "./question.js";

const PAGE = 100;
const EVERY_MS = 5000; // an event may be missed
const SOON_MS = 250; // several alerts at once are asked for once

const page = await appeared(["inbox-state", "inbox-kind", "inbox-zone", "inbox-since", "inbox-rows", "inbox-more", "inbox-count", "inbox-problem", "inbox-lacking",
  "inbox-device", "inbox-devices", "inbox-all", "inbox-said", "inbox-ask"]);
const identities = new Identities();
const state = { mayAcknowledge: true, zones: new Map(), devices: new Set(), alerts: [], next: null, writing: null, pages: 1, asked: 0, due: null };

for (const [kind, words] of Object.entries(KINDS)) page["inbox-kind"].append(new Option(words.toLowerCase(), kind));

async function nameZones() {
  const { zones } = await ask("zones");
  const chosen = page["inbox-zone"].value;
  state.zones = new Map(zones.map((zone) => [zone.id, zone.name || zone.id]));
  page["inbox-zone"].replaceChildren(new Option("everywhere", ""), ...zones.map((zone) => new Option(zone.name || zone.id, zone.id)));
  page["inbox-zone"].value = state.zones.has(chosen) ? chosen : "";
}

function wished() {
  const since = page["inbox-since"].value;
  return {
    limit: PAGE,
    zone: page["inbox-zone"].value,
    device: wishedDevice(),
    kinds: page["inbox-kind"].value,
    since: since === "" ? null : (Date.now() / 1000 - Number(since)).toFixed(3),
    acknowledged: { open: false, done: true, all: null }[page["inbox-state"].value],
  };
}

// The end of an id that is known will do for the whole.
function wishedDevice() {
  const typed = page["inbox-device"].value.trim();
  const known = [...state.devices].filter((device) => device.endsWith(typed));
  return typed !== "" && known.length === 1 ? known[0] : typed;
}

function fits(alert, wish) {
  return (wish.device === "" || alert.device === wish.device || alert.other_device === wish.device)
    && (wish.zone === "" || alert.zone === wish.zone) && (wish.kinds === "" || alert.kind === wish.kinds)
    && (wish.acknowledged === null || Boolean(alert.acknowledged) === wish.acknowledged)
    && (wish.since === null || alert.t > Number(wish.since));
}

// Ask for as many pages as are shown.
async function refresh() {
  clearTimeout(state.due);
  state.due = setTimeout(refresh, EVERY_MS);
  const turn = ++state.asked;
  try {
    if (state.zones.size === 0) await nameZones();
    const wish = wished();
    const found = new Map();
    let next = null;
    for (let number = 0; number < state.pages; number += 1) {
      const answer = await ask("alerts", { query: { ...wish, before: next } });
      for (const alert of answer.alerts) if (fits(alert, wish)) found.set(alert.id, alert);
      next = answer.next ?? null;
      if (next === null) break;
    }
    if (turn !== state.asked) return;
    state.alerts = [...found.values()];
    state.next = next;
    problem("");
    draw();
  } catch (refusal) {
    problem(`${refusal.message} Trying again…`);
  }
}

function nameDevices() {
  const known = state.devices.size;
  for (const { device, other_device: other } of state.alerts) for (const one of [device, other]) if (one) state.devices.add(one);
  if (state.devices.size === known) return;
  page["inbox-devices"].replaceChildren(...[...state.devices].map((device) => new Option(`Phone ${identities.labelOf(device)}`, device)));
}

function open() {
  return state.alerts.filter((alert) => !alert.acknowledged);
}

// Those that are shown when somebody says so, one after the other: what comes meanwhile is nobody's yet.
async function acknowledgeAll() {
  const wanted = open();
  const note = noteField("A note for all of them (may stay empty)");
  const words = `Acknowledge the ${count(wanted.length, "alert that is", "alerts that are")} shown?`;
  if (!(await question(page["inbox-ask"], words, "Acknowledge all", "Cancel", note))) return;
  page["inbox-all"].disabled = true;
  let others = 0;
  let done = 0;
  let wrong = "";
  for (const alert of wanted) {
    page["inbox-said"].textContent = `Acknowledging… ${done + others} of ${wanted.length}`;
    try {
      await acknowledge(alert.id, note.value);
      done += 1;
    } catch (refusal) {
      if (refusal.status !== 409) {
        wrong = ` The others were not: ${refusal.message}`;
        break;
      }
      others += 1;
    }
  }
  page["inbox-all"].disabled = false;
  const before = others === 0 ? "" : ` Somebody else was first with ${others}.`;
  page["inbox-said"].textContent = `${count(done, "alert was", "alerts were")} acknowledged.${before}${wrong}`;
  await refresh();
}

function acknowledge(id, note) {
  return ask(`alerts/${encodeURIComponent(id)}/acknowledge`, { method: "POST", body: { note: note.trim() } });
}

function noteField(words) {
  return element("textarea", { rows: "2", maxlength: "2000", "aria-label": "Note", placeholder: words });
}

function problem(words) {
  page["inbox-problem"].textContent = words;
  page["inbox-problem"].hidden = words === "";
}

function draw() {
  const rows = page["inbox-rows"];
  const old = new Map([...rows.children].map((row) => [row.dataset.key, row]));
  arrange(rows, state.alerts.map((alert) => {
    const open = alert.id === state.writing;
    const key = JSON.stringify([alert.id, alert.acknowledged ?? null, open, state.zones.get(alert.zone)]);
    // A row that stays keeps its element, and with it what somebody writes and the keyboard's focus.
    return old.get(key) ?? row(alert, key, open);
  }));
  nameDevices();
  const left = open().length;
  page["inbox-all"].hidden = !state.mayAcknowledge || left < 2;
  page["inbox-all"].textContent = `Acknowledge all ${left} shown…`;
  page["inbox-more"].hidden = state.next === null;
  page["inbox-count"].textContent = state.alerts.length === 0 ? "" : count(state.alerts.length, "alert", "alerts") + (state.next ? " and more" : "");
}

function row(alert, key, open) {
  const { who, did } = inWords(alert, identities, state.zones.get(alert.zone) ?? alert.zone);
  const end = alert.acknowledged ? element("span", { class: "seen" }, `✓ ${alert.acknowledged.by}, ${spoken(alert.acknowledged.at)}`)
    : open || !state.mayAcknowledge ? null : element("button", { type: "button", "aria-label": `Acknowledge: ${who} ${did}`, onclick: () => write(alert.id) }, "Acknowledge");
  const item = element("li", {}, element("div", { class: "what" }, identities.swatch(alert.device), timeOf(alert.t), element("span", { class: "words" }, element("strong", {}, who), ` ${did}`),
    element("a", { href: placeOf(alert), title: "Show the place on the live map" }, "Where?"), end));
  item.dataset.key = key;
  item.dataset.id = alert.id;
  if (alert.acknowledged?.note) item.append(element("p", { class: "note" }, alert.acknowledged.note));
  if (open) item.append(noteForm(alert));
  return item;
}

function placeOf({ floor, x, y }) {
  return `/#${new URLSearchParams({ floor, x, y })}`;
}

function noteForm(alert) {
  const note = noteField("What was it? (may stay empty)");
  const wrong = element("p", { class: "problem", role: "alert", hidden: true });
  const form = element("form", { class: "acknowledge", onsubmit: async (event) => {
    event.preventDefault();
    form.inert = true;
    try {
      await acknowledge(alert.id, note.value);
      state.writing = null;
      await refresh();
    } catch (refusal) {
      if (refusal.status === 409) refresh(); // somebody was first: the row will say who
      form.inert = false;
      wrong.textContent = refusal.message;
      wrong.hidden = false;
    }
  } }, note, wrong, element("div", { class: "orders" },
    element("button", { type: "submit", class: "primary" }, "Acknowledge"),
    element("button", { type: "button", onclick: () => write(null) }, "Cancel")));
  form.addEventListener("keydown", (event) => event.key === "Escape" && write(null));
  return form;
}

function write(id) {
  const before = state.writing;
  state.writing = id;
  draw();
  const focused = [...page["inbox-rows"].children].find((item) => item.dataset.id === (id ?? before));
  focused?.querySelector(id === null ? "button" : "textarea")?.focus();
}

function listen() {
  const source = new EventSource("/live");
  for (const name of ["alert", "acknowledged"]) {
    source.addEventListener(name, () => {
      clearTimeout(state.due);
      state.due = setTimeout(refresh, SOON_MS);
    });
  }
  source.onerror = () => {
    if (source.readyState === EventSource.CLOSED) setTimeout(listen, EVERY_MS);
  };
}

for (const name of ["state", "kind", "zone", "device", "since"]) {
  page[`inbox-${name}`].addEventListener("change", () => {
    state.pages = 1;
    refresh();
  });
}
page["inbox-all"].addEventListener("click", acknowledgeAll);
page["inbox-more"].addEventListener("click", () => {
  state.pages += 1;
  refresh();
});
const words = await lacking("acknowledge", "acknowledge alerts");
state.mayAcknowledge = words === null;
page["inbox-lacking"].textContent = words ?? "";
page["inbox-lacking"].hidden = words === null;
refresh();
listen();
