// Where access points hang: drag them on the plan, or choose one and click; heights in the list; save.

import { bounds, paintPlan, paintWalls } from "./painting.js";
import { Picker } from "./picker.js";
import { appeared, ask, button, mark, numberInput, withoutWhatIsLacking } from "./setup-common.js";

const PLACED = "#4b44a0";
const CHANGED = "#b8500a";
const HEIGHT = 2.5; // metres, for a first guess

const page = await appeared(["points-floor", "points-plan", "points-say", "points-list", "points-save", "points-lacking"]);
const state = { site: null, floor: null, points: [], saved: new Map(), chosen: null };

const plan = new Picker(page["points-plan"], {
  to: ([x, y]) => [x, y],
  from: (x, y) => [Math.round(100 * x) / 100, Math.round(100 * y) / 100],
  paint,
  points: () => here().map((point) => point.position),
  placed: (place) => put(state.chosen, place),
  moved: (index, place) => put(here()[index], place),
  told: ([x, y]) => say(`Plan ${x.toFixed(2)}, ${y.toFixed(2)} m`),
});

function say(text, wrong = false) {
  page["points-say"].textContent = text;
  page["points-say"].classList.toggle("wrong", wrong);
}

function here() {
  return state.points.filter((point) => point.floor === state.floor?.id);
}

function differs(point) {
  return JSON.stringify(point.position) !== state.saved.get(point.id);
}

function put(point, [x, y]) {
  if (point === null) return say("Choose an access point in the list first.", true);
  point.position = [x, y, point.position?.[2] ?? HEIGHT];
  state.chosen = point;
  say(`${point.id} at ${x}, ${y} m.`);
  list();
}

function paint(context, view) {
  if (state.floor === null) return;
  paintPlan(context, view, state.floor);
  paintWalls(context, view, state.floor);
  for (const point of here()) {
    if (point.position === null) continue;
    const at = view.toScreen(point.position[0], point.position[1]);
    mark(context, at, point.id, { colour: differs(point) ? CHANGED : PLACED, wrong: differs(point), chosen: point === state.chosen });
  }
}

function list() {
  const focused = document.activeElement?.getAttribute("aria-label");
  page["points-list"].replaceChildren(...here().map((point) => {
    const row = document.createElement("tr");
    row.classList.toggle("chosen", point === state.chosen);
    const cell = (content, label = "") => {
      const made = row.insertCell();
      if (label) made.dataset.label = label;
      made.append(content);
    };
    const choose = button(point.id, `Choose ${point.id}`, () => {
      state.chosen = point;
      say(`Click where ${point.id} hangs, or move it with the keyboard.`);
      list();
    });
    choose.setAttribute("aria-pressed", String(point === state.chosen));
    cell(choose);
    ["x", "y", "z"].forEach((name, axis) => {
      cell(numberInput(point.position?.[axis], `${point.id}, ${name}`, (value) => {
        if (value === null) return list();
        const now = point.position ?? [0, 0, HEIGHT];
        point.position = now.map((old, other) => (other === axis ? value : old));
        list();
      }), name);
    });
    cell(point.position === null ? "not placed" : differs(point) ? "changed" : "");
    return row;
  }));
  if (focused) [...page["points-list"].querySelectorAll("[aria-label]")].find((one) => one.getAttribute("aria-label") === focused)?.focus();
  plan.redraw();
}

async function load() {
  const told = await (await ask("access-points")).json();
  state.points = told.access_points;
  state.saved = new Map(state.points.map((point) => [point.id, JSON.stringify(point.position)]));
  state.chosen = null;
}

async function save() {
  const positions = Object.fromEntries(state.points.filter(differs).map((point) => [point.id, point.position]));
  if (Object.keys(positions).length === 0) return say("Nothing was moved.");
  try {
    const told = await (await ask("access-points", { positions })).json();
    await load();
    list();
    say(told.words);
  } catch (reason) {
    say(reason.message, true);
  }
}

function go(floor) {
  state.floor = state.site.floors.find(({ id }) => id === floor);
  state.chosen = null;
  plan.show(bounds(state.floor.outline));
  list();
}

page["points-save"].addEventListener("click", save);
page["points-floor"].addEventListener("change", (event) => go(event.target.value));
window.accessPoints = { state, plan }; // for tests

withoutWhatIsLacking(page["points-lacking"], ["setup", "save places of access points", page["points-save"]]);
try {
  state.site = await (await ask("site")).json();
  await load();
  for (const { id, name } of state.site.floors) page["points-floor"].append(new Option(name || id, id));
  go(page["points-floor"].value);
  say(state.points.length === 0 ? "The site file names no access point." : "Drag an access point, or choose one and click.");
} catch (reason) {
  say(reason.message, true);
}
