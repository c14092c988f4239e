// Who may come in: staff with a role, programs with a key.

import { ask } from "./ask.js";
import { element, table, timeOf } from "./dom.js";
import { formRow, orderButton, textInput } from "./form_row.js";

const ROLES = ["viewer", "guard", "desk", "curator", "admin"];

export async function drawUsers({ place, sure, change, again }) {
  const { users } = await ask("users");
  const rows = users.map(({ name, role, created }) => {
    const path = `users/${encodeURIComponent(name)}`;
    const choice = roles(role, { "aria-label": `Role of ${name}`, onchange: async (event) => {
      if (!(await sure(`${name} becomes ${event.target.value}, and is signed out everywhere?`, "Change"))) return again();
      return change(path, { method: "PUT", body: { role: event.target.value } }, `${name} is ${event.target.value} now.`);
    } });
    const out = orderButton("Take out…", `Take ${name} out`, async () => {
      if (await sure(`Take ${name} out? Their sign-ins end at once.`, "Take out")) await change(path, { method: "DELETE" }, `${name} is gone.`);
    }, "danger");
    return [name, choice, timeOf(created), out];
  });
  const form = formRow({
    name: ["Name", textInput({ maxlength: "64" })],
    role: ["Role", roles("viewer")],
    password: ["Password", textInput({ type: "password", minlength: "10", autocomplete: "new-password" })],
  }, "Let in", (body) => change("users", { method: "POST", body }, `${body.name} may sign in.`));
  place.replaceChildren(rows.length === 0 ? none("Nobody of the staff has a name here yet.") : table(["Name", "Role", "Since", ""], rows), form);
}

export async function drawKeys({ place, sure, change }) {
  const [{ keys }, { scopes }] = await Promise.all([ask("keys"), ask("session")]);
  const rows = keys.map(({ id, name, scopes: may, rate, created, expires }) => [name, may.join(", "), `${rate} a second`, timeOf(created),
    expires === null ? "never" : timeOf(expires), orderButton("Revoke…", `Revoke the key ${name}`, async () => {
      if (await sure(`Revoke the key ${name}? Whoever uses it is refused from the next request on.`, "Revoke")) {
        await change(`keys/${encodeURIComponent(id)}`, { method: "DELETE" }, `The key ${name} is revoked.`);
      }
    }, "danger")]);
  // Nobody issues a scope they do not have.
  const choice = element("fieldset", { class: "days" }, element("legend", { class: "quiet" }, "May"),
    ...scopes.map((scope) => element("label", {}, element("input", { type: "checkbox", value: scope }), scope)));
  const form = formRow({
    name: ["Name", textInput({ maxlength: "64" })],
    scopes: [null, choice],
    days: ["Days it holds", textInput({ type: "number", min: "1", required: false, placeholder: "for ever" })],
  }, "Issue a key", ({ name, days }) => change("keys", { method: "POST", body: {
    name,
    scopes: [...choice.querySelectorAll(":checked")].map((box) => box.value),
    expires: days === "" ? null : Date.now() / 1000 + 86400 * Number(days),
  } }, ({ key }) => `The key of ${name}, told this once: ${key}`));
  place.replaceChildren(rows.length === 0 ? none("No key was issued here; those of the settings are not listed.")
    : table(["Name", "May", "At most", "Issued", "Ends", ""], rows), form);
}

function roles(chosen, more = {}) {
  return element("select", more, ...ROLES.map((role) => element("option", { value: role, selected: role === chosen }, role)));
}

function none(words) {
  return element("p", { class: "empty" }, words);
}
