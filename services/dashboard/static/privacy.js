// What is known of one phone, for a visitor who asks.

import { inWords } from "./alert_words.js";
import { ask } from "./ask.js";
import { appeared, count, duration, element, timeOf } from "./dom.js";
import { Identities } from "./identities.js";

const MOST_ALERTS = 1000;
const SHOWN = 10;

const page = await appeared(["privacy-form", "privacy-device", "privacy-answer"]);
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

page["privacy-form"].addEventListener("submit", (event) => {
  event.preventDefault();
  lookUp(page["privacy-device"].value.trim());
});
