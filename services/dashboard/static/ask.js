// Asking the API, through the dashboard that holds the key. What goes wrong is a Refusal, in words for people.

export class Refusal extends Error {
  // `field`: which part of what was sent is to blame, such as "rules[0].limit"; null where none is.
  constructor(status, problem) {
    super(wordsOf(status, problem));
    this.status = status;
    this.field = pathOf(problem?.field ?? null);
    this.found = problem?.found ?? null;
  }
}

// `ifMatch`: the ETag that what is changed must still have; empty: whatever it has.
export async function ask(path, { method = "GET", body = undefined, signal = undefined, query = {}, ifMatch = "" } = {}) {
  const wished = Object.entries(query).filter(([, value]) => value !== null && value !== undefined && value !== "");
  const search = new URLSearchParams(wished).toString();
  let answer;
  try {
    answer = await fetch(`/ask/v1/${path}${search ? `?${search}` : ""}`, {
      method,
      signal,
      headers: {
        ...(body === undefined ? {} : { "Content-Type": "application/json" }),
        ...(ifMatch === "" ? {} : { "If-Match": ifMatch }),
      },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refusal(0, { detail: "The dashboard does not answer; is the connection there?" });
  }
  if (answer.status === 401) {
    window.location.assign("/login");
    throw new Refusal(401, { detail: "The session has ended." });
  }
  const text = await answer.text();
  let document = null;
  try {
    document = text === "" ? null : JSON.parse(text);
  } catch {
    throw new Refusal(answer.status, { detail: "The API's answer was not understood." });
  }
  if (!answer.ok) throw new Refusal(answer.status, document);
  return document;
}

// What whoever looks may not do here, in words for people; null where they may, or where that is not known.
export async function lacking(scope, what) {
  let told;
  try {
    told = await ask("session");
  } catch {
    return null; // then the refusal of the change itself will say why
  }
  if (told.scopes.includes(scope)) return null;
  const who = told.role === null ? "this dashboard's key (ATRIUM_API_KEY) lacks" : `you are signed in as ${told.name} (${told.role}), who lacks`;
  return `You can look, but not ${what} here: ${who} the scope ${scope}.`;
}

function wordsOf(status, problem) {
  const detail = problem?.detail;
  if (typeof detail !== "string" || detail === "") return `The API has a problem of its own (status ${status}).`;
  const words = detail.charAt(0).toUpperCase() + detail.slice(1);
  return /[.!?]$/.test(words) ? words : `${words}.`;
}

// "$.rules[0].limit", "body.rules.0.limit" and "rules[0].limit" are one place.
function pathOf(field) {
  if (field === null) return null;
  return field.replace(/^(\$|body)\.?/, "").replaceAll(/\.(\d+)(?=\.|\[|$)/g, "[$1]");
}
