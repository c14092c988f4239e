// Where did everybody walk in the last seconds? Wide, soft lines are the dearest thing on the map, and they change
// least: painted a few times a second on a picture of their own, which is copied under the people.

import { fade } from "./painting.js";
import { grouped } from "./people_painting.js";

const EVERY_MS = 120; // in that time nobody walks farther than their own dot is wide
const BANDS = 6; // the older, the paler

export class Trails {
  #canvas = document.createElement("canvas");
  #painted = null;
  #at = 0;

  // The picture of these people's trails, as large as the view.
  picture(view, ratio, floor, people, identities, now) {
    const [x, y] = view.toScreen(0, 0);
    const key = [floor, ratio, view.width, view.height, view.scale, x, y];
    const same = this.#painted !== null && key.every((part, i) => part === this.#painted[i]);
    if (same && now - this.#at < EVERY_MS) return this.#canvas;
    this.#painted = key;
    this.#at = now;
    const context = this.#canvas.getContext("2d");
    const [width, height] = [view.width, view.height].map((long) => Math.max(Math.round(long * ratio), 1));
    if (this.#canvas.width !== width) this.#canvas.width = width;
    if (this.#canvas.height !== height) this.#canvas.height = height;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, view.width, view.height);
    context.lineWidth = 2.5;
    context.lineCap = "butt";
    context.lineJoin = "bevel";
    for (const look of grouped(people, identities)) bands(context, view, look);
    return this.#canvas;
  }
}

function bands(context, view, { people, colour, shade }) {
  for (let band = 0; band < BANDS; band += 1) {
    context.strokeStyle = fade(colour, 0.45 * shade * ((band + 1) / BANDS) ** 1.5);
    context.beginPath();
    for (const { trail, x, y } of people) {
      const last = trail.length - 1;
      if (last < 0) continue;
      const from = Math.floor((band * last) / BANDS);
      const to = Math.floor(((band + 1) * last) / BANDS);
      const newest = band === BANDS - 1;
      if (from === to && !newest) continue;
      context.moveTo(...view.toScreen(trail[from][1], trail[from][2]));
      for (let i = from + 1; i <= to; i += 1) context.lineTo(...view.toScreen(trail[i][1], trail[i][2]));
      if (newest) context.lineTo(...view.toScreen(x, y));
    }
    context.stroke();
  }
}
