// The audit log, newest first, a page at a time.

import { ask } from "./ask.js";
import { element, table, timeOf } from "./dom.js";
import { formRow, orderButton, textInput } from "./form_row.js";

const PAGE = 50;

export async function drawAudit({ place, say }) {
  const shown = element("div");
  const more = element("div", { class: "orders" });
  let entries = [];
  let who = "";

  async function read(before) {
    const answer = await ask("audit", { query: { who, before, limit: PAGE } });
    entries = before === null ? answer.entries : [...entries, ...answer.entries];
    shown.replaceChildren(entries.length === 0 ? element("p", { class: "empty" }, "Nothing of that kind.")
      : table(["When", "Who", "Did", "What", "Answer", "Times", "What there was before"], entries.map((one) => [
        timeOf(one.t), one.who, one.action, element("code", {}, one.subject), String(one.status), String(one.times), element("code", {}, one.detail)])));
    more.replaceChildren(answer.next === null ? "" : orderButton("Older entries", "Older entries", () => look(answer.next)));
  }

  async function look(before) {
    try {
      await read(before);
      say("");
    } catch (refusal) {
      say(refusal.message);
    }
  }

  const form = formRow({ who: ["Who", textInput({ type: "search", required: false, placeholder: "everybody" })] }, "Show", (wish) => {
    who = wish.who;
    return look(null);
  });
  await read(null);
  place.replaceChildren(form, shown, more);
}
