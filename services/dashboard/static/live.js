// The live map: listens to /live, keeps the picture moving, and says in plain words when it cannot.

import { appeared, count, remember, remembered } from "./dom.js";
import { Evidence } from "./evidence.js";
import { asPoint } from "./exhibits.js";
import { Ground } from "./ground.js";
import { Identities } from "./identities.js";
import * as painting from "./painting.js";
import { Panels } from "./panels.js";
import { paintMarker, paintPeople } from "./people_painting.js";
import { Pointer } from "./pointer.js";
import { Tracks } from "./tracks.js";
import { Trails } from "./trails.js";
import { Viewport } from "./viewport.js";
import { cornersOf, paintLit } from "./zone_painting.js";

const DRAW_EVERY_MS = 30; // people walk: thirty pictures a second are smooth, and half the work of sixty
const RATE_OVER_MS = 3000;
const FRAME_TIMES_KEPT = 2000;
const REACH = 18; // pixels a tap may miss somebody by

const identities = new Identities();
const tracks = new Tracks();
const view = new Viewport();
const state = { site: null, floor: null, zones: null, exhibits: [], lit: new Map(), chosen: null, marker: null };
const heard = { api: false, reason: "", dashboard: false, frame: null, arrivals: [] };
const layers = {};
let fitted = null;
let drawn = 0;
let firstDrawn = null;
const frameTimes = []; // milliseconds between two pictures
let people = [];

// NiceGUI builds the page after this module has loaded.
const page = await appeared(["atrium-canvas", "atrium-evidence", "atrium-floor", "atrium-status", "alerts", "phones", "cameras"]);
const canvas = page["atrium-canvas"];
const context = canvas.getContext("2d");
const ground = new Ground();
const trails = new Trails();
const panels = new Panels(identities, goTo, (device) => (state.chosen = device), (device) => {
  const found = people.find((person) => person.device === device);
  if (found !== undefined) evidence.open(found);
});
const evidence = new Evidence(page["atrium-evidence"], identities, () => canvas.focus({ preventScroll: true }));

function listen() {
  const source = new EventSource("/live");
  const on = (name, act) => source.addEventListener(name, (event) => act(JSON.parse(event.data)));
  source.onopen = () => (heard.dashboard = true);
  source.onerror = async () => {
    heard.dashboard = false;
    if (source.readyState !== EventSource.CLOSED) return; // the browser tries again by itself
    await new Promise((resolve) => setTimeout(resolve, 2000));
    const session = await fetch("/session").catch(() => null);
    if (session?.status === 401) window.location.assign("/login");
    else listen();
  };
  on("connection", (news) => {
    if (!news.connected) {
      tracks.clear();
      state.zones = state.zones?.map(({ inside, ...zone }) => zone) ?? null;
    }
    heard.api = news.connected;
    heard.reason = news.reason;
  });
  on("site", takeSite);
  on("zones", (zones) => {
    state.zones = zones;
    panels.zones(zones);
  });
  on("exhibits", (exhibits) => (state.exhibits = exhibits.map(asPoint)));
  on("tracks", (frame) => {
    const now = performance.now();
    tracks.accept(frame, now);
    heard.frame = now;
    heard.arrivals.push({ area: frame.area, at: now });
  });
  on("alerts", (alerts) => panels.alerts(alerts));
  on("alert", (alert) => {
    state.lit.set(alert.zone, performance.now());
    panels.alert(alert);
  });
  on("cameras", (cameras) => panels.cameras(cameras));
}

function takeSite(site) {
  state.site = site;
  const select = page["atrium-floor"];
  const sorted = [...site.floors].sort((a, b) => (b.level ?? 0) - (a.level ?? 0));
  select.replaceChildren(...sorted.map((floor) => new Option(floor.name || floor.id, floor.id)));
  const wished = state.floor?.id ?? remembered("floor");
  chooseFloor(site.floors.some((floor) => floor.id === wished) ? wished : site.floors[0].id);
  select.parentElement.hidden = site.floors.length < 2;
  panels.site(site);
  goToHash();
}

function chooseFloor(id) {
  const floor = state.site?.floors.find((one) => one.id === id);
  if (floor === undefined) return;
  state.floor = floor;
  page["atrium-floor"].value = id;
  remember("floor", id);
  if (fitted !== id) fit();
}

function fit() {
  if (state.floor === null) return;
  view.fit(painting.bounds(state.floor.outline));
  fitted = state.floor.id;
}

function goTo(floor, x, y) {
  chooseFloor(floor);
  view.centre(x, y);
  state.marker = { floor, x, y, since: performance.now() };
}

// "/#floor=ground&x=9&y=1" shows that place: the inbox sends people here.
function goToHash() {
  const wished = new URLSearchParams(window.location.hash.slice(1));
  const [x, y] = ["x", "y"].map((axis) => Number.parseFloat(wished.get(axis)));
  if (!Number.isFinite(x) || !Number.isFinite(y)) return;
  history.replaceState(null, "", window.location.pathname);
  goTo(wished.get("floor"), x, y);
}

// Staff may have drawn others than the site file has.
function zones() {
  return state.zones ?? state.site.zones;
}

function zoneOf({ floor, x, y }) {
  const found = zones().find((zone) => (
    zone.floor === floor && zone.shape !== "line" && painting.inside(cornersOf(zone), x, y)
  ));
  return found === undefined ? null : found.name || found.id;
}

// Zones of which an alert has just come.
function shine(floor, now) {
  for (const [id, since] of state.lit) {
    const zone = zones().find((one) => one.id === id);
    const still = zone !== undefined && (zone.floor !== floor.id || paintLit(context, view, zone, since, now));
    if (!still) state.lit.delete(id);
  }
}

// Who stands nearest to this place on the screen?
function tap(px, py) {
  let best = null;
  for (const person of people) {
    if (person.floor !== state.floor?.id || person.gone !== null) continue;
    const [x, y] = view.toScreen(person.x, person.y);
    const far = Math.hypot(x - px, y - py) - (person.device === null ? 0 : 4);
    if (far < REACH && (best === null || far < best.far)) best = { far, person };
  }
  if (best === null) evidence.close();
  else evidence.open(best.person);
}

// The next person on this floor, from left to right; people with a phone first.
function step(by) {
  const here = people.filter((person) => person.floor === state.floor?.id && person.gone === null);
  if (here.length === 0) return;
  here.sort((a, b) => (a.device === null) - (b.device === null) || a.key.localeCompare(b.key, undefined, { numeric: true }));
  const now = here.findIndex((person) => evidence.is(person));
  const next = now < 0 ? (by > 0 ? 0 : here.length - 1) : (now + by + here.length) % here.length;
  evidence.open(here[next]);
}

function draw(now) {
  requestAnimationFrame(draw);
  if (now - drawn < DRAW_EVERY_MS) return;
  if (firstDrawn !== null) frameTimes.push(now - drawn);
  if (frameTimes.length > FRAME_TIMES_KEPT) frameTimes.shift();
  drawn = now;
  people = tracks.at(now);
  const ratio = window.devicePixelRatio || 1;
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, view.width, view.height);
  if (state.floor === null) return;
  const { floor, site } = state;
  context.drawImage(ground.picture(view, ratio, site, floor, zones(), state.exhibits, layers), 0, 0, view.width, view.height);
  if (layers.zones) shine(floor, now);
  const here = people.filter((person) => person.floor === floor.id);
  if (layers.trails) trails.draw(context, view, ratio, floor, here, identities, now);
  paintPeople(context, view, here, identities, layers, (person) => (
    evidence.is(person) || (state.chosen !== null && person.device === state.chosen)
  ));
  if (state.marker?.floor === floor.id && !paintMarker(context, view, state.marker, now)) state.marker = null;
  firstDrawn ??= performance.now();
}

// Once or twice a second is enough for words.
function tell() {
  const now = performance.now();
  heard.arrivals = heard.arrivals.filter((arrival) => arrival.at > now - RATE_OVER_MS);
  const problem = whatIsWrong(now);
  const banner = document.getElementById("atrium-banner");
  if (banner.textContent !== problem) banner.textContent = problem;
  banner.hidden = problem === "";
  const present = people.filter((person) => person.gone === null);
  const seen = present.filter((person) => person.state !== "unseen");
  const unseen = present.length - seen.length;
  const located = seen.filter((person) => person.device !== null).length;
  const status = page["atrium-status"];
  status.classList.toggle("bad", problem !== "");
  // What is shown without a connection is memory, not the present.
  document.body.classList.toggle("stale", !(heard.api && heard.dashboard));
  if (problem === "") {
    const rate = updatesPerSecond(now);
    const age = (now - heard.frame) / 1000;
    status.textContent =
      `${count(seen.length, "person", "people")}, ${located} with a located phone` +
      `${unseen > 0 ? `, ${count(unseen, "phone", "phones")} out of view` : ""} · ` +
      `${rate.toFixed(rate < 10 ? 1 : 0)} updates a second · last ${age.toFixed(1)} s ago`;
  } else {
    status.textContent = heard.api && heard.dashboard ? "Waiting for positions" : "Not connected";
  }
  if (state.floor !== null) {
    const here = seen.filter((person) => person.floor === state.floor.id).length;
    const name = state.floor.name || state.floor.id;
    canvas.setAttribute("aria-label", `Floor plan of ${name} with ${count(here, "person", "people")}`);
    panels.phones(present, zoneOf, now);
    evidence.follow(people, zoneOf);
  }
}

function whatIsWrong(now) {
  if (!heard.dashboard) return "Not connected: the dashboard does not answer. Trying again…";
  if (!heard.api) return `Not connected to the API. ${heard.reason} Trying again…`;
  if (heard.frame === null) return "Connected, but no positions have arrived yet: are a camera and fusion running?";
  const silent = (now - heard.frame) / 1000;
  if (silent > 5) return `No positions for ${Math.round(silent)} seconds: are the cameras and fusion running?`;
  return "";
}

// Of one area, on average: areas are tracked side by side.
function updatesPerSecond(now) {
  if (heard.arrivals.length === 0) return 0;
  const areas = new Set(heard.arrivals.map((arrival) => arrival.area)).size;
  const span = Math.max(now - heard.arrivals[0].at, 500) / 1000;
  return heard.arrivals.length / areas / span;
}

function wireControls() {
  for (const box of document.querySelectorAll("#atrium-layers input")) {
    box.checked = (remembered(box.value) ?? "on") === "on";
    layers[box.value] = box.checked;
    box.addEventListener("change", () => {
      layers[box.value] = box.checked;
      remember(box.value, box.checked ? "on" : "off");
    });
  }
  page["atrium-floor"].addEventListener("change", (event) => chooseFloor(event.target.value));
  document.getElementById("zoom-in").addEventListener("click", () => view.zoom(1.4));
  document.getElementById("zoom-out").addEventListener("click", () => view.zoom(1 / 1.4));
  document.getElementById("zoom-fit").addEventListener("click", fit);
  new Pointer(canvas, view, fit, { tap });
  canvas.addEventListener("keydown", (event) => {
    const act = { n: () => step(1), p: () => step(-1), Escape: () => evidence.close() }[event.key];
    if (act === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    act();
  });
  new ResizeObserver(() => {
    const ratio = window.devicePixelRatio || 1;
    const first = view.width === 1;
    view.resize(canvas.clientWidth, canvas.clientHeight);
    canvas.width = Math.round(canvas.clientWidth * ratio);
    canvas.height = Math.round(canvas.clientHeight * ratio);
    if (first) fit();
  }).observe(canvas);
}

wireControls();
listen();
requestAnimationFrame(draw);
setInterval(tell, 500);

// What the map shows, for tests and for the curious in the browser's console.
window.atrium = {
  tracks: () => people.map(({ key, track, floor, device, probability, state: how, accuracy, x, y }) => (
    { key, track, floor, device, probability, state: how, accuracy, x, y, screen: view.toScreen(x, y) }
  )),
  get frames() {
    return tracks.frames;
  },
  get floor() {
    return state.floor?.id ?? null;
  },
  get connected() {
    return heard.dashboard && heard.api;
  },
  get scale() {
    return view.scale;
  },
  // When the first picture of the floor was drawn, and how long each picture stood, in milliseconds.
  get firstDrawn() {
    return firstDrawn;
  },
  frameTimes,
  toScreen: (x, y) => view.toScreen(x, y),
  lookOf: (device) => [identities.colourOf(device), identities.shapeOf(device)],
};
