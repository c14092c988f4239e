// Staff, keys, webhooks and the audit log: each part where the dashboard's key has the scope for it.

import { ask, lacking } from "./ask.js";
import { drawAudit } from "./audit_log.js";
import { appeared, element } from "./dom.js";
import { question } from "./question.js";
import { drawKeys, drawUsers } from "./staff_keys.js";
import { drawWebhooks } from "./webhooks.js";

const PARTS = {
  users: ["accounts", "let staff in", drawUsers],
  keys: ["accounts", "issue keys", drawKeys],
  webhooks: ["webhooks", "see webhooks", drawWebhooks],
  audit: ["audit", "read the audit log", drawAudit],
};
const page = await appeared(["administration-ask", ...Object.keys(PARTS).flatMap((name) => [`${name}-part`, `${name}-said`])]);

// What a part is given: where it draws, and how it asks people and the API.
function tools(name, draw) {
  const say = (words) => (page[`${name}-said`].textContent = words);
  const self = {
    place: page[`${name}-part`],
    say,
    sure: (words, yes) => question(page["administration-ask"], words, yes, "Cancel"),
    // One change, and everything drawn anew; `words`: said when it is done.
    async change(path, options, words) {
      try {
        const answer = await ask(path, options);
        await self.again();
        say(typeof words === "function" ? words(answer) : words);
      } catch (refusal) {
        say(refusal.message);
      }
    },
    async again() {
      try {
        await draw(self);
      } catch (refusal) {
        self.place.replaceChildren(element("p", { class: "problem" }, refusal.message));
      }
    },
  };
  return self;
}

for (const [name, [scope, what, draw]] of Object.entries(PARTS)) {
  const words = await lacking(scope, what);
  if (words === null) tools(name, draw).again();
  else page[`${name}-said`].textContent = words;
}
