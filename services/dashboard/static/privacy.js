// What is known of one phone, for a visitor who asks; and whose consent has ended, in which stores.

import { inWords } from "./alert_words.js";
import { ask } from "./ask.js";
import { appeared, count, duration, element, timeOf } from "./dom.js";
import { Identities } from "./identities.js";

const MOST_ALERTS = 1000;
const SHOWN = 10;

const EVERY_MS = 10000;

const page = await appeared(["privacy-form", "privacy-device", "privacy-answer", "privacy-erasures"]);
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

async function tellErasures() {
  const told = page["privacy-erasures"];
  try {
    const { erasures } = await ask("erasures");
    told.replaceChildren(erasures.length === 0 ? element("p", { class: "empty" }, "Nobody has, lately.") : table(erasures));
  } catch (refusal) {
    told.replaceChildren(element("p", { class: "problem" }, refusal.message));
  }
  setTimeout(tellErasures, EVERY_MS);
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

tellErasures();
page["privacy-form"].addEventListener("submit", (event) => {
  event.preventDefault();
  lookUp(page["privacy-device"].value.trim());
});
