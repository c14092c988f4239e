// Where did everybody walk in the last seconds? Wide, soft lines are the dearest thing on the map, and they change
// least. They are painted on a picture of their own, a share of the people at a time so that no frame waits for all,
// and copied under the people; what has come since is drawn with each frame.

import { fade } from "./painting.js";
import { grouped } from "./people_painting.js";

const EVERY_MS = 250;
const SHARES = 5; // frames over which one picture is painted
const BANDS = 6; // the older, the paler
const STRENGTH = 0.45;

export class Trails {
  #front = blank();
  #back = blank();
  #key = null;
  #at = 0;
  #people = null; // whom the picture that is being painted shows
  #share = 0;

  // Draw these people's trails, as the view shows them.
  draw(context, view, ratio, floor, people, identities, now) {
    const [x, y] = view.toScreen(0, 0);
    const key = [floor, ratio, view.width, view.height, view.scale, x, y];
    if (this.#key === null || key.some((part, i) => part !== this.#key[i])) {
      this.#key = key;
      this.#people = null;
      this.#begin(view, ratio, people, now);
      while (this.#people !== null) this.#goOn(view, identities);
    } else if (this.#people !== null) this.#goOn(view, identities);
    else if (now - this.#at >= EVERY_MS) this.#begin(view, ratio, people, now);
    context.drawImage(this.#front.canvas, 0, 0, view.width, view.height);
    for (const look of grouped(people, identities)) newest(context, view, look, this.#front.upTo);
  }

  #begin(view, ratio, people, now) {
    const { canvas, upTo } = this.#back;
    const [width, height] = [view.width, view.height].map((long) => Math.max(Math.round(long * ratio), 1));
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    const context = canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    upTo.clear();
    this.#people = people;
    this.#share = 0;
    this.#at = now;
  }

  #goOn(view, identities) {
    const many = Math.ceil(this.#people.length / SHARES);
    const some = this.#people.slice(this.#share * many, (this.#share + 1) * many);
    const context = this.#back.canvas.getContext("2d");
    pen(context);
    for (const look of grouped(some, identities)) bands(context, view, look);
    for (const { key, trail } of some) if (trail.length > 0) this.#back.upTo.set(key, trail.at(-1)[0]);
    this.#share += 1;
    if (this.#share < SHARES) return;
    this.#people = null;
    [this.#front, this.#back] = [this.#back, this.#front];
  }
}

// `upTo`: until which time each person's trail is in the picture.
function blank() {
  return { canvas: document.createElement("canvas"), upTo: new Map() };
}

function pen(context) {
  context.lineWidth = 2.5;
  context.lineCap = "butt";
  context.lineJoin = "bevel";
}

function bands(context, view, { people, colour, shade }) {
  for (let band = 0; band < BANDS; band += 1) {
    context.strokeStyle = fade(colour, STRENGTH * shade * ((band + 1) / BANDS) ** 1.5);
    context.beginPath();
    for (const { trail } of people) {
      const last = trail.length - 1;
      const from = Math.floor((band * last) / BANDS);
      const to = Math.floor(((band + 1) * last) / BANDS);
      if (last < 1 || from === to) continue;
      context.moveTo(...view.toScreen(trail[from][1], trail[from][2]));
      for (let i = from + 1; i <= to; i += 1) context.lineTo(...view.toScreen(trail[i][1], trail[i][2]));
    }
    context.stroke();
  }
}

// From where the picture ends to where each person is now.
function newest(context, view, { people, colour, shade }, upTo) {
  pen(context);
  context.strokeStyle = fade(colour, STRENGTH * shade);
  context.beginPath();
  for (const { key, trail, x, y } of people) {
    const until = upTo.get(key);
    let first = trail.length - 1;
    while (first > 0 && (until === undefined || trail[first][0] > until)) first -= 1;
    if (first < 0) continue;
    context.moveTo(...view.toScreen(trail[first][1], trail[first][2]));
    for (let i = first + 1; i < trail.length; i += 1) context.lineTo(...view.toScreen(trail[i][1], trail[i][2]));
    context.lineTo(...view.toScreen(x, y));
  }
  context.stroke();
}
