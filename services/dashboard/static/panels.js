// The lists beside the map: alerts, located phones, cameras. A row keeps its element, and with it the keyboard's
// focus, for as long as what it tells of is listed.

import { inWords } from "./alert_words.js";
import { cameraInWords } from "./camera_words.js";
import { arrange, element, oneStop, timeOf } from "./dom.js";

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
    for (const name of ["alerts", "phones"]) oneStop(document.getElementById(name));
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
      button.append(this.#identities.swatch(row.device), element("strong", {}, row.name), element("span", {}, row.words));
      return button;
    }, (row) => [row.device, row.words, row.here]);
  }

  #drawAlerts() {
    const rows = this.#alerts.slice(0, ALERTS_SHOWN);
    this.#draw("alerts", "", rows, (alert) => {
      const button = rowButton(() => this.#go(alert.floor, alert.x, alert.y));
      const { who, did } = inWords(alert, this.#identities, this.#zones.get(alert.zone) ?? alert.zone);
      button.append(this.#identities.swatch(alert.device), element("span", {}, element("strong", {}, who), ` ${did}`), timeOf(alert.t));
      return button;
    }, (alert) => [alert.id, this.#zones.get(alert.zone)]);
  }

  #drawCameras() {
    const listed = new Map((this.#site?.cameras ?? []).map((camera) => [camera.id, null]));
    for (const [id, camera] of this.#cameras ?? []) listed.set(id, camera);
    const rows = [...listed].map(([id, camera]) => ({ id, ...cameraInWords(camera) }));
    this.#draw("cameras", "", rows, (row) => {
      const light = element("span", { class: `light ${row.light}` });
      return element("div", { class: "row" }, light, element("strong", {}, row.id), element("span", {}, row.words));
    }, (row) => [row.id, row.light, row.words]);
  }

  // `identity(row)`: what it tells of, and whatever else makes it look as it does.
  #draw(name, count, rows, build, identity) {
    const list = document.getElementById(name);
    const key = JSON.stringify([count, rows.map(identity)]);
    if (this.#shown.get(name) === key && list.childElementCount === rows.length) return;
    this.#shown.set(name, key);
    document.getElementById(`${name}-count`).textContent = count;
    const old = new Map([...list.children].map((item) => [item.dataset.id, item]));
    arrange(list, rows.map((row) => {
      const [id, ...looks] = identity(row);
      const item = old.get(String(id)) ?? element("li", { "data-id": String(id) });
      const look = JSON.stringify(looks);
      if (item.dataset.look === look) return item;
      item.dataset.look = look;
      const now = build(row);
      const before = item.firstElementChild;
      if (before === null) item.append(now);
      else {
        before.className = now.className;
        before.replaceChildren(...now.childNodes);
      }
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
  return element("button", { type: "button", class: "row", onclick: act });
}

// How surely is the phone there? Out of every camera's view, what steps and radio tell is right to some metres only.
function how(person) {
  if (person.state !== "unseen") return certainty(person.probability);
  return person.accuracy === null ? "out of view" : `out of view, within ${Math.ceil(2 * person.accuracy)} m`;
}
