// How do zones look? Areas with corners, and lines with the side that counts as forward.

import { extent, fade, line, polygon, shortened, text } from "./painting.js";

const ZONE = "#2f7d76";
const LIGHTEN_MS = 4000;
const LINE_NAME = 160; // pixels a line's name may be long

// The site file says `polygon`, the API's zones say `points`.
export function cornersOf(zone) {
  return zone.points ?? zone.polygon;
}

// `zones`: as the API tells them; `taken`: the boxes of the names that stand already, as of `shownName`.
export function paintZones(context, view, zones, taken = []) {
  for (const zone of zones) paintZone(context, view, zone, 0);
  for (const zone of zones) nameZone(context, view, zone, undefined, taken);
}

// A zone of which an alert has just come shines for a while; returns whether it still does.
export function paintLit(context, view, zone, since, now) {
  const light = 1 - (now - since) / LIGHTEN_MS;
  if (light > 0) paintZone(context, view, zone, light);
  return light > 0;
}

export function nameZone(context, view, zone, colour = "#1d5d57", taken = []) {
  const corners = cornersOf(zone);
  const left = Math.min(...corners.map(([x]) => x));
  const top = Math.max(...corners.map(([, y]) => y));
  const [x, y] = view.toScreen(left, top);
  const isLine = zone.shape === "line";
  const wide = extent(corners) * view.scale;
  if (!isLine && wide < 40) return;
  const count = zone.inside === undefined || isLine ? "" : zone.blind ? " · ?" : ` · ${zone.inside}`;
  const look = { most: isLine ? LINE_NAME : wide - 10, size: 12, weight: 600, colour, align: "left" };
  shownName(context, zone.name || zone.id, count, [x + 7, isLine ? y - 9 : y + 12], look, taken);
}

// As much of a name as there is room for, unless another name stands there. `taken`: their boxes, [left, top, right, bottom].
export function shownName(context, name, behind, [x, y], { most, size, weight, colour, align }, taken) {
  const { words, width } = shortened(context, name, behind, most, size, weight);
  if (words === "") return;
  const left = align === "center" ? x - width / 2 : x;
  const box = [left, y - 7, left + width, y + 7];
  if (taken.some((other) => box[0] < other[2] && other[0] < box[2] && box[1] < other[3] && other[1] < box[3])) return;
  taken.push(box);
  text(context, words, x, y, size, colour, align, weight, true);
}

function paintZone(context, view, zone, light) {
  if (zone.shape === "line") {
    paintLine(context, view, cornersOf(zone), fade(ZONE, 0.75 + 0.25 * light), 2 + 2 * light);
    return;
  }
  polygon(context, view, cornersOf(zone));
  context.fillStyle = fade(ZONE, 0.1 + 0.16 * light);
  context.fill();
  context.strokeStyle = fade(ZONE, 0.55 + 0.45 * light);
  context.lineWidth = 1.2 + 1.6 * light;
  context.stroke();
}

// A directed line: its arrow points forward, from the left of the line to its right.
export function paintLine(context, view, points, colour, width) {
  line(context, view, points);
  context.strokeStyle = colour;
  context.lineWidth = width;
  context.lineJoin = context.lineCap = "round";
  context.stroke();
  const number = Math.floor((points.length - 1) / 2);
  const [x0, y0] = view.toScreen(...points[number]);
  const [x1, y1] = view.toScreen(...points[Math.min(number + 1, points.length - 1)]);
  const long = Math.hypot(x1 - x0, y1 - y0);
  if (long < 1) return;
  // On the screen y goes down: the right-hand side of (dx, dy) is (-dy, dx).
  const [rx, ry] = [-(y1 - y0) / long, (x1 - x0) / long];
  const [mx, my] = [(x0 + x1) / 2, (y0 + y1) / 2];
  const tip = [mx + 20 * rx, my + 20 * ry];
  context.beginPath();
  context.moveTo(mx, my);
  context.lineTo(...tip);
  context.moveTo(tip[0] - 7 * rx - 5 * ry, tip[1] - 7 * ry + 5 * rx);
  context.lineTo(...tip);
  context.lineTo(tip[0] - 7 * rx + 5 * ry, tip[1] - 7 * ry - 5 * rx);
  context.stroke();
}
