// Why does the system think so? One chosen person and what is known of who they are, asked of the API again and again.

import { ask } from "./ask.js";
import { element, sentence, spoken } from "./dom.js";

const EVERY_MS = 1000;

const SEEN = {
  confirmed: "A camera sees this person now.",
  coasting: "Hidden for a moment; carried on by how people walk.",
  unseen: "No camera sees this person: steps and radio alone tell the place.",
  lost: "Nobody in the newest picture carries this phone; this is where it was last.",
};

export class Evidence {
  #panel;
  #identities;
  #closed;
  #chosen = null; // {area, track, device}
  #person = null;
  #answer = null;
  #problem = "";
  #asked = 0;
  #shown = "";

  // `closed()` is told when somebody closes the panel.
  constructor(panel, identities, closed) {
    this.#panel = panel;
    this.#identities = identities;
    this.#closed = closed;
    panel.addEventListener("keydown", (event) => event.key === "Escape" && this.close());
  }

  get chosen() {
    return this.#chosen;
  }

  // Whether this person of the map is the chosen one: a phone is followed through its tracks' numbers.
  is(person) {
    if (this.#chosen === null) return false;
    if (this.#chosen.device !== null) return person.device === this.#chosen.device;
    return person.key === this.#chosen.key;
  }

  open(person) {
    const [area] = person.key.split("/");
    this.#chosen = { key: person.key, area, track: person.track, device: person.device };
    this.#person = person;
    this.#answer = null;
    this.#problem = "";
    this.#asked = 0;
    this.#panel.hidden = false;
    this.#draw();
    this.#ask();
  }

  close() {
    if (this.#chosen === null) return;
    this.#chosen = null;
    this.#panel.hidden = true;
    this.#closed();
  }

  // `people`: everybody on the map now. Called once or twice a second.
  follow(people, zoneOf) {
    if (this.#chosen === null) return;
    const found = people.find((person) => person.gone === null && this.is(person));
    if (found !== undefined) {
      const [area] = found.key.split("/");
      // Somebody without a phone may be given a name: then the name is what is followed.
      this.#chosen = { key: found.key, area, track: found.track, device: found.device ?? this.#chosen.device };
    }
    this.#person = found ?? (this.#person === null ? null : { ...this.#person, gone: 1 });
    this.#person.zone = zoneOf(this.#person);
    this.#draw();
    if (performance.now() - this.#asked > EVERY_MS) this.#ask();
  }

  async #ask() {
    this.#asked = performance.now();
    const chosen = this.#chosen;
    try {
      const [tracks, position] = await Promise.all([
        ask("tracks", { query: { area: chosen.area } }),
        chosen.device === null ? null : ask(`positions/${encodeURIComponent(chosen.device)}`).catch(gone),
      ]);
      if (this.#chosen === null || this.#chosen.key !== chosen.key) return;
      const track = tracks.tracks.find((one) => one.track === chosen.track && one.area === chosen.area) ?? null;
      this.#answer = { track, position };
      this.#problem = "";
    } catch (problem) {
      this.#problem = problem.message;
    }
    if (this.#chosen !== null) this.#draw();
  }

  #draw() {
    const { device } = this.#chosen;
    const rows = this.#rows();
    const here = this.#person?.gone === null;
    const title = device === null ? `Person ${this.#chosen.track}` : `Phone ${this.#identities.labelOf(device)}`;
    const key = JSON.stringify([title, rows, this.#problem, here]);
    if (key === this.#shown && this.#panel.childElementCount > 0) return;
    this.#shown = key;
    const list = element("dl");
    for (const [name, words] of rows) list.append(element("dt", {}, name), element("dd", {}, words));
    const focused = this.#panel.contains(document.activeElement);
    const close = element("button", { type: "button", class: "close", "aria-label": "Close", onclick: () => this.close() }, "✕");
    this.#panel.replaceChildren(
      element("header", {}, this.#identities.swatch(device), element("h2", {}, title), close),
      here ? "" : element("p", { class: "problem" }, "Not on the map at this moment."),
      list,
      this.#problem === "" ? "" : element("p", { class: "problem" }, this.#problem),
    );
    if (focused) close.focus();
  }

  #rows() {
    const person = this.#person;
    const { track = null, position = null } = this.#answer ?? {};
    const { device } = this.#chosen;
    const rows = [];
    const state = person.gone === null ? person.state : position?.state;
    if (SEEN[state]) rows.push(["Seen", SEEN[state]]);
    rows.push(["Phone", device ?? "None of the located phones belongs to this person."]);
    const probability = track?.probability ?? position?.probability ?? person.probability;
    rows.push(["Probability", device === null ? `${percent(probability)} that it is none of them` : percent(probability)]);
    if (track !== null) {
      const other = track.runner_up;
      rows.push(["Runner-up", other === null ? "None" :
        `Phone ${this.#identities.labelOf(other)}, ${percent(track.runner_up_probability)}`]);
    }
    if (person.accuracy !== null) rows.push(["Place", `${place(person)}, within ${(2 * person.accuracy).toFixed(1)} m`]);
    rows.push(...told(track, device));
    if (track !== null) {
      rows.push(["Former numbers", track.former.length === 0 ? "None" : track.former.join(", ")]);
      rows.push(["Followed", `${percent(track.quality)} quality, as number ${track.track}`]);
    }
    const named = device === null ? null : track?.device_since ?? person.named;
    if (named) rows.push(["Since", `${spoken(named)}, without a break`]);
    else if (person.since !== undefined) rows.push(["Watched", `On this page since ${spoken(person.since)}`]);
    if (position !== null && position.age > 3) rows.push(["Last heard", `${Math.round(position.age)} s ago`]);
    return rows;
  }
}

// Which of the cameras and of the phone's steps and radio spoke for it in the last second, as the API tells it.
function told(track, device) {
  if (track === null) return [];
  const cameras = track.sources.filter((source) => source !== device);
  const rows = [["Cameras", cameras.length === 0 ? "None in the last second" : `${cameras.join(", ")}, in the last second`]];
  if (device === null) return rows;
  return [...rows, ["Steps and radio", track.sources.includes(device) ? "They tell of this person too, in the last second"
    : "Nothing from the phone in the last second"]];
}

// A phone that is known no more is no problem of the panel.
function gone(problem) {
  if (problem.status === 404) return null;
  throw problem;
}

function percent(share) {
  const rounded = Math.round(100 * share);
  return share < 1 && rounded === 100 ? "over 99 %" : `${rounded} %`;
}

function place({ x, y, zone }) {
  return `${zone ? `${sentence(zone)}: ` : ""}${x.toFixed(1)}, ${y.toFixed(1)} m`;
}
