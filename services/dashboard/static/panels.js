// The lists beside the map: alerts, located phones, cameras. Rows are rebuilt only when what they say has changed.

import { inWords } from "./alert_words.js";
import { cameraInWords } from "./camera_words.js";
import { spoken } from "./dom.js";

const ALERTS_SHOWN = 50;
const LOST_AFTER_MS = 3000;
const FORGOTTEN_AFTER_MS = 120000;

export class Panels {
  #identities;
  #go;
  #choose;
  #shown = new Map();
  #seen = new Map();
  #alerts = [];
  #cameras = null;
  #site = null;
  #zones = new Map();
  #explain;

  // `go(floor, x, y)` shows a place on the map, `choose(device or null)` points a person out, `explain(device)` tells
  // why that person is thought to carry it.
  constructor(identities, go, choose, explain) {
    this.#identities = identities;
    this.#go = go;
    this.#choose = choose;
    this.#explain = explain;
  }

  site(site) {
    this.#site = site;
    if (this.#zones.size === 0) this.zones(site.zones);
    this.#drawCameras();
  }

  zones(zones) {
    this.#zones = new Map(zones.map((zone) => [zone.id, zone.name || zone.id]));
    this.#drawAlerts();
  }

  alerts(newestFirst) {
    this.#alerts = newestFirst;
    this.#drawAlerts();
  }

  alert(one) {
    if (this.#alerts.some((known) => known.id === one.id)) return;
    this.#alerts = [one, ...this.#alerts].slice(0, 2 * ALERTS_SHOWN);
    this.#drawAlerts();
  }

  cameras(cameras) {
    this.#cameras = new Map(cameras.map((camera) => [camera.camera, camera]));
    this.#drawCameras();
  }

  // `people`: everybody on the map now, on whatever floor; `zoneOf(person)`: the name of their zone, or null.
  phones(people, zoneOf, now) {
    for (const person of people) {
      if (person.device === null || person.gone !== null) continue;
      const known = this.#seen.get(person.device);
      // Should two tracks claim one phone, the likelier has it.
      if (known?.at === now && known.person.probability >= person.probability) continue;
      this.#seen.set(person.device, { person, at: now });
    }
    const rows = [];
    for (const [device, { person, at }] of this.#seen) {
      const silent = now - at;
      if (silent > FORGOTTEN_AFTER_MS) {
        this.#seen.delete(device);
        continue;
      }
      const here = silent < LOST_AFTER_MS;
      const place = zoneOf(person) ?? floorName(this.#site, person.floor);
      rows.push({
        name: this.#identities.labelOf(device),
        device,
        person,
        here,
        words: here ? `${place}, ${how(person)}` : `not seen for ${ago(silent)}`,
      });
    }
    rows.sort((a, b) => Number(b.here) - Number(a.here) || a.name.localeCompare(b.name, undefined, { numeric: true }));
    const count = rows.filter((row) => row.here).length;
    this.#draw("phones", count || "", rows, (row) => {
      const button = rowButton(() => {
        const place = this.#seen.get(row.device)?.person ?? row.person;
        this.#go(place.floor, place.x, place.y);
        this.#explain(row.device);
      });
      button.classList.toggle("faint", !row.here);
      button.addEventListener("pointerenter", () => this.#choose(row.device));
      button.addEventListener("pointerleave", () => this.#choose(null));
      button.addEventListener("focus", () => this.#choose(row.device));
      button.addEventListener("blur", () => this.#choose(null));
      button.title = row.device;
      button.append(swatch(this.#identities.colourOf(row.device)), words("strong", row.name), words("span", row.words));
      return button;
    }, (row) => [row.device, row.words, row.here]);
  }

  #drawAlerts() {
    const rows = this.#alerts.slice(0, ALERTS_SHOWN);
    this.#draw("alerts", "", rows, (alert) => {
      const button = rowButton(() => this.#go(alert.floor, alert.x, alert.y));
      const { who, did } = inWords(alert, this.#identities, this.#zones.get(alert.zone) ?? alert.zone);
      const time = words("time", spoken(alert.t));
      time.dateTime = new Date(1000 * alert.t).toISOString();
      const what = words("span", "");
      what.append(words("strong", who), ` ${did}`);
      button.append(swatch(this.#identities.colourOf(alert.device)), what, time);
      return button;
    }, (alert) => [alert.id, this.#zones.get(alert.zone)]);
  }

  #drawCameras() {
    const listed = new Map((this.#site?.cameras ?? []).map((camera) => [camera.id, null]));
    for (const [id, camera] of this.#cameras ?? []) listed.set(id, camera);
    const rows = [...listed].map(([id, camera]) => ({ id, ...cameraInWords(camera) }));
    this.#draw("cameras", "", rows, (row) => {
      const item = document.createElement("div");
      item.className = "row";
      const light = document.createElement("span");
      light.className = `light ${row.light}`;
      item.append(light, words("strong", row.id), words("span", row.words));
      return item;
    }, (row) => [row.id, row.light, row.words]);
  }

  #draw(name, count, rows, build, identity) {
    const list = document.getElementById(name);
    const key = JSON.stringify([count, rows.map(identity)]);
    if (this.#shown.get(name) === key && list.childElementCount === rows.length) return;
    this.#shown.set(name, key);
    document.getElementById(`${name}-count`).textContent = count;
    // A row that stays keeps its element, and with it the keyboard's focus.
    const old = new Map([...list.children].map((item) => [item.dataset.key, item]));
    list.replaceChildren(...rows.map((row) => {
      const rowKey = JSON.stringify(identity(row));
      if (old.has(rowKey)) return old.get(rowKey);
      const item = document.createElement("li");
      item.dataset.key = rowKey;
      item.append(build(row));
      return item;
    }));
  }
}

function certainty(probability) {
  if (probability >= 0.95) return "certain";
  if (probability >= 0.8) return "fairly certain";
  return "probably";
}

function ago(milliseconds) {
  const seconds = Math.floor(milliseconds / 1000);
  return seconds < 60 ? `${seconds} s` : `${Math.floor(seconds / 60)} min`;
}

function floorName(site, id) {
  return site?.floors.find((floor) => floor.id === id)?.name || id;
}

function rowButton(act) {
  const button = document.createElement("button");
  button.type = "button";
  button.className = "row";
  button.addEventListener("click", act);
  return button;
}

function swatch(colour) {
  const dot = document.createElement("span");
  dot.className = "swatch";
  dot.style.background = colour;
  return dot;
}

function words(tag, text) {
  const element = document.createElement(tag);
  element.textContent = text;
  return element;
}

// How surely is the phone there? Out of every camera's view, what steps and radio tell is right to some metres only.
function how(person) {
  if (person.state !== "unseen") return certainty(person.probability);
  return person.accuracy === null ? "out of view" : `out of view, within ${Math.ceil(2 * person.accuracy)} m`;
}
