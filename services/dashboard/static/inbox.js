// The alert inbox: one row per alert, newest first, live; and who has looked at it.

import { inWords, KINDS } from "./alert_words.js";
import { ask, lacking } from "./ask.js";
import { appeared, arrange, count, element, spoken, timeOf } from "./dom.js";
import { Identities } from "./identities.js";

const PAGE = 100;
const EVERY_MS = 5000; // an event may be missed
const SOON_MS = 250; // several alerts at once are asked for once

const page = await appeared(["inbox-state", "inbox-kind", "inbox-zone", "inbox-since", "inbox-rows", "inbox-more", "inbox-count", "inbox-problem", "inbox-lacking"]);
const identities = new Identities();
const state = { mayAcknowledge: true, zones: new Map(), alerts: [], next: null, writing: null, pages: 1, asked: 0, due: null };

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
    kinds: page["inbox-kind"].value,
    since: since === "" ? null : (Date.now() / 1000 - Number(since)).toFixed(3),
    acknowledged: { open: false, done: true, all: null }[page["inbox-state"].value],
  };
}

function fits(alert, wish) {
  return (wish.zone === "" || alert.zone === wish.zone) && (wish.kinds === "" || alert.kind === wish.kinds)
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
  const note = element("textarea", { rows: "2", maxlength: "2000", "aria-label": "Note", placeholder: "What was it? (may stay empty)" });
  const wrong = element("p", { class: "problem", role: "alert", hidden: true });
  const form = element("form", { class: "acknowledge", onsubmit: async (event) => {
    event.preventDefault();
    form.inert = true;
    try {
      await ask(`alerts/${encodeURIComponent(alert.id)}/acknowledge`, { method: "POST", body: { note: note.value.trim() } });
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

for (const name of ["state", "kind", "zone", "since"]) {
  page[`inbox-${name}`].addEventListener("change", () => {
    state.pages = 1;
    refresh();
  });
}
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
