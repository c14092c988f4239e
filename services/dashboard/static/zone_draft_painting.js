// How does a zone look while somebody changes it, or has only begun to draw it?

import { paintChosenExhibit } from "./exhibits.js";
import { line, polygon } from "./painting.js";
import { edges, middleOf, whatIsWrong } from "./zone_geometry.js";
import { nameZone, paintLine } from "./zone_painting.js";

const CHOSEN = "#1257a0";
const WRONG = "#b3261e";
const CORNER = "#ffb000";

// With its corners, the chosen one larger, and a small dot in the middle of each edge.
export function paintChosen(context, view, zone, corner) {
  if (zone.shape === "point") {
    paintChosenExhibit(context, view, zone, CHOSEN);
    if (corner === 0) dot(context, view, zone.points[0], 8, CORNER, "#ffffff");
    return;
  }
  const colour = whatIsWrong(zone.points, zone.shape) === "" ? CHOSEN : WRONG;
  if (zone.shape === "line") paintLine(context, view, zone.points, colour, 3);
  else {
    polygon(context, view, zone.points);
    context.fillStyle = `${colour}22`;
    context.fill();
    context.strokeStyle = colour;
    context.lineWidth = 2.5;
    context.stroke();
  }
  nameZone(context, view, zone, colour);
  for (const [, from, to] of edges(zone.points, zone.shape)) dot(context, view, middleOf(from, to), 4, "#ffffff", colour);
  zone.points.forEach((point, i) => {
    if (i === corner) dot(context, view, point, 8, CORNER, "#ffffff");
    else dot(context, view, point, 6, colour, "#ffffff");
  });
}

// What is drawn so far, and the cross where the next corner would be.
export function paintBegun(context, view, { points, shape }, cursor) {
  const ahead = cursor === null ? points : [...points, cursor];
  if (ahead.length > 1 && shape === "line") paintLine(context, view, ahead, CHOSEN, 3);
  else if (ahead.length > 1) {
    line(context, view, ahead);
    context.setLineDash([6, 4]);
    context.strokeStyle = CHOSEN;
    context.lineWidth = 2.5;
    context.stroke();
    context.setLineDash([]);
  }
  for (const point of points) dot(context, view, point, 6, CHOSEN, "#ffffff");
  if (cursor === null) return;
  const [x, y] = view.toScreen(...cursor);
  context.strokeStyle = CHOSEN;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(x - 10, y);
  context.lineTo(x + 10, y);
  context.moveTo(x, y - 10);
  context.lineTo(x, y + 10);
  context.stroke();
}

function dot(context, view, place, radius, fill, edge) {
  const [x, y] = view.toScreen(...place);
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = fill;
  context.fill();
  context.strokeStyle = edge;
  context.lineWidth = 2;
  context.stroke();
}
