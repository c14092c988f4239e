// How camera set-up looks: the picture with what comes of the pairs laid over it, and the plan. Holds no state of its own.

import { paintPlan, paintWalls } from "./painting.js";
import { paintLens } from "./picker.js";
import { mark, path, words } from "./setup-common.js";

export const UNIT = 50; // pixels of the picture to a unit of its viewport

const BLUE = "#0b5394";
const ORANGE = "#b8500a"; // told apart by colour-blind eyes too, and by shape
const GRID = "#ffd54a";
const INTEREST = "#9b2fae";

// Whether both coordinates are there: one may be typed before the other.
export function known(place) {
  return place !== null && place.every(Number.isFinite);
}

// The picture with the grid, the area of interest and the pairs. `asked`: whether clicks are corners of that area.
export function paintPicture(context, view, picker, state, asked) {
  if (state.image === null) return;
  const [left, top] = view.toScreen(-0.5 / UNIT, 0.5 / UNIT);
  const scale = view.scale / UNIT;
  context.drawImage(state.image, left, top, state.size[0] * scale, state.size[1] * scale);
  const at = (pixel) => picker.screenOf(pixel);
  context.save();
  context.beginPath();
  context.rect(left, top, state.size[0] * scale, state.size[1] * scale);
  context.clip();
  for (const line of state.trial?.grid ?? []) {
    const thick = Math.round(line.at / state.trial.step) % 5 === 0;
    context.strokeStyle = GRID;
    context.globalAlpha = thick ? 0.95 : 0.5;
    context.lineWidth = thick ? 1.6 : 0.8;
    for (const stretch of line.pixels) {
      path(context, stretch.map(at));
      context.stroke();
      if (thick) words(context, `${line.axis} ${line.at}`, ...at(stretch[Math.floor(stretch.length / 2)]), "#4a3b00");
    }
    context.globalAlpha = 1;
  }
  if (state.interest.length > 0) {
    path(context, state.interest.map(at));
    context.closePath();
    context.fillStyle = `${INTEREST}22`;
    context.fill();
    context.strokeStyle = INTEREST;
    context.lineWidth = 2;
    context.setLineDash(asked ? [] : [6, 4]);
    context.stroke();
    context.setLineDash([]);
    if (asked) state.interest.forEach((corner, index) => mark(context, at(corner), `${index + 1}`, { colour: INTEREST }));
  }
  context.restore();
  if (asked) return lens(context, view, picker, state);
  state.pairs.forEach((pair, index) => {
    if (!known(pair.pixel)) return;
    const wrong = pair.report?.used === false;
    if (pair.report?.shown) {
      context.strokeStyle = wrong ? ORANGE : BLUE;
      context.lineWidth = 2;
      path(context, [at(pair.pixel), at(pair.report.shown)]);
      context.stroke();
    }
    mark(context, at(pair.pixel), `${index + 1}`, { colour: wrong ? ORANGE : BLUE, wrong, chosen: !known(pair.place) });
  });
  lens(context, view, picker, state);
}

function lens(context, view, picker, state) {
  const place = picker.cross ?? picker.pointer;
  if (place) paintLens(context, state.image, picker.placeAt(...place), place, view, view.scale / UNIT);
}

// The plan with the pairs, where the camera sees them, and what floor it sees.
export function paintPlaces(context, view, state) {
  if (state.floor === null) return;
  paintPlan(context, view, state.floor);
  paintWalls(context, view, state.floor);
  if (state.trial !== null && state.trial.footprint.length > 2) {
    path(context, state.trial.footprint.map((place) => view.toScreen(...place)));
    context.closePath();
    context.fillStyle = "#b27a1e18";
    context.fill();
    context.strokeStyle = "#b27a1e";
    context.lineWidth = 1;
    context.stroke();
    const [x, y] = view.toScreen(state.trial.position[0], state.trial.position[1]);
    mark(context, [x, y], state.camera, { colour: "#8a5d12" });
  }
  state.pairs.forEach((pair, index) => {
    if (!known(pair.place)) return;
    const wrong = pair.report?.used === false;
    const at = view.toScreen(...pair.place);
    if (pair.report?.seen) {
      context.strokeStyle = wrong ? ORANGE : BLUE;
      context.lineWidth = 2;
      path(context, [at, view.toScreen(...pair.report.seen)]);
      context.stroke();
    }
    mark(context, at, `${index + 1}`, { colour: wrong ? ORANGE : BLUE, wrong, chosen: !known(pair.pixel) });
  });
}
