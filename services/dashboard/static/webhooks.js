// Where alerts are sent, how that goes, what was never taken.

import { KINDS } from "./alert_words.js";
import { ask } from "./ask.js";
import { count, element, table, timeOf } from "./dom.js";
import { formRow, orderButton, textInput } from "./form_row.js";

const LETTERS = 50;

export async function drawWebhooks({ place, sure, change, say }) {
  const { webhooks } = await ask("webhooks");
  const letters = element("div");
  const rows = webhooks.map((hook) => {
    const path = `webhooks/${encodeURIComponent(hook.id)}`;
    const name = hook.name || hook.url;
    const { url, kinds, zones, enabled } = hook;
    const flip = orderButton(enabled ? "Pause…" : "Go on", `${enabled ? "Pause" : "Go on with"} ${name}`, async () => {
      if (enabled && !(await sure(`Pause ${name}? Alerts told meanwhile are not kept for it.`, "Pause"))) return;
      const body = { url, name: hook.name, kinds, zones, enabled: !enabled };
      await change(path, { method: "PUT", body }, enabled ? `${name} is paused.` : `${name} goes on.`);
    });
    const out = orderButton("Delete…", `Delete ${name}`, async () => {
      if (await sure(`Delete ${name}, and all that waits for it?`, "Delete")) await change(path, { method: "DELETE" }, `${name} is gone.`);
    }, "danger");
    const dead = hook.dead === 0 ? "0" : orderButton(`${hook.dead}: show`, `What ${name} never took`, () => show(path, name));
    const last = hook.last_success === null ? "never" : timeOf(hook.last_success);
    return [element("span", {}, name, name === url ? "" : element("p", { class: "quiet" }, url)), [...kinds, ...zones].join(", ") || "all alerts",
      enabled ? "running" : "paused", String(hook.waiting), last, hook.last_reason, dead, element("span", { class: "orders" }, flip, out)];
  });

  async function show(path, name) {
    try {
      const { dead, next } = await ask(`${path}/dead`, { query: { limit: LETTERS } });
      const again = orderButton("Send all again", `Send all again that ${name} never took`, () => (
        change(`${path}/replay`, { method: "POST" }, ({ replayed }) => `${count(replayed, "alert is", "alerts are")} sent to ${name} again.`)));
      letters.replaceChildren(element("h2", {}, `What ${name} never took`),
        table(["Alert", "What", "Given up", "Attempts", "Why"], dead.map(({ alert, attempts, died, reason }) => [
          timeOf(alert.t), `${KINDS[alert.kind] ?? alert.kind}, ${alert.zone}`, timeOf(died), String(attempts), reason])),
        next === null ? "" : element("p", { class: "quiet" }, "and more"), element("div", { class: "orders" }, again));
    } catch (refusal) {
      say(refusal.message);
    }
  }

  const form = formRow({
    name: ["Name", textInput({ required: false })],
    url: ["Address", textInput({ type: "url", maxlength: "2000", placeholder: "https://…" })],
  }, "Add", (body) => change("webhooks", { method: "POST", body }, ({ secret }) => `Its secret, told this once: ${secret}`));
  place.replaceChildren(rows.length === 0 ? element("p", { class: "empty" }, "Alerts are sent nowhere.")
    : table(["Whom", "Which alerts", "State", "Waiting", "Last taken", "Last trouble", "Never taken", ""], rows), letters, form);
}
