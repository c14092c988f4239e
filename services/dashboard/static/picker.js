// A canvas on which places are pointed at: click, drag a point, or a crosshair moved by the keyboard.
//
// What a place is (a pixel of a picture, metres on the plan) is for who uses it: `to` turns one into units of the
// viewport (y upwards), `from` turns it back.

import { Viewport } from "./viewport.js";

const REACH = 12; // CSS pixels within which a point is grabbed
const STILL = 5; // CSS pixels a click may wander
const LENS = { radius: 62, times: 4 };

export class Picker {
  view = new Viewport();
  cross = null; // in CSS pixels, while the keyboard is used
  #pointers = new Map();
  #grabbed = null;
  #wandered = false;
  #dirty = true;
  #bounds = null;

  // what: {to, from, paint(context, view), points() -> [place], placed(place), moved(index, place), told(place),
  // waits() -> whether the next click is a new place, however near to another}
  constructor(canvas, what) {
    this.canvas = canvas;
    this.what = what;
    this.context = canvas.getContext("2d");
    this.#listen();
    new ResizeObserver(() => this.#resize()).observe(canvas);
    this.#resize();
    const loop = () => {
      if (this.#dirty) this.#paint();
      requestAnimationFrame(loop);
    };
    requestAnimationFrame(loop);
  }

  redraw() {
    this.#dirty = true;
  }

  // Show all of it: [left, bottom, right, top] in units of the viewport.
  show(bounds) {
    this.#bounds = bounds;
    this.fit();
  }

  fit() {
    if (this.#bounds !== null) this.view.fit(this.#bounds);
    this.redraw();
  }

  // Where on the canvas (CSS pixels) a place is; also for tests.
  screenOf(place) {
    return this.view.toScreen(...this.what.to(place));
  }

  placeAt(px, py) {
    return this.what.from(...this.view.toPlan(px, py));
  }

  #resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (width === 0 || height === 0) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(width * ratio);
    this.canvas.height = Math.round(height * ratio);
    this.view.resize(width, height);
    this.fit();
  }

  #paint() {
    this.#dirty = false;
    const ratio = window.devicePixelRatio || 1;
    this.context.setTransform(ratio, 0, 0, ratio, 0, 0);
    this.context.clearRect(0, 0, this.view.width, this.view.height);
    this.what.paint(this.context, this.view);
    if (this.#grabbed !== null || this.cross !== null) this.#paintCross();
  }

  #paintCross() {
    const [x, y] = this.cross ?? this.screenOf(this.what.points()[this.#grabbed] ?? [0, 0]);
    const { context } = this;
    for (const [colour, width] of [["#ffffff", 3], ["#1c1c1c", 1]]) {
      context.strokeStyle = colour;
      context.lineWidth = width;
      context.beginPath();
      for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
        context.moveTo(x + 3 * dx, y + 3 * dy);
        context.lineTo(x + 16 * dx, y + 16 * dy);
      }
      context.stroke();
    }
  }

  #nearest(px, py) {
    let best = null;
    let least = REACH;
    this.what.points().forEach((place, index) => {
      if (place === null) return;
      const [x, y] = this.screenOf(place);
      const away = Math.hypot(x - px, y - py);
      if (away < least) [best, least] = [index, away];
    });
    return best;
  }

  #listen() {
    const { canvas } = this;
    canvas.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      canvas.setPointerCapture(event.pointerId);
      this.#pointers.set(event.pointerId, { start: [event.offsetX, event.offsetY], now: [event.offsetX, event.offsetY] });
      this.#wandered = this.#pointers.size > 1;
      this.#grabbed = this.#pointers.size > 1 ? null : this.#nearest(event.offsetX, event.offsetY);
      this.cross = null;
      this.redraw();
    });
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    canvas.addEventListener("pointerup", (event) => {
      const pointer = this.#pointers.get(event.pointerId);
      this.#pointers.delete(event.pointerId);
      if (pointer === undefined) return;
      // A click beside a point sets no second one, for that is how one is missed by a hair, unless one is waited for.
      if (!this.#wandered && (this.#grabbed === null || this.what.waits?.())) this.what.placed(this.placeAt(event.offsetX, event.offsetY));
      else if (!this.#wandered) this.what.told?.(this.what.points()[this.#grabbed]);
      this.#grabbed = null;
      this.redraw();
    });
    canvas.addEventListener("pointercancel", (event) => {
      this.#pointers.delete(event.pointerId);
      this.#grabbed = null;
    });
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const pixels = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 * event.deltaY : event.deltaY;
      this.view.zoom(Math.exp(-0.0015 * pixels), event.offsetX, event.offsetY);
      this.redraw();
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("blur", () => {
      this.cross = null;
      this.redraw();
    });
  }

  #drag(event) {
    const pointer = this.#pointers.get(event.pointerId);
    if (pointer === undefined) return;
    const now = [event.offsetX, event.offsetY];
    if (Math.hypot(now[0] - pointer.start[0], now[1] - pointer.start[1]) > STILL) this.#wandered = true;
    if (this.#wandered) {
      const other = [...this.#pointers].find(([id]) => id !== event.pointerId)?.[1].now;
      if (other !== undefined) {
        const apart = (place) => Math.max(Math.hypot(place[0] - other[0], place[1] - other[1]), 10);
        this.view.pan((now[0] - pointer.now[0]) / 2, (now[1] - pointer.now[1]) / 2);
        this.view.zoom(apart(now) / apart(pointer.now), (now[0] + other[0]) / 2, (now[1] + other[1]) / 2);
      } else if (this.#grabbed !== null) {
        this.what.moved(this.#grabbed, this.placeAt(...now));
      } else {
        this.view.pan(now[0] - pointer.now[0], now[1] - pointer.now[1]);
      }
      this.redraw();
    }
    pointer.now = now;
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = event.shiftKey ? 1 : 10;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    if (event.key in moves) {
      this.cross ??= [this.view.width / 2, this.view.height / 2];
      const [dx, dy] = moves[event.key];
      this.cross = [
        Math.min(Math.max(this.cross[0] + dx, 0), this.view.width),
        Math.min(Math.max(this.cross[1] + dy, 0), this.view.height),
      ];
      this.what.told?.(this.placeAt(...this.cross));
    } else if ((event.key === "Enter" || event.key === " ") && this.cross !== null) {
      this.what.placed(this.placeAt(...this.cross));
    } else if (["+", "=", "-"].includes(event.key)) {
      this.view.zoom(event.key === "-" ? 0.8 : 1.25, ...(this.cross ?? []));
    } else if (event.key === "0") {
      this.fit();
    } else {
      return;
    }
    event.preventDefault();
    this.redraw();
  }
}

// Draw what is under a point of the canvas larger, beside it: for clicks to the pixel.
export function paintLens(context, image, [u, v], [x, y], view, scale) {
  const { radius, times } = LENS;
  const side = x > view.width / 2 ? radius + 10 : view.width - radius - 10;
  const shown = (2 * radius) / (scale * times);
  context.save();
  context.beginPath();
  context.arc(side, radius + 10, radius, 0, 2 * Math.PI);
  context.fillStyle = "#333";
  context.fill();
  context.clip();
  context.imageSmoothingEnabled = false;
  context.drawImage(image, u + 0.5 - shown / 2, v + 0.5 - shown / 2, shown, shown, side - radius, 10, 2 * radius, 2 * radius);
  context.strokeStyle = "#ffffff";
  context.lineWidth = 1;
  context.beginPath();
  for (const [dx, dy] of [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    context.moveTo(side + 3 * dx, radius + 10 + 3 * dy);
    context.lineTo(side + 20 * dx, radius + 10 + 20 * dy);
  }
  context.stroke();
  context.restore();
  context.beginPath();
  context.arc(side, radius + 10, radius, 0, 2 * Math.PI);
  context.strokeStyle = "#ffffff";
  context.lineWidth = 2;
  context.stroke();
}
