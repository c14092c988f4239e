// Exhibits as the editor and the map see them: things of one point, with a front and a reach where they have them.

import { shownName } from "./zone_painting.js";

const EXHIBIT = "#7a3d6b";
const SIZE = 5; // pixels
const NAMED_FROM = 14; // pixels per metre

// The API's exhibit as something with a shape and corners, and back.
export function asPoint({ x, y, ...rest }) {
  return { ...rest, shape: "point", points: [[x, y]] };
}

export function asExhibit({ shape: _, points: [[x, y]], ...rest }) {
  return { ...rest, x, y };
}

export function newExhibit(id, floor, points) {
  return { id, name: "", floor, shape: "point", points, reach: 8, facing: null };
}

// `points`: as from asPoint; `taken`: the boxes of names that stand already.
export function paintExhibits(context, view, points, taken = []) {
  for (const point of points) paintExhibit(context, view, point, EXHIBIT, SIZE);
  if (view.scale < NAMED_FROM) return;
  for (const point of points) nameExhibit(context, view, point, EXHIBIT, taken);
}

// With how far it is looked at from.
export function paintChosenExhibit(context, view, point, colour) {
  const [x, y] = view.toScreen(...point.points[0]);
  const { facing, reach } = point;
  const [middle, half] = facing === null ? [0, Math.PI] : [(-facing * Math.PI) / 180, Math.PI / 2];
  context.beginPath();
  if (facing !== null) context.moveTo(x, y);
  context.arc(x, y, Math.max(reach ?? 0, 0) * view.scale, middle - half, middle + half);
  context.closePath();
  context.fillStyle = `${colour}14`;
  context.fill();
  context.setLineDash([4, 4]);
  context.strokeStyle = `${colour}90`;
  context.lineWidth = 1;
  context.stroke();
  context.setLineDash([]);
  paintExhibit(context, view, point, colour, SIZE + 2);
  nameExhibit(context, view, point, colour, []);
}

// A four-pointed star; the stroke shows where its front looks.
function paintExhibit(context, view, { points: [place], facing }, colour, size) {
  const [x, y] = view.toScreen(...place);
  if (facing !== null && facing !== undefined) {
    const angle = (-facing * Math.PI) / 180;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x + 2.6 * size * Math.cos(angle), y + 2.6 * size * Math.sin(angle));
    context.strokeStyle = colour;
    context.lineWidth = 2;
    context.stroke();
  }
  context.beginPath();
  for (let i = 0; i < 8; i += 1) {
    const far = i % 2 === 0 ? 1.3 * size : 0.5 * size;
    context.lineTo(x + far * Math.cos((i * Math.PI) / 4), y + far * Math.sin((i * Math.PI) / 4));
  }
  context.closePath();
  context.strokeStyle = "#ffffff";
  context.lineWidth = 2.5;
  context.stroke();
  context.fillStyle = colour;
  context.fill();
}

function nameExhibit(context, view, { id, name, points: [place] }, colour, taken) {
  const [x, y] = view.toScreen(...place);
  shownName(context, name || id, "", [x, y + 14], { most: 110, size: 11, weight: 400, colour, align: "center" }, taken);
}
