// What is known of one phone, for a visitor who asks; its end; whose consent has ended, in which stores; what is kept.

import { inWords } from "./alert_words.js";
import { ask } from "./ask.js";
import { appeared, count, duration, element, sentence, timeOf } from "./dom.js";
import { Identities } from "./identities.js";

const MOST_ALERTS = 1000;
const SHOWN = 10;

const EVERY_MS = 10000;
const SOON_MS = 1000;

const page = await appeared(["privacy-form", "privacy-device", "privacy-answer", "privacy-erasures", "privacy-kept",
  "erase-form", "erase-device", "erase-again", "erase-button", "erase-answer"]);
const identities = new Identities();

async function lookUp(device) {
  const answer = page["privacy-answer"];
  answer.replaceChildren(element("p", { class: "empty" }, "Asking…"));
  try {
    const [position, alerts, { zones }] = await Promise.all([
      ask(`positions/${encodeURIComponent(device)}`).catch(unknown),
      ask("alerts", { query: { device, limit: MOST_ALERTS } }),
      ask("zones"),
    ]);
    const names = new Map(zones.map((zone) => [zone.id, zone.name || zone.id]));
    const about = alerts.alerts.filter((alert) => alert.device === device || alert.other_device === device);
    answer.replaceChildren(
      element("p", {}, position === null ? "Now: this phone is not located."
        : `Now: on floor ${position.floor} at ${position.x.toFixed(1)}, ${position.y.toFixed(1)} m, `
          + `as of ${duration(position.age)} ago, with ${Math.round(100 * position.probability)} % certainty.`),
      element("p", {}, about.length === 0 ? "No alert names it." : `${count(about.length, "alert names", "alerts name")} it:`),
      element("ul", {}, ...about.slice(0, SHOWN).map((alert) => {
        const { who, did } = inWords(alert, identities, names.get(alert.zone) ?? alert.zone);
        return element("li", {}, timeOf(alert.t), ` ${who} ${did}`);
      })),
      about.length > SHOWN ? element("p", { class: "quiet" }, `and ${about.length - SHOWN} older ones`) : "",
    );
  } catch (refusal) {
    answer.replaceChildren(element("p", { class: "problem" }, refusal.message));
  }
}

function unknown(refusal) {
  if (refusal.status === 404) return null;
  throw refusal;
}

// Which phone was erased on this page last, and until when the next look at all erasures waits.
let erasedHere = null;
let next = null;

async function erase(device) {
  page["erase-button"].disabled = true;
  const answer = page["erase-answer"];
  answer.replaceChildren(element("p", { class: "empty" }, "Asking the gateway…"));
  try {
    const report = await ask(`devices/${encodeURIComponent(device)}`, { method: "DELETE" });
    page["erase-form"].reset();
    erasedHere = device;
    tellEnd(report);
    tellErasures();
  } catch (refusal) {
    answer.replaceChildren(element("p", { class: "problem" }, refusal.message));
    mayErase();
  }
}

function mayErase() {
  const device = page["erase-device"].value.trim();
  page["erase-button"].disabled = device === "" || device !== page["erase-again"].value.trim();
}

function tellEnd({ device, done, waiting }) {
  const stores = done.map(({ service }) => service).join(", ");
  page["erase-answer"].replaceChildren(
    element("p", {}, `Phone ${identities.labelOf(device)}: its consent has ended, its tokens open nothing any more.`),
    element("p", {}, `Nothing is left in: ${stores || "no store has said so yet"}.`),
    element("p", {}, waiting.length === 0 ? "It is gone from every store." : `Still to say so: ${waiting.join(", ")}.`));
  return waiting.length === 0;
}

async function tellErasures() {
  clearTimeout(next);
  const told = page["privacy-erasures"];
  try {
    const { erasures } = await ask("erasures");
    const here = erasures.find(({ device }) => device === erasedHere);
    if (here !== undefined && tellEnd(here)) erasedHere = null;
    told.replaceChildren(erasures.length === 0 ? element("p", { class: "empty" }, "Nobody has, lately.") : table(erasures));
  } catch (refusal) {
    told.replaceChildren(element("p", { class: "problem" }, refusal.message));
  }
  next = setTimeout(tellErasures, erasedHere === null ? EVERY_MS : SOON_MS);
}

function table(erasures) {
  const rows = erasures.map(({ device, t, done, waiting }) => element("tr", {},
    element("th", { scope: "row" }, `Phone ${identities.labelOf(device)}`),
    element("td", {}, timeOf(t)),
    element("td", {}, done.map(({ service }) => service).join(", ") || "none yet"),
    element("td", {}, element("span", { class: "lit" }, element("span", { class: `light ${waiting.length ? "wait" : "good"}` }),
      waiting.length ? waiting.join(", ") : "none: it is gone"))));
  return element("table", {}, element("thead", {}, element("tr", {},
    ...["Phone", "Taken back", "Erased in", "Still to say so"].map((name) => element("th", { scope: "col" }, name)))),
  element("tbody", {}, ...rows));
}

async function tellKept() {
  const told = page["privacy-kept"];
  try {
    const { kept, silent } = await ask("privacy/retention");
    const rows = kept.map(({ service, what, settings, seconds, note }) => element("tr", {},
      element("th", { scope: "row" }, sentence(what)),
      element("td", {}, [seconds === null ? "" : period(seconds), note].filter(Boolean).join("; ")),
      element("td", {}, service),
      element("td", {}, ...settings.flatMap((name, place) =>
        [place ? ", " : "", element("code", {}, `ATRIUM_${name.toUpperCase()}`)]))));
    told.replaceChildren(
      element("table", { class: "kept" }, element("thead", {}, element("tr", {},
        ...["What", "How long", "Where", "Setting"].map((name) => element("th", { scope: "col" }, name)))),
      element("tbody", {}, ...rows)),
      silent.length === 0 ? "" : element("p", { class: "problem" },
        `What these keep is not known, they do not answer: ${silent.join(", ")}.`),
    );
  } catch (refusal) {
    told.replaceChildren(element("p", { class: "problem" }, refusal.message));
  }
}

function period(seconds) {
  const days = seconds / 86400;
  return days < 2 ? duration(seconds) : `${Number(days.toFixed(1))} days`;
}

tellErasures();
tellKept();
for (const name of ["erase-device", "erase-again"]) page[name].addEventListener("input", mayErase);
page["erase-form"].addEventListener("submit", (event) => {
  event.preventDefault();
  if (!page["erase-button"].disabled) erase(page["erase-device"].value.trim());
});
page["privacy-form"].addEventListener("submit", (event) => {
  event.preventDefault();
  lookUp(page["privacy-device"].value.trim());
});
