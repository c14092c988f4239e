// How do zones look? Areas with corners, and lines with the side that counts as forward.

import { extent, fade, line, polygon, text } from "./painting.js";

const ZONE = "#2f7d76";
const LIGHTEN_MS = 4000;

// The site file says `polygon`, the API's zones say `points`.
export function cornersOf(zone) {
  return zone.points ?? zone.polygon;
}

// `zones`: as the API tells them.
export function paintZones(context, view, zones) {
  for (const zone of zones) paintZone(context, view, zone, 0);
  for (const zone of zones) nameZone(context, view, zone);
}

// A zone of which an alert has just come shines for a while; returns whether it still does.
export function paintLit(context, view, zone, since, now) {
  const light = 1 - (now - since) / LIGHTEN_MS;
  if (light > 0) paintZone(context, view, zone, light);
  return light > 0;
}

const LONGEST_NAME = 40; // letters on the plan

export function nameZone(context, view, zone, colour = "#1d5d57") {
  const corners = cornersOf(zone);
  const left = Math.min(...corners.map(([x]) => x));
  const top = Math.max(...corners.map(([, y]) => y));
  const [x, y] = view.toScreen(left, top);
  const isLine = zone.shape === "line";
  if (!isLine && extent(corners) * view.scale < 40) return;
  const count = zone.inside === undefined || isLine ? "" : ` · ${zone.inside}`;
  const name = zone.name || zone.id;
  text(context, `${name.length > LONGEST_NAME ? `${name.slice(0, LONGEST_NAME)}…` : name}${count}`, x + 7, isLine ? y - 9 : y + 12, 12, colour, "left", 600, true);
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
