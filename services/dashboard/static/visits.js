// Where people linger, how they move on, how many there are: four pictures of one period, asked of the API's history.

import { ask } from "./ask.js";
import { appeared, duration, element, remember, remembered } from "./dom.js";
import { savePicture, saveTable, show } from "./save_file.js";
import { atSite, dayBefore, wallClock, words } from "./site_time.js";
import { dwellPicture, flowPicture, heatPicture, occupancyPicture } from "./visit_pictures.js";

const FEW = "fewer than 5 people";
const BRIGHTEST = 0.98; // share of cells that are not the very brightest: one guard's chair must not darken the hall
const MOST = { lines: 12, bars: 30, ways: 12 }; // in a picture: of more nobody sees anything; tables and numbers have all
const MOST_VALUES = 50000; // of one question about occupancy, zones times steps: the API refuses more
const STEPS = [300, 1800, 3600, 7200, 10800, 21600, 43200, 86400]; // seconds; each divides a day
const MOST_ROWS = 100; // of a table, until somebody wants all

const page = await appeared(["visits-main", "visits-period", "visits-other", "visits-since", "visits-until", "visits-floor", "visits-cell", "visits-at",
  "visits-told", "heat-picture", "occupancy-picture", "dwell-picture", "flows-picture"]);
const { time_zone: timeZone, site: title } = JSON.parse(page["visits-main"].dataset.given);
const state = { site: null, names: new Map(), areas: 0, turn: 0, shown: {} };

// What each card asks, makes of the answer, and saves.
const CARDS = {
  heat: {
    ask: (period) => ask("heatmap", { query: { floor: page["visits-floor"].value, ...period, cell: page["visits-cell"].value } }),
    read(heat) {
      const floor = state.site.floors.find((one) => one.id === heat.floor);
      const known = heat.seconds.flat().filter((value) => value !== null && value > 0).sort((a, b) => a - b);
      const few = heat.seconds.flat().filter((value) => value === null).length;
      if (known.length === 0) return few === 0 ? null : { nothing: "Fewer than five people were in any cell: nothing is told." };
      return { floor, heat, most: known[Math.min(Math.floor(BRIGHTEST * known.length), known.length - 1)] };
    },
    picture: heatPicture,
    say: ({ floor, heat }) => {
      const best = { seconds: 0, i: 0, j: 0 };
      heat.seconds.forEach((row, j) => row.forEach((seconds, i) => seconds > best.seconds && Object.assign(best, { seconds, i, j })));
      const at = [best.i, best.j].map((n, axis) => (heat.origin[axis] + (n + 0.5) * heat.cell).toFixed(1));
      return `Heat map of ${floor.name || floor.id}: people stayed longest around ${at.join(", ")} m, ${duration(best.seconds)} together.`;
    },
    table: null,
    rows: ({ heat }) => [["x_m", "y_m", "person_seconds", "people"], heat.seconds.flatMap((row, j) => row.map((seconds, i) => [
      Number((heat.origin[0] + (i + 0.5) * heat.cell).toFixed(3)), Number((heat.origin[1] + (j + 0.5) * heat.cell).toFixed(3)),
      seconds, heat.people[j][i],
    ]))],
  },
  occupancy: {
    ask: async (period) => {
      const step = stepOf(period);
      return { ...(await ask("occupancy", { query: { ...period, step } })), step };
    },
    read({ t, places, step }) {
      const all = places.map(({ id, people, most }) => ({ id, name: nameOf(id), people, most }))
        .filter(({ people }) => people.some((value) => value !== null));
      if (all.length === 0 || t.length === 0) return null;
      const series = foremost(all, MOST.lines, ({ people }) => people.reduce((sum, value) => sum + (value ?? 0), 0));
      return { t, step, timeZone, all, series, note: noted("fullest", series, all) };
    },
    picture: occupancyPicture,
    say: ({ series }) => `People over time: ${series.map(({ name, people }) => `${name} up to ${Math.max(...people.map((v) => v ?? 0)).toFixed(0)}`).join(", ")}.`,
    table: ({ all }) => [["Zone", "In the mean", "At most"], all.map(({ name, people, most }) => {
      const known = people.filter((value) => value !== null);
      const peak = Math.max(...(most ?? people).map((value) => value ?? 0));
      return [name, (known.reduce((sum, value) => sum + value, 0) / known.length).toFixed(1), peak.toFixed(0)];
    })],
    rows: ({ t, all }) => [["begins", "zone", "mean_people", "most_people"], t.flatMap((when, i) => all.map(({ id, people, most }) => (
      [new Date(1000 * when).toISOString(), id, people[i], most?.[i] ?? null]
    )))],
  },
  dwell: {
    ask: (period) => ask("dwell", { query: { ...period, at: page["visits-at"].value } }),
    read({ places }) {
      const all = places.map((row) => ({ ...row, name: nameOf(row.id) }));
      const rows = foremost(all, MOST.bars, ({ visits }) => visits ?? 0);
      return all.length === 0 ? null : { all, rows, note: noted("most visited", rows, all) };
    },
    picture: dwellPicture,
    say: ({ rows }) => `Stays: ${rows.map(({ name, median }) => `${name} ${median === null ? FEW : duration(median)}`).join(", ")}.`,
    table: ({ all }) => [["Place", "People", "Visits", "Mean", "Median", "9 in 10 less than"], all.map((row) => (
      row.median === null ? [row.name, FEW, "", "", "", ""]
        : [row.name, row.people, row.visits, duration(row.mean), duration(row.median), duration(row.p90)]
    ))],
    rows: ({ all }) => [["place", "people", "visits", "mean_s", "median_s", "p90_s"],
      all.map((row) => [row.id, row.people, row.visits, row.mean, row.median, row.p90])],
  },
  flows: {
    ask: (period) => ask("flows", { query: { ...period, at: page["visits-at"].value } }),
    read(all) {
      const { zones, counts } = all;
      if (zones.length === 0) return null;
      const ways = zones.map((_, k) => counts.reduce((sum, row, j) => sum + (j === k ? 0 : (row[k] ?? 0) + (counts[k][j] ?? 0)), 0));
      const drawn = foremost([...zones.keys()], MOST.ways, (k) => ways[k]);
      return {
        all, names: drawn.map((k) => nameOf(zones[k])), counts: drawn.map((j) => drawn.map((i) => counts[j][i])),
        note: noted("most walked", drawn, zones),
      };
    },
    picture: flowPicture,
    say: ({ all: { zones, counts } }) => {
      const best = { value: 0, words: "too few to tell" };
      counts.forEach((row, j) => row.forEach((value, i) => {
        if (i !== j && value > best.value) Object.assign(best, { value, words: `from ${nameOf(zones[j])} to ${nameOf(zones[i])}, ${value} times` });
      }));
      return `Ways: most often ${best.words}.`;
    },
    table: null,
    rows: ({ all: { zones, counts } }) => [["from", "to", "people"], counts.flatMap((row, j) => row.map((value, i) => [zones[j], zones[i], value]))],
  },
};

// Those of `all` with the most by `worth`, in the order they had.
function foremost(all, most, worth) {
  if (all.length <= most) return all;
  const places = [...all.keys()].sort((a, b) => worth(all[b]) - worth(all[a]) || a - b).slice(0, most);
  return places.sort((a, b) => a - b).map((place) => all[place]);
}

function noted(how, drawn, all) {
  return drawn.length === all.length ? "" : `The ${drawn.length} ${how} of ${all.length}; the numbers that can be saved are of all.`;
}

function nameOf(id) {
  return state.names.get(id) ?? id;
}

function period() {
  const now = Date.now() / 1000;
  const chosen = page["visits-period"].value;
  if (chosen === "other") {
    const [since, until] = ["since", "until"].map((name) => page[`visits-${name}`].value);
    return since === "" || until === "" ? null : { since: atSite(since, timeZone), until: atSite(until, timeZone) };
  }
  const days = Number(chosen);
  const midnight = (before) => atSite(dayBefore(now, before, timeZone), timeZone);
  if (days === 0) return { since: midnight(0), until: Math.ceil(now) };
  return { since: midnight(days), until: midnight(0) };
}

// Fine enough to see a day's course, coarse enough to read, and never more values than the API gives.
function stepOf({ since, until }) {
  const long = until - since;
  const wished = long <= 6 * 3600 ? 300 : long <= 2 * 86400 ? 1800 : long <= 8 * 86400 ? 10800 : 86400;
  // Two more: a step is cut at either end, and a day may have 25 hours.
  const step = STEPS.find((one) => one >= wished && (Math.ceil(long / one) + 2) * state.areas <= MOST_VALUES);
  if (step === undefined) throw new Error("There are too many zones for so long a period: choose a shorter one.");
  return step;
}

async function refresh() {
  const turn = ++state.turn;
  const now = period();
  const told = page["visits-told"];
  const names = Object.keys(CARDS);
  const chosen = now !== null && now.until > now.since;
  for (const name of names) asking(name, chosen);
  if (!chosen) {
    told.textContent = "Choose a beginning and a later end.";
    return;
  }
  told.textContent = `${words(now.since, timeZone)} to ${words(now.until, timeZone)}, ${timeZone}`;
  try {
    if (state.site === null) await begin();
  } catch (refusal) {
    for (const name of names) nothing(name, refusal.message);
    setTimeout(() => turn === state.turn && refresh(), 5000);
    return;
  }
  await Promise.all(Object.entries(CARDS).map(async ([name, card]) => {
    try {
      const answer = await card.ask(now);
      if (turn !== state.turn) return;
      const data = card.read(answer);
      if (data === null) nothing(name, "Nothing is known of this period.");
      else if (data.nothing) nothing(name, data.nothing);
      else draw(name, data, now);
    } catch (refusal) {
      if (turn === state.turn) nothing(name, refusal.message);
    }
  }));
}

async function begin() {
  const [site, { zones }, { exhibits }] = await Promise.all([ask("site"), ask("zones"), ask("exhibits").catch(none)]);
  state.site = site;
  state.areas = zones.filter(({ shape }) => shape !== "line").length;
  state.names = new Map([...exhibits, ...zones].map((place) => [place.id, place.name || place.id]));
  page["visits-at"].parentElement.hidden = exhibits.length === 0;
  const floors = [...site.floors].sort((a, b) => (b.level ?? 0) - (a.level ?? 0));
  page["visits-floor"].replaceChildren(...floors.map((floor) => new Option(floor.name || floor.id, floor.id)));
  page["visits-floor"].parentElement.hidden = floors.length < 2;
  const wished = remembered("floor");
  page["visits-floor"].value = floors.some((floor) => floor.id === wished) ? wished : floors.at(-1).id;
}

// An API that keeps no exhibits has none.
function none(refusal) {
  if (refusal.status === 404) return { exhibits: [] };
  throw refusal;
}

// Until the answer comes a card shows what it showed before: it pales, and says that it is about to change.
function asking(name, now) {
  document.getElementById(`${name}-picture`).closest("section").setAttribute("aria-busy", String(now));
}

function nothing(name, why) {
  asking(name, false);
  delete state.shown[name];
  const problem = document.getElementById(`${name}-problem`);
  problem.textContent = why;
  problem.hidden = false;
  document.getElementById(`${name}-picture`).hidden = true;
  document.getElementById(`${name}-table`).replaceChildren();
  for (const kind of ["png", "csv"]) document.getElementById(`${name}-${kind}`).disabled = true;
}

function draw(name, data, when) {
  asking(name, false);
  state.shown[name] = { data, when };
  document.getElementById(`${name}-problem`).hidden = true;
  const canvas = document.getElementById(`${name}-picture`);
  canvas.hidden = false;
  canvas.setAttribute("aria-label", CARDS[name].say(data));
  show(canvas, CARDS[name].picture, data);
  const table = CARDS[name].table?.(data);
  drawTable(document.getElementById(`${name}-table`), table);
  for (const kind of ["png", "csv"]) document.getElementById(`${name}-${kind}`).disabled = false;
}

function drawTable(place, table, most = MOST_ROWS) {
  if (!table) return place.replaceChildren();
  const [header, rows] = table;
  const all = element("button", { type: "button", onclick: () => drawTable(place, table, rows.length) }, `Show all ${rows.length}`);
  place.replaceChildren(tableOf(header, rows.slice(0, most)), rows.length > most ? element("div", { class: "orders" }, all) : "");
}

function tableOf(header, rows) {
  return element("table", {}, element("thead", {}, element("tr", {}, ...header.map((name) => element("th", { scope: "col" }, name)))),
    element("tbody", {}, ...rows.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, first),
      ...rest.map((value, i) => element("td", { "data-head": header[i + 1] }, String(value)))))));
}

for (const [name, card] of Object.entries(CARDS)) {
  const heading = document.getElementById(`${name}-heading`).firstChild.textContent.trim();
  const file = ({ since }) => `${name}-${wallClock(since, timeZone).slice(0, 10)}`;
  document.getElementById(`${name}-png`).addEventListener("click", () => {
    const { data, when } = state.shown[name];
    const floor = data.floor ? `, ${data.floor.name || data.floor.id}` : "";
    savePicture(card.picture, data, `${heading}: ${title}${floor}, ${words(when.since, timeZone)} – ${words(when.until, timeZone)}`, file(when));
  });
  document.getElementById(`${name}-csv`).addEventListener("click", () => {
    const { data, when } = state.shown[name];
    saveTable(...card.rows(data), file(when));
  });
}
for (const name of ["period", "since", "until", "floor", "cell", "at"]) {
  page[`visits-${name}`].addEventListener("change", () => {
    page["visits-other"].hidden = page["visits-period"].value !== "other";
    if (name === "floor") remember("floor", page["visits-floor"].value);
    refresh();
  });
}
let wide = window.innerWidth;
window.addEventListener("resize", () => {
  if (window.innerWidth === wide) return; // a phone's address bar comes and goes
  wide = window.innerWidth;
  for (const [name, { data }] of Object.entries(state.shown)) show(document.getElementById(`${name}-picture`), CARDS[name].picture, data);
});
refresh();
