// Zones and exhibits on the plan: drawn corner by corner, moved, bent, by pointer or by keys.

import { paintExhibits } from "./exhibits.js";
import { Ground } from "./ground.js";
import { bounds, inside } from "./painting.js";
import { Pointer } from "./pointer.js";
import { Viewport } from "./viewport.js";
import { paintBegun, paintChosen } from "./zone_draft_painting.js";
import { pathOf } from "./zone_draft.js";
import { edges, middleOf, rounded, snapped } from "./zone_geometry.js";
import { cornersOf, paintZones } from "./zone_painting.js";

const REACH = 11; // pixels within which a corner is meant, and snapped to
const FINGER = 18;
const STEP = 0.1; // metres
const LAYERS = { zones: false, exhibits: false, cameras: true, radio: false };

const LEAST = { area: 3, line: 2, point: 1 }; // corners
const BEGINNING = {
  area: "Click the corners one after the other; click the first again, or press Enter twice, to close the area. Esc gives up.",
  line: "Click both ends of the line. Its arrow shows which way counts as forward. Esc gives up.",
  point: "Click where the exhibit stands or hangs, or move the cross and press Enter. Esc gives up.",
};
const KEPT = { area: "An area keeps three corners.", line: "A line keeps two ends.", point: "An exhibit keeps its place." };

export class ZoneCanvas {
  view = new Viewport();
  snapping = true;
  corner = null; // index of the chosen corner
  #canvas;
  #hooks;
  #ground = new Ground();
  #site = null;
  #floor = null;
  #zones = [];
  #draft = null;
  #drawing = null; // {shape, points} while a new outline is begun
  #cursor = null; // where the next corner would be
  #due = false;

  // `hooks`: choose(zone or null), drawn(shape, points), changed(), cornerChosen(), say(words).
  constructor(canvas, hooks) {
    this.#canvas = canvas;
    this.#hooks = hooks;
    // Before the pointer's own keys, which move the map.
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("pointermove", (event) => this.#hover(event));
    canvas.addEventListener("dblclick", () => this.#finish());
    new Pointer(canvas, this.view, () => this.fit(), {
      tap: (px, py) => this.#tap(px, py),
      grab: (px, py) => this.#grab(px, py),
    });
    for (const name of ["pointermove", "wheel", "keydown"]) canvas.addEventListener(name, () => this.draw());
    new ResizeObserver(() => this.#resize()).observe(canvas);
  }

  get drawing() {
    return this.#drawing !== null;
  }

  show(site, floor) {
    const other = this.#floor?.id !== floor.id;
    this.#site = site;
    this.#floor = floor;
    if (other) this.fit();
    this.draw();
  }

  // `zones` and exhibits of this floor; `draft`: the one that is being changed, or null.
  set(zones, draft) {
    if (draft !== this.#draft) this.corner = null;
    this.#zones = zones;
    this.#draft = draft;
    if (draft !== null && this.corner !== null && this.corner >= draft.zone.points.length) this.corner = null;
    this.draw();
  }

  begin(shape) {
    this.#drawing = { shape, points: [] };
    this.#cursor = this.#place(...[this.view.width / 2, this.view.height / 2]);
    this.corner = null;
    this.#canvas.focus({ preventScroll: true });
    this.#hooks.say(BEGINNING[shape]);
    this.draw();
  }

  cancel() {
    this.#drawing = null;
    this.#cursor = null;
    this.draw();
  }

  chooseCorner(index) {
    this.corner = index;
    const points = this.#draft.zone.points;
    if (index !== null) this.#hooks.say(`Corner ${index + 1} of ${points.length} at ${points[index].join(", ")} m.`);
    this.#hooks.cornerChosen();
    this.draw();
  }

  insertAfter(index) {
    const { points, shape } = this.#draft.zone;
    if (shape === "point") return;
    const edge = edges(points, shape).find(([i]) => i === index) ?? edges(points, shape).at(-1);
    this.#draft.change((zone) => zone.points.splice(edge[0] + 1, 0, middleOf(edge[1], edge[2]).map((v) => rounded(v, 0.001))));
    this.#hooks.changed();
    this.chooseCorner(edge[0] + 1);
  }

  remove(index) {
    const { points, shape } = this.#draft.zone;
    if (points.length <= LEAST[shape]) {
      this.#hooks.say(KEPT[shape]);
      return;
    }
    this.#draft.change((zone) => zone.points.splice(index, 1));
    this.corner = null;
    this.#hooks.changed();
    this.#hooks.cornerChosen();
  }

  fit() {
    if (this.#floor === null) return;
    this.view.fit(bounds(this.#floor.outline));
    this.draw();
  }

  draw() {
    if (this.#due) return;
    this.#due = true;
    requestAnimationFrame(() => {
      this.#due = false;
      this.#paint();
    });
  }

  #resize() {
    const ratio = window.devicePixelRatio || 1;
    const first = this.view.width === 1;
    this.view.resize(this.#canvas.clientWidth, this.#canvas.clientHeight);
    this.#canvas.width = Math.round(this.#canvas.clientWidth * ratio);
    this.#canvas.height = Math.round(this.#canvas.clientHeight * ratio);
    if (first) this.fit();
    this.draw();
  }

  #paint() {
    if (this.#floor === null) return;
    const ratio = window.devicePixelRatio || 1;
    const context = this.#canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, this.view.width, this.view.height);
    const ground = this.#ground.picture(this.view, ratio, this.#site, this.#floor, null, null, LAYERS);
    context.drawImage(ground, 0, 0, this.view.width, this.view.height);
    const others = this.#others();
    const names = [];
    paintZones(context, this.view, others.filter((zone) => zone.shape !== "point").map(({ inside: _, ...zone }) => zone), names);
    paintExhibits(context, this.view, others.filter((zone) => zone.shape === "point"), names);
    if (this.#draft !== null) paintChosen(context, this.view, this.#draft.zone, this.corner);
    if (this.#drawing !== null) paintBegun(context, this.view, this.#drawing, this.#cursor);
  }

  #others() {
    return this.#zones.filter((zone) => this.#draft === null || pathOf(zone) !== pathOf(this.#draft.zone));
  }

  // The place on the plan that is meant by a place on the screen.
  #place(px, py, except = null) {
    const place = this.view.toPlan(px, py);
    if (!this.snapping) return place.map((value) => rounded(value, 0.001));
    return snapped(place, this.#targets(except), REACH / this.view.scale, STEP);
  }

  #targets(except) {
    const own = this.#draft?.zone.points.filter((_, i) => i !== except) ?? [];
    const others = this.#others().flatMap(cornersOf);
    return [...own, ...others, ...(this.#drawing?.points ?? []), ...this.#floor.outline, ...this.#floor.walls.flat(),
      ...this.#floor.obstacles.flatMap((part) => part.polygon)];
  }

  #near(places, px, py, reach) {
    let best = -1;
    let least = reach;
    places.forEach((place, i) => {
      const [x, y] = this.view.toScreen(...place);
      const far = Math.hypot(x - px, y - py);
      if (far <= least) [best, least] = [i, far];
    });
    return best;
  }

  #hover(event) {
    if (this.#drawing === null || event.buttons !== 0) return;
    this.#cursor = this.#place(event.offsetX, event.offsetY);
  }

  #tap(px, py) {
    this.#canvas.focus({ preventScroll: true });
    if (this.#drawing !== null) {
      this.#add(this.#place(px, py), this.#near(this.#drawing.points.slice(0, 1), px, py, REACH) === 0);
      return;
    }
    const [x, y] = this.view.toPlan(px, py);
    const points = this.#zones.filter((zone) => zone.shape === "point");
    const onPoint = points[this.#near(points.map((point) => point.points[0]), px, py, REACH)];
    const lines = this.#zones.filter((zone) => zone.shape === "line");
    const onLine = lines.find((zone) => edges(cornersOf(zone), "line").some(([, a, b]) => this.#off(a, b, px, py) < REACH));
    const areas = this.#zones.filter((zone) => zone.shape === "area" && inside(cornersOf(zone), x, y));
    this.#hooks.choose(onPoint ?? onLine ?? areas.at(-1) ?? null);
  }

  // How many pixels off the way from a to b?
  #off(a, b, px, py) {
    const [x0, y0] = this.view.toScreen(...a);
    const [x1, y1] = this.view.toScreen(...b);
    const long = (x1 - x0) ** 2 + (y1 - y0) ** 2;
    const share = long === 0 ? 0 : Math.min(Math.max(((px - x0) * (x1 - x0) + (py - y0) * (y1 - y0)) / long, 0), 1);
    return Math.hypot(x0 + share * (x1 - x0) - px, y0 + share * (y1 - y0) - py);
  }

  // A corner is dragged; the small dot in the middle of an edge becomes a corner when it is.
  #grab(px, py) {
    if (this.#draft === null || this.#drawing !== null) return null;
    const { points, shape } = this.#draft.zone;
    const reach = window.matchMedia("(pointer: coarse)").matches ? FINGER : REACH;
    let index = this.#near(points, px, py, reach);
    const sides = edges(points, shape);
    const side = index < 0 ? this.#near(sides.map(([, a, b]) => middleOf(a, b)), px, py, reach) : -1;
    if (index < 0 && side < 0) return null;
    let begun = false;
    return {
      move: (x, y) => {
        const draft = this.#draft;
        if (!begun) {
          draft.mark();
          begun = true;
          if (index < 0) {
            index = sides[side][0] + 1;
            draft.zone.points.splice(index, 0, middleOf(sides[side][1], sides[side][2]));
          }
          this.corner = index;
        }
        draft.zone.points[index] = this.#place(x, y, index);
        this.#hooks.changed();
      },
      drop: () => {
        if (begun || index >= 0) this.chooseCorner(index);
        else this.insertAfter(sides[side][0]);
      },
    };
  }

  #add(place, closes) {
    const { points, shape } = this.#drawing;
    const again = points.length > 0 && points.at(-1).every((value, i) => Math.abs(value - place[i]) < 1e-6);
    if (closes || again) {
      this.#finish();
      return;
    }
    points.push(place);
    this.#cursor = place;
    this.#hooks.say(`${points.length} ${points.length === 1 ? "corner" : "corners"}, the last at ${place.join(", ")} m.`);
    if (shape !== "area" && points.length === LEAST[shape]) this.#finish();
    this.draw();
  }

  #finish() {
    if (this.#drawing === null) return;
    const { points, shape } = this.#drawing;
    if (points.length < LEAST[shape]) return;
    this.cancel();
    this.#hooks.drawn(shape, points);
  }

  #key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const far = event.shiftKey ? 1 : STEP;
    const way = { ArrowLeft: [-far, 0], ArrowRight: [far, 0], ArrowUp: [0, far], ArrowDown: [0, -far] }[event.key];
    const done = this.#drawing !== null ? this.#drawingKey(event.key, way)
      : this.#draft !== null ? this.#changingKey(event.key, way) : false;
    if (!done) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    this.draw();
  }

  #drawingKey(key, way) {
    if (way !== undefined) {
      this.#cursor = [rounded(this.#cursor[0] + way[0], 0.001), rounded(this.#cursor[1] + way[1], 0.001)];
      this.#hooks.say(`At ${this.#cursor.join(", ")} m.`);
    } else if (key === "Enter") this.#add([...this.#cursor], false);
    else if (key === "Backspace") this.#drawing.points.pop();
    else if (key === "Escape") {
      this.cancel();
      this.#hooks.say("Nothing was drawn.");
    } else return false;
    return true;
  }

  #changingKey(key, way) {
    const { points } = this.#draft.zone;
    if (key === "n" || key === "p") {
      const by = key === "n" ? 1 : -1;
      this.chooseCorner(this.corner === null ? 0 : (this.corner + by + points.length) % points.length);
      return true;
    }
    if (this.corner === null) return false;
    if (way !== undefined) {
      const index = this.corner;
      this.#draft.change((zone) => {
        zone.points[index] = [rounded(zone.points[index][0] + way[0], 0.001), rounded(zone.points[index][1] + way[1], 0.001)];
      }, `corner ${index}`);
      this.#hooks.changed();
      this.chooseCorner(index);
    } else if (key === "Delete" || key === "Backspace") this.remove(this.corner);
    else if (key === "i") this.insertAfter(this.corner);
    else if (key === "Escape") this.chooseCorner(null);
    else return false;
    return true;
  }
}
