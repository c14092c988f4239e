// The page where zones and exhibits are drawn: the plan, the lists, the form of the chosen one, and the API that keeps them.

import { ask, lacking } from "./ask.js";
import { appeared, arrange, element, remember, remembered } from "./dom.js";
import { asExhibit, asPoint, newExhibit } from "./exhibits.js";
import { question } from "./question.js";
import { ZoneCanvas } from "./zone_canvas.js";
import { Draft, idFor, kindOf, pathOf } from "./zone_draft.js";
import { ZoneForm } from "./zone_form.js";
import { newRule } from "./zone_rules.js";

const HINT = "Click a zone or an exhibit to change it. Drag to move the map, wheel or two fingers to zoom.";
const HINT_CHANGING = "Drag corners; drag or click the small dots to insert one. Keys on the plan: n p choose a corner, arrows move it "
  + "(Shift: a metre), i inserts, Del deletes, Ctrl+Z undoes.";

const HINT_EXHIBIT = "Drag the exhibit to move it. Keys on the plan: n chooses it, arrows move it (Shift: a metre), Ctrl+Z undoes.";

const page = await appeared(["zones-canvas", "zones-floor", "zones-list", "zones-form", "zones-problem", "zones-hint", "zones-ask",
  "zones-area", "zones-line", "zones-point", "zones-exhibits", "zones-undo", "zones-redo", "zones-snap", "zones-in", "zones-out", "zones-fit"]);
const state = { site: null, floor: null, zones: [], draft: null, lacking: null };

const canvas = new ZoneCanvas(page["zones-canvas"], {
  choose: (zone) => choose(zone),
  drawn: (shape, points) => drawn(shape, points),
  changed: () => changed(),
  cornerChosen: () => form.refresh(),
  say,
});
const form = new ZoneForm(page["zones-form"], {
  changed: () => changed(),
  save,
  discard: () => discard(),
  remove,
  corner: (index) => canvas.chooseCorner(index),
  insertAfter: (index) => canvas.insertAfter(index),
  removeCorner: (index) => canvas.remove(index),
});

function say(words) {
  page["zones-hint"].textContent = words;
}

async function load() {
  try {
    const [site, all, words] = await Promise.all([ask("site"), everything(), lacking("zones-admin", "change zones and exhibits")]);
    tell("");
    state.lacking = words;
    form.readOnly = words !== null;
    page["zones-area"].closest(".tools").hidden = words !== null;
    state.site = site;
    state.zones = all;
    const floors = [...site.floors].sort((a, b) => (b.level ?? 0) - (a.level ?? 0));
    const select = page["zones-floor"];
    select.replaceChildren(...floors.map((floor) => new Option(floor.name || floor.id, floor.id)));
    select.parentElement.hidden = floors.length < 2;
    const wished = state.floor?.id ?? remembered("floor");
    showFloor(floors.find((floor) => floor.id === wished) ?? floors.at(-1));
  } catch (problem) {
    tell(`${problem.message} Trying again…`);
    setTimeout(load, 3000);
  }
}

// Zones and exhibits, as the API has them now.
async function everything() {
  const [{ zones }, { exhibits }] = await Promise.all([ask("zones"), ask("exhibits")]);
  return [...zones, ...exhibits.map(asPoint)];
}

// As the API has it now; undefined where it is gone.
function keptOf(zone) {
  return state.zones.find((one) => pathOf(one) === pathOf(zone));
}

function taken(shape) {
  return state.zones.filter((one) => kindOf(one.shape) === kindOf(shape)).map((one) => one.id);
}

function bodyOf(zone) {
  return zone.shape === "point" ? asExhibit(zone) : zone;
}

function tell(words) {
  page["zones-problem"].textContent = words;
  page["zones-problem"].hidden = words === "";
}

function showFloor(floor) {
  state.floor = floor;
  page["zones-floor"].value = floor.id;
  remember("floor", floor.id);
  canvas.show(state.site, floor);
  show();
}

function here() {
  return state.zones.filter((zone) => zone.floor === state.floor.id);
}

// Everything anew, as `state` says.
function show(refusal = null) {
  canvas.set(here(), state.lacking === null ? state.draft : null);
  form.show(state.draft, refusal);
  list();
  buttons();
  say(state.lacking ?? (state.draft === null ? HINT : state.draft.zone.shape === "point" ? HINT_EXHIBIT : HINT_CHANGING));
}

function list() {
  rows("zones-list", here().filter((zone) => zone.shape !== "point"), (zone) => {
    const rules = zone.rules?.length ?? zone.alert_on?.length ?? 0;
    return `${zone.shape === "line" ? "line" : "area"}, ${rules === 0 ? "tells nothing" : rules === 1 ? "1 rule" : `${rules} rules`}`;
  });
  rows("zones-exhibits", here().filter((zone) => zone.shape === "point"), ({ reach, facing }) => (
    `within ${reach} m${facing === null ? "" : `, looks to ${facing}°`}`
  ));
}

function rows(name, zones, words) {
  const old = new Map([...page[name].children].map((item) => [item.dataset.id, item]));
  arrange(page[name], zones.map((zone) => {
    const item = old.get(zone.id) ?? element("li", { "data-id": zone.id }, element("button", { type: "button", class: "row",
      onclick: () => choose(keptOf(zone) ?? null) }));
    const button = item.firstElementChild;
    button.setAttribute("aria-pressed", String(state.draft !== null && pathOf(zone) === pathOf(state.draft.zone)));
    button.replaceChildren(element("strong", {}, zone.name || zone.id), element("span", {}, words(zone)));
    return item;
  }));
}

function buttons() {
  page["zones-undo"].disabled = !state.draft?.undoable;
  page["zones-redo"].disabled = !state.draft?.redoable;
}

function changed() {
  canvas.draw();
  form.refresh();
  buttons();
}

async function choose(zone) {
  if (canvas.drawing || (zone && pathOf(zone)) === (state.draft && pathOf(state.draft.zone))) return;
  if (!(await mayLeave())) return;
  state.draft = zone === null ? null : new Draft(zone, zone.etag ?? "");
  show();
}

async function begin(shape) {
  if (state.floor === null || !(await mayLeave())) return;
  state.draft = null;
  show();
  canvas.begin(shape);
}

function drawn(shape, points) {
  const id = idFor({ area: "New area", line: "New line", point: "New exhibit" }[shape], taken(shape));
  const zone = shape === "point" ? newExhibit(id, state.floor.id, points)
    : { id, name: "", floor: state.floor.id, shape, points, rules: [] };
  if (shape !== "point") zone.rules.push(newRule(zone));
  state.draft = new Draft(zone, null);
  show();
  document.getElementById("zone-name").focus();
}

async function save() {
  const { draft } = state;
  const { zone, fresh, etag } = draft;
  if (!form.check()) return;
  // A name is what people see; the id follows it unless somebody chose one.
  if (fresh && /^new-(area|line|exhibit)/.test(zone.id) && zone.name !== "") {
    draft.change((now) => (now.id = idFor(now.name, taken(now.shape))));
  }
  page["zones-form"].inert = true;
  try {
    const answer = fresh
      ? await ask(kindOf(zone.shape), { method: "POST", body: bodyOf(draft.zone) })
      : await ask(pathOf(zone), { method: "PUT", body: bodyOf(draft.zone), ifMatch: etag });
    state.zones = await everything();
    const kept = keptOf({ shape: zone.shape, id: answer?.id ?? draft.zone.id });
    state.draft = kept === undefined ? null : new Draft(kept, kept.etag ?? "");
    show();
    say(`${draft.zone.name || draft.zone.id} is saved and holds from now on.`);
  } catch (refusal) {
    if (refusal.status === 412) await changedMeanwhile();
    else {
      if (zone.shape === "point" && /^[xy]\b/.test(refusal.field ?? "")) refusal.field = "points";
      show(refusal);
    }
  } finally {
    page["zones-form"].inert = false;
  }
}

async function changedMeanwhile() {
  const theirs = await asked(`Somebody else changed this ${state.draft.zone.shape === "point" ? "exhibit" : "zone"} meanwhile.`, "Show theirs", "Keep mine");
  state.zones = await everything();
  const now = keptOf(state.draft.zone);
  if (theirs) state.draft = now === undefined ? null : new Draft(now, now.etag ?? "");
  else state.draft.etag = now?.etag ?? null;
  show();
}

async function discard() {
  const { zone, fresh } = state.draft;
  state.draft = null;
  const kept = fresh ? undefined : keptOf(zone);
  if (kept !== undefined) state.draft = new Draft(kept, kept.etag ?? "");
  show();
}

async function remove() {
  const { zone, etag } = state.draft;
  const what = zone.shape === "point" ? "?" : " and its rules? Alerts told of it stay.";
  if (!(await asked(`Delete ${zone.name || zone.id}${what}`, "Delete", "Cancel"))) return;
  try {
    await ask(pathOf(zone), { method: "DELETE", ifMatch: etag });
    state.zones = await everything();
    state.draft = null;
    show();
    say(`${zone.name || zone.id} is gone.`);
  } catch (refusal) {
    if (refusal.status === 412) await changedMeanwhile();
    else show(refusal);
  }
}

async function mayLeave() {
  if (!state.draft?.changed) return true;
  const name = state.draft.zone.name || state.draft.zone.id;
  return asked(`The changes to ${name} are not saved.`, "Discard them", "Go on changing");
}

function asked(...words) {
  return question(page["zones-ask"], ...words);
}

function step(name) {
  if (!state.draft) return;
  state.draft[name]();
  show();
}

page["zones-area"].addEventListener("click", () => begin("area"));
page["zones-line"].addEventListener("click", () => begin("line"));
page["zones-point"].addEventListener("click", () => begin("point"));
page["zones-undo"].addEventListener("click", () => step("undo"));
page["zones-redo"].addEventListener("click", () => step("redo"));
page["zones-snap"].addEventListener("change", (event) => (canvas.snapping = event.target.checked));
page["zones-in"].addEventListener("click", () => (canvas.view.zoom(1.4), canvas.draw()));
page["zones-out"].addEventListener("click", () => (canvas.view.zoom(1 / 1.4), canvas.draw()));
page["zones-fit"].addEventListener("click", () => canvas.fit());
page["zones-floor"].addEventListener("change", async (event) => {
  const wished = state.site.floors.find((floor) => floor.id === event.target.value);
  event.target.value = state.floor.id;
  if (!(await mayLeave())) return;
  state.draft = null;
  canvas.cancel();
  showFloor(wished);
});
document.addEventListener("keydown", (event) => {
  if (!(event.ctrlKey || event.metaKey) || !["z", "Z", "y"].includes(event.key)) return;
  event.preventDefault();
  step(event.key === "z" ? "undo" : "redo");
});
window.addEventListener("beforeunload", (event) => {
  if (state.draft?.changed) event.preventDefault();
});

await load();

// For tests, and for the curious in the browser's console.
window.atriumZones = {
  toScreen: (x, y) => canvas.view.toScreen(x, y),
  get draft() {
    return state.draft?.zone ?? null;
  },
  get ready() {
    return state.floor !== null && canvas.view.width > 1;
  },
};
