// Camera set-up: a still, pairs of clicks (picture and plan), what comes of them at once, the area of interest, save.

import { bounds } from "./painting.js";
import { Picker } from "./picker.js";
import { appeared, ask, button, metres, numberInput, shownNumber, withoutWhatIsLacking } from "./setup-common.js";
import { known, paintPicture, paintPlaces, UNIT } from "./setup-painting.js";

const TRY_AFTER_MS = 250;
const TRY_AGAIN_AFTER_MS = 2000;
const USED_WITHIN_S = 20;

const page = await appeared([
  "setup-camera", "setup-still", "setup-file", "setup-mode", "setup-image", "setup-plan", "setup-say", "setup-told",
  "setup-pairs", "setup-interest", "setup-whole", "setup-undo", "setup-save", "setup-lens", "setup-rectangle", "setup-board",
  "setup-lacking",
]);
const state = { site: null, camera: null, floor: null, image: null, size: null, pairs: [], interest: [], trial: null, lens: true, wanted: 0 };
let waiting = null;
let [trying, tried] = [false, null];

const image = new Picker(page["setup-image"], {
  to: ([u, v]) => [u / UNIT, -v / UNIT],
  from: (x, y) => [round(x * UNIT, 10), round(-y * UNIT, 10)],
  paint: (context, view) => paintPicture(context, view, image, state, mode() === "interest"),
  points: () => (mode() === "interest" ? state.interest : state.pairs.map((pair) => (known(pair.pixel) ? pair.pixel : null))),
  placed: (pixel) => placed("pixel", pixel),
  waits: () => mode() === "pairs" && state.pairs.some((pair) => !known(pair.pixel)),
  moved: (index, pixel) => moved(index, "pixel", pixel),
  told: ([u, v]) => say(`Pixel ${u.toFixed(1)}, ${v.toFixed(1)}`),
});
const plan = new Picker(page["setup-plan"], {
  to: (place) => place,
  from: (x, y) => [round(x, 1000), round(y, 1000)],
  paint: (context, view) => paintPlaces(context, view, state),
  points: () => state.pairs.map((pair) => (known(pair.place) ? pair.place : null)),
  placed: (place) => placed("place", place),
  waits: () => state.pairs.some((pair) => !known(pair.place)),
  moved: (index, place) => moved(index, "place", place),
  told: ([x, y]) => say(`Plan ${x.toFixed(2)}, ${y.toFixed(2)} m`),
});

function round(value, by) {
  return Math.round(value * by) / by;
}

function mode() {
  return page["setup-mode"].querySelector("input:checked").value;
}

function say(text, wrong = false) {
  page["setup-say"].textContent = text;
  page["setup-say"].classList.toggle("wrong", wrong);
}

// --- clicks

function placed(what, value) {
  if (what === "pixel" && state.size === null) return say("Take a picture of the camera first, or choose a file.", true);
  if (what === "pixel" && !inside(value)) return say("Outside of the picture.", true);
  if (what === "pixel" && mode() === "interest") {
    state.interest.push(value);
    return changed(false);
  }
  const open = state.pairs.find((pair) => !known(pair[what]));
  if (open === undefined) state.pairs.push({ pixel: null, place: null, [what]: value });
  else open[what] = value;
  const missing = state.pairs.findIndex((pair) => !known(pair.pixel) || !known(pair.place));
  const where = missing >= 0 && !known(state.pairs[missing].pixel) ? "in the picture" : "on the plan";
  say(missing < 0 ? "" : `Now the same place ${where} (pair ${missing + 1}).`);
  changed();
}

function moved(index, what, value) {
  if (what === "pixel" && !inside(value)) return;
  if (what === "pixel" && mode() === "interest") state.interest[index] = value;
  else state.pairs[index][what] = value;
  changed(what === "place" || mode() !== "interest");
}

function inside([u, v]) {
  return u >= 0 && v >= 0 && u <= state.size[0] - 1 && v <= state.size[1] - 1;
}

function complete() {
  return state.pairs.filter((pair) => known(pair.pixel) && known(pair.place));
}

function changed(again = true) {
  list();
  image.redraw();
  plan.redraw();
  if (!again) return;
  state.wanted += 1;
  clearTimeout(waiting);
  waiting = setTimeout(attempt, TRY_AFTER_MS);
  // What is told is of the pairs as they were.
  if (complete().length >= 4 && state.size !== null) computing(true);
}

// --- what comes of it

// One trial at a time: who clicks faster than the API computes must not fill the queue that all share.
async function attempt() {
  if (trying) return;
  trying = true;
  try {
    while (tried !== state.wanted) {
      tried = state.wanted;
      await attemptOnce();
    }
  } finally {
    trying = false;
  }
}

async function attemptOnce() {
  const pairs = complete();
  if (pairs.length < 4 || state.size === null) {
    state.trial = null;
    tell([`${pairs.length} of at least 4 pairs; 6 to find a wrong click.`]);
    return changed(false);
  }
  try {
    const told = pairs.map(({ pixel, place }) => ({ pixel, place }));
    const order = { image_size: state.size, pairs: told, use_lens: state.lens };
    const trial = await (await ask(`cameras/${state.camera}/calibration/try`, order)).json();
    if (tried !== state.wanted) return;
    pairs.forEach((pair, index) => (pair.report = trial.pairs[index]));
    state.trial = trial;
    const alone = trial.median_alone_metres === null ? "" : `, ${metres(trial.median_alone_metres)} where nobody clicked`;
    tell([`Median residual ${metres(trial.median_metres)}${alone}.`, ...trial.words]);
  } catch (reason) {
    if (tried !== state.wanted) return;
    state.trial = null;
    for (const pair of state.pairs) delete pair.report;
    const full = reason.status === 429;
    tell([reason.message, ...(full ? ["It is tried again in a moment."] : [])], true);
    if (full) setTimeout(changed, TRY_AGAIN_AFTER_MS);
  }
  changed(false);
}

function computing(now) {
  const told = page["setup-told"];
  if (now && !told.classList.contains("computing")) told.prepend(Object.assign(document.createElement("li"), { textContent: "Computing… what follows is of the pairs before this change." }));
  for (const part of [told, page["setup-pairs"]]) {
    part.classList.toggle("computing", now);
    part.setAttribute("aria-busy", String(now));
  }
}

function tell(lines, wrong = false) {
  computing(false);
  page["setup-told"].replaceChildren(...lines.map((line) => Object.assign(document.createElement("li"), { textContent: line })));
  page["setup-told"].classList.toggle("wrong", wrong);
}

// Rows are made once and filled again and again: what somebody is typing must not vanish when an answer comes.
function list() {
  const rows = page["setup-pairs"].rows;
  while (rows.length > state.pairs.length) page["setup-pairs"].deleteRow(-1);
  while (rows.length < state.pairs.length) addRow(page["setup-pairs"].insertRow(), rows.length - 1);
  state.pairs.forEach((pair, index) => {
    const report = pair.report;
    const pixels = report?.off_pixels === null ? "–" : `${report?.off_pixels.toFixed(1)} px`;
    const off = report === undefined ? "–" : `${metres(report.off_metres)} / ${pixels}`;
    rows[index].classList.toggle("wrong", report?.used === false);
    [...rows[index].querySelectorAll("input")].forEach((input, column) => {
      const value = (column < 2 ? pair.pixel : pair.place)?.[column % 2];
      if (input !== document.activeElement) input.value = shownNumber(value);
    });
    rows[index].cells[5].textContent = report?.used === false ? `${off}, wrong click?` : off;
    rows[index].cells[6].textContent = metres(report?.alone_metres);
  });
  const corners = state.interest.length;
  page["setup-interest"].textContent = corners === 0 ? "The whole picture counts." : `${corners} corners${corners < 3 ? ": at least 3 are needed" : ""}.`;
}

function addRow(row, index) {
  const cell = (content) => row.insertCell().append(content);
  const set = (what, axis) => (value) => {
    if (value === null) return list(); // an emptied field takes nothing back: remove the pair for that
    const now = state.pairs[index][what] ?? [null, null];
    state.pairs[index][what] = axis === 0 ? [value, now[1]] : [now[0], value];
    changed();
  };
  cell(`${index + 1}`);
  for (const [what, axis, name, unit] of [["pixel", 0, "u", "px"], ["pixel", 1, "v", "px"], ["place", 0, "x", "m"], ["place", 1, "y", "m"]]) {
    cell(numberInput(null, `Pair ${index + 1}, ${name}`, set(what, axis)));
    row.cells[row.cells.length - 1].dataset.label = `${name}, ${unit}`;
  }
  row.insertCell().dataset.label = "Off:";
  row.insertCell().dataset.label = "Off by the others:";
  cell(button("✕", `Remove pair ${index + 1}`, () => {
    state.pairs.splice(index, 1);
    changed();
  }));
}

// --- pictures

async function show(blob) {
  state.image = await createImageBitmap(blob);
  const size = [state.image.width, state.image.height];
  if (state.size !== null && (state.size[0] !== size[0] || state.size[1] !== size[1])) rescale(size);
  state.size = size;
  image.show([0, -size[1] / UNIT, size[0] / UNIT, 0]);
  changed();
}

// Pairs that were read off at another size of the same picture.
function rescale(size) {
  const scaled = (pixel) => known(pixel) ? pixel.map((value, axis) => round(((value + 0.5) * size[axis]) / state.size[axis] - 0.5, 100)) : null;
  for (const pair of state.pairs) pair.pixel = scaled(pair.pixel);
  state.interest = state.interest.map(scaled);
}

async function take() {
  say("Asking the camera for a picture…");
  try {
    await ask(`cameras/${state.camera}/still`, {});
    await show(await (await ask(`cameras/${state.camera}/still`)).blob());
    say("This picture is in your browser only. Click the first place on the floor, in the picture or on the plan.");
  } catch (reason) {
    say(reason.message, true);
  }
}

// --- known shapes on the floor

function fields(form, names) {
  const given = Object.fromEntries(names.map((name) => [name, Number(form.querySelector(`[name=${name}]`).value)]));
  return names.every((name) => Number.isFinite(given[name])) ? given : null;
}

function rectangle(event) {
  event.preventDefault();
  const given = fields(page["setup-rectangle"], ["x", "y", "angle", "width", "depth"]);
  if (given === null || given.width <= 0 || given.depth <= 0) return say("A rectangle needs five numbers, width and depth above 0.", true);
  const [cosine, sine] = [Math.cos((given.angle * Math.PI) / 180), Math.sin((given.angle * Math.PI) / 180)];
  for (const [along, across] of [[0, 0], [given.width, 0], [given.width, given.depth], [0, given.depth]]) {
    const place = [given.x + along * cosine - across * sine, given.y + along * sine + across * cosine];
    state.pairs.push({ pixel: null, place: place.map((value) => round(value, 1000)) });
  }
  say("Now click its corners in the picture, in the order of their numbers on the plan.");
  changed();
}

async function board(event) {
  event.preventDefault();
  const given = fields(page["setup-board"], ["columns", "rows", "square", "x", "y", "angle"]);
  if (given === null || given.square <= 0) return say("A checkerboard needs six numbers, its square above 0.", true);
  say("Looking for the checkerboard…");
  try {
    const query = `columns=${given.columns}&rows=${given.rows}`;
    const found = await (await ask(`cameras/${state.camera}/board?${query}`)).json();
    if (state.size === null) throw new Error("Take a picture of the camera first: the corners are shown in it.");
    const corners = page["setup-board"].querySelector("[name=turned]").checked ? found.corners.reverse() : found.corners;
    const { columns, rows, square, angle } = given;
    const boards = [{ pixels: corners, columns, rows, square, corner: [given.x, given.y], angle }];
    const order = { image_size: found.image_size, boards, use_lens: state.lens };
    const trial = await (await ask(`cameras/${state.camera}/calibration/try`, order)).json();
    for (const { pixel, place } of trial.pairs) state.pairs.push({ pixel, place });
    say(`${trial.pairs.length} corners were added. Is the first one (pair ${state.pairs.length - trial.pairs.length + 1}) where the board begins? Else remove them and turn the board.`);
    changed();
  } catch (reason) {
    say(reason.message, true);
  }
}

// --- beginning and end

async function choose(camera) {
  state.camera = camera;
  state.wanted += 1; // what is being tried is of another camera
  Object.assign(state, { image: null, pairs: [], interest: [], trial: null });
  try {
    const told = await (await ask(`cameras/${camera}/calibration`)).json();
    state.size = told.image_size;
    state.pairs = told.pairs.map(({ pixel, place }) => ({ pixel, place }));
    state.interest = told.area_of_interest ?? [];
    state.floor = state.site.floors.find((floor) => floor.id === told.floor);
    page["setup-lens"].closest("label").hidden = !told.lens;
    plan.show(bounds(state.floor.outline));
    const by = told.saved === null ? "as the site file says" : `saved ${new Date(1000 * told.saved).toLocaleString()} by ${told.by}`;
    say(`${camera}: ${by}${told.pending ? "; the camera does not use it yet" : ""}. Take a picture to begin.`);
    changed();
  } catch (reason) {
    say(reason.message, true);
  }
}

async function save() {
  const pairs = complete().map(({ pixel, place }) => ({ pixel, place }));
  if (pairs.length < state.pairs.length) return say("Some pairs lack their picture or their plan: finish or remove them.", true);
  if (pairs.length < 4) return say("At least 4 pairs are needed.", true);
  if (state.interest.length > 0 && state.interest.length < 3) return say("An area of interest needs 3 corners or more.", true);
  try {
    const order = { image_size: state.size, pairs, area_of_interest: state.interest.length ? state.interest : null, use_lens: state.lens };
    const told = await (await ask(`cameras/${state.camera}/calibration`, order)).json();
    say(told.words);
    await follow(state.camera, told.words);
  } catch (reason) {
    say(reason.message, true);
  }
}

// Whether the camera uses what was saved, for as long as somebody waits for it.
async function follow(camera, words) {
  for (let second = 0; second < USED_WITHIN_S; second += 1) {
    await new Promise((after) => setTimeout(after, 1000));
    if (state.camera !== camera || page["setup-say"].textContent !== words) return;
    if (!(await (await ask(`cameras/${camera}/calibration`)).json()).pending) {
      return say(`${words} The camera uses it now: walk through the picture, and you are a dot on the live map.`);
    }
  }
  say(`${words} The camera does not use it yet: the health page says how it is doing.`, true);
}

for (const [name, act] of [["setup-still", take], ["setup-save", save]]) page[name].addEventListener("click", act);
page["setup-camera"].addEventListener("change", (event) => choose(event.target.value));
page["setup-mode"].addEventListener("change", () => changed(false));
page["setup-file"].addEventListener("change", (event) => event.target.files[0] && show(event.target.files[0]).catch(() => say("This file is no picture.", true)));
page["setup-lens"].addEventListener("change", (event) => {
  state.lens = event.target.checked;
  changed();
});
page["setup-rectangle"].addEventListener("submit", rectangle);
page["setup-board"].addEventListener("submit", board);
page["setup-whole"].addEventListener("click", () => {
  state.interest = [];
  changed(false);
});
page["setup-undo"].addEventListener("click", () => {
  state.interest.pop();
  changed(false);
});
for (const kind of ["pointermove", "pointerleave"]) {
  page["setup-image"].addEventListener(kind, (event) => {
    image.pointer = kind === "pointermove" && event.pointerType === "mouse" ? [event.offsetX, event.offsetY] : null;
    image.redraw();
  });
}

window.cameraSetup = { state, image, plan }; // for tests

withoutWhatIsLacking(page["setup-lacking"], ["stills", "take a camera's picture", page["setup-still"]],
  ["setup", "save a calibration", page["setup-save"]]);
try {
  state.site = await (await ask("site")).json();
  if (state.site.cameras.length === 0) say("This site has no camera: write one into the site file first (docs/camera-setup.md).", true);
  for (const { id } of state.site.cameras) page["setup-camera"].append(new Option(id, id));
  const wanted = new URLSearchParams(window.location.search).get("camera");
  if (state.site.cameras.some(({ id }) => id === wanted)) page["setup-camera"].value = wanted;
  if (state.site.cameras.length > 0) await choose(page["setup-camera"].value);
} catch (reason) {
  say(reason.message, true);
}
