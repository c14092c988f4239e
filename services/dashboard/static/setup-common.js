// What both set-up pages need: the elements NiceGUI builds, the API through the dashboard, marks on a canvas.

import { lacking } from "./ask.js";

export async function appeared(ids) {
  const found = {};
  while (true) {
    for (const id of ids) found[id] = document.getElementById(id);
    if (ids.every((id) => found[id] !== null)) return found;
    await new Promise((resolve) => setTimeout(resolve, 30));
  }
}

// Ask the API through the dashboard; throws an Error whose message is for people.
export async function ask(path, body) {
  const options = body === undefined ? {} : { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(body) };
  const answer = await fetch(`/setup/${path}`, options).catch(() => null);
  if (answer === null) throw new Error("The dashboard does not answer; is it running?");
  if (answer.status === 401) window.location.assign("/login");
  if (answer.ok) return answer;
  let words = `The API has a problem of its own (status ${answer.status}).`;
  try {
    words = (await answer.json()).detail ?? words;
  } catch {
    // no words: keep ours
  }
  throw Object.assign(new Error(words.charAt(0).toUpperCase() + words.slice(1)), { status: answer.status });
}

// Say in `place` which of these whoever looks may not do, and take its button away: [scope, what it is, button].
export async function withoutWhatIsLacking(place, ...orders) {
  for (const [scope, what, button] of orders) {
    const words = await lacking(scope, what);
    if (words === null) continue;
    button.hidden = true;
    place.hidden = false;
    place.textContent = `${place.textContent} ${words}`.trim();
  }
}

export function metres(value) {
  return value === null || value === undefined ? "–" : value < 1 ? `${(100 * value).toFixed(value < 0.1 ? 1 : 0)} cm` : `${value.toFixed(2)} m`;
}

// A numbered mark: shape and number tell what colour tells too.
export function mark(context, [x, y], label, { colour, wrong = false, chosen = false }) {
  context.lineWidth = 2;
  context.strokeStyle = "#ffffff";
  context.fillStyle = colour;
  context.beginPath();
  if (wrong) {
    context.moveTo(x, y - 9);
    context.lineTo(x + 9, y);
    context.lineTo(x, y + 9);
    context.lineTo(x - 9, y);
    context.closePath();
  } else {
    context.arc(x, y, chosen ? 8 : 6, 0, 2 * Math.PI);
  }
  context.globalAlpha = 0.85;
  context.fill();
  context.globalAlpha = 1;
  context.stroke();
  context.fillStyle = "#ffffff";
  context.beginPath();
  context.arc(x, y, 1.2, 0, 2 * Math.PI);
  context.fill();
  words(context, label, x + 11, y - 10, colour);
}

export function words(context, text, x, y, colour) {
  context.font = "600 12px system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif";
  context.textBaseline = "middle";
  context.textAlign = "left";
  context.lineJoin = "round";
  context.lineWidth = 3;
  context.strokeStyle = "#ffffffd0";
  context.strokeText(text, x, y);
  context.fillStyle = colour;
  context.fillText(text, x, y);
}

export function path(context, points) {
  context.beginPath();
  points.forEach(([x, y], index) => (index === 0 ? context.moveTo(x, y) : context.lineTo(x, y)));
}

export function shownNumber(value) {
  return value === null || value === undefined ? "" : String(Math.round(value * 1000) / 1000);
}

export function numberInput(value, label, changed, step = "any") {
  const input = document.createElement("input");
  input.type = "number";
  input.step = step;
  input.value = shownNumber(value);
  input.setAttribute("aria-label", label);
  input.addEventListener("change", () => {
    const given = input.value.trim() === "" ? null : Number(input.value);
    changed(given !== null && Number.isFinite(given) ? given : null);
  });
  return input;
}

export function button(text, label, act) {
  const element = document.createElement("button");
  element.type = "button";
  element.textContent = text;
  element.setAttribute("aria-label", label);
  element.addEventListener("click", act);
  return element;
}
