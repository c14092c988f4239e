// How does it look? Draws one floor and the people on it onto a canvas context; holds no state of its own.

const QUIET = "#6b7684";
const ZONE = "#2f7d76";
const CAMERA = "#b27a1e";
const RADIO = "#6a63b5";
const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif";
const LIGHTEN_MS = 4000;
const TRAIL_BANDS = 8;

export function paintPlan(context, view, floor) {
  polygon(context, view, floor.outline);
  context.fillStyle = "#ffffff";
  context.fill();
  grid(context, view, floor);
  polygon(context, view, floor.outline);
  context.strokeStyle = "#c3cad3";
  context.lineWidth = 1;
  context.stroke();
}

export function paintWalls(context, view, floor) {
  for (const obstacle of floor.obstacles) {
    polygon(context, view, obstacle.polygon);
    context.fillStyle = "#e4e8ed";
    context.fill();
    context.strokeStyle = "#b4bdc8";
    context.lineWidth = 1;
    context.stroke();
    const [x, y] = view.toScreen(...middle(obstacle.polygon));
    context.font = `11px ${FONT}`;
    const name = readable(obstacle.id);
    if (extent(obstacle.polygon) * view.scale > context.measureText(name).width + 6) {
      text(context, name, x, y, 11, QUIET, "center");
    }
  }
  context.strokeStyle = "#4a5563";
  context.lineWidth = Math.min(Math.max(0.12 * view.scale, 1.5), 5);
  context.lineJoin = context.lineCap = "round";
  for (const wall of floor.walls) {
    line(context, view, wall);
    context.stroke();
  }
}

// `zones`: [{polygon, name, count, lit}], lit = performance.now() of the newest alert or undefined.
export function paintZones(context, view, zones, now) {
  for (const zone of zones) {
    const light = zone.lit === undefined ? 0 : Math.max(0, 1 - (now - zone.lit) / LIGHTEN_MS);
    polygon(context, view, zone.polygon);
    context.fillStyle = fade(ZONE, 0.1 + 0.16 * light);
    context.fill();
    context.strokeStyle = fade(ZONE, 0.55 + 0.45 * light);
    context.lineWidth = 1.2 + 1.6 * light;
    context.stroke();
  }
  for (const zone of zones) {
    const left = Math.min(...zone.polygon.map(([x]) => x));
    const top = Math.max(...zone.polygon.map(([, y]) => y));
    const [x, y] = view.toScreen(left, top);
    const width = extent(zone.polygon) * view.scale;
    if (width < 40) continue;
    const count = zone.count === undefined ? "" : ` · ${zone.count}`;
    text(context, `${zone.name}${count}`, x + 7, y + 12, 12, "#1d5d57", "left", 600);
  }
}

export function paintFootprints(context, view, cameras) {
  for (const camera of cameras) {
    if (camera.footprint.length < 3) continue;
    polygon(context, view, camera.footprint);
    context.fillStyle = fade(CAMERA, 0.05);
    context.fill();
    context.setLineDash([5, 5]);
    context.strokeStyle = fade(CAMERA, 0.45);
    context.lineWidth = 1;
    context.stroke();
    context.setLineDash([]);
  }
}

export function paintCameras(context, view, cameras) {
  for (const camera of cameras) {
    const [x, y] = view.toScreen(camera.position[0], camera.position[1]);
    const aim = camera.footprint.length > 0 ? view.toScreen(...middle(camera.footprint)) : [x, y - 1];
    context.save();
    context.translate(x, y);
    context.rotate(Math.atan2(aim[1] - y, aim[0] - x));
    context.fillStyle = CAMERA;
    context.strokeStyle = "#ffffff";
    context.lineWidth = 1.5;
    context.beginPath();
    context.moveTo(3, -2.5);
    context.lineTo(10, -6);
    context.lineTo(10, 6);
    context.lineTo(3, 2.5);
    context.closePath();
    context.roundRect(-8, -5, 12, 10, 2);
    context.stroke();
    context.fill();
    context.restore();
    text(context, camera.id, x, y + 17, 11, "#8a5d12", "center", 400, true);
  }
}

export function paintRadio(context, view, points) {
  for (const point of points) {
    const [x, y] = view.toScreen(point.position[0], point.position[1]);
    context.strokeStyle = RADIO;
    context.fillStyle = RADIO;
    context.lineWidth = 1.3;
    context.lineCap = "round";
    for (const radius of [5, 9]) {
      context.beginPath();
      context.arc(x, y + 4, radius, -2.3, -0.84);
      context.stroke();
    }
    context.beginPath();
    context.arc(x, y + 4, 1.8, 0, 2 * Math.PI);
    context.fill();
    if (view.scale > 14) text(context, point.id, x, y + 15, 10, "#5750a0", "center", 400, true);
  }
}

// `people`: from Tracks.at; `chosen`: a device to point out; `layers`: what is switched on.
export function paintPeople(context, view, people, identities, layers, chosen) {
  const carrying = (person) => (person.device === null ? 0 : 1);
  const ordered = [...people].sort((a, b) => carrying(a) - carrying(b));
  if (layers.trails) for (const person of ordered) trail(context, view, person, identities.colourOf(person.device));
  for (const person of ordered) {
    if (person.state === "unseen") doubt(context, view, person, identities.colourOf(person.device));
  }
  for (const person of ordered) dot(context, view, person, identities.colourOf(person.device), chosen);
  for (const person of ordered) if (person.device !== null) label(context, view, person, identities);
}

export function paintMarker(context, view, marker, now) {
  const age = (now - marker.since) / 1500;
  if (age > 2) return false;
  const [x, y] = view.toScreen(marker.x, marker.y);
  context.beginPath();
  context.arc(x, y, 10 + 22 * (age % 1), 0, 2 * Math.PI);
  context.strokeStyle = fade(ZONE, 1 - (age % 1));
  context.lineWidth = 3;
  context.stroke();
  return true;
}

// A scale bar at the lower left, and an arrow to the north (degrees counter-clockwise from +x) beside it.
export function paintScale(context, view, north) {
  const steps = [0.5, 1, 2, 5, 10, 20, 50, 100, 200];
  const metres = steps.find((step) => step * view.scale >= 60) ?? 500;
  const [x, y] = [18, view.height - 20];
  const width = metres * view.scale;
  context.strokeStyle = QUIET;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(x, y - 4);
  context.lineTo(x, y);
  context.lineTo(x + width, y);
  context.lineTo(x + width, y - 4);
  context.stroke();
  text(context, `${metres} m`, x + width / 2, y - 8, 11, QUIET, "center");
  context.save();
  context.translate(x + width + 26, y - 8);
  context.rotate(Math.PI / 2 - (north * Math.PI) / 180);
  context.beginPath();
  context.moveTo(0, -11);
  context.lineTo(5, 7);
  context.lineTo(0, 3);
  context.lineTo(-5, 7);
  context.closePath();
  context.fillStyle = QUIET;
  context.fill();
  context.restore();
  text(context, "N", x + width + 38, y - 8, 11, QUIET, "left", 600);
}

function grid(context, view, floor) {
  const step = [1, 2, 5, 10, 20, 50].find((metres) => metres * view.scale >= 22) ?? 100;
  const [left, bottom, right, top] = bounds(floor.outline);
  context.save();
  context.clip();
  context.beginPath();
  for (let x = Math.ceil(left / step) * step; x <= right; x += step) {
    context.moveTo(...view.toScreen(x, bottom));
    context.lineTo(...view.toScreen(x, top));
  }
  for (let y = Math.ceil(bottom / step) * step; y <= top; y += step) {
    context.moveTo(...view.toScreen(left, y));
    context.lineTo(...view.toScreen(right, y));
  }
  context.strokeStyle = "#eff2f5";
  context.lineWidth = 1;
  context.stroke();
  context.restore();
}

// Fading in a few bands rather than piece by piece: with hundreds of people every stroke counts.
function trail(context, view, person, colour) {
  const points = person.trail;
  const last = points.length - 1;
  if (last < 0) return;
  context.lineWidth = 2.5;
  context.lineCap = "butt";
  context.lineJoin = "round";
  for (let band = 0; band < TRAIL_BANDS; band += 1) {
    const from = Math.floor((band * last) / TRAIL_BANDS);
    const to = Math.floor(((band + 1) * last) / TRAIL_BANDS);
    const newest = band === TRAIL_BANDS - 1;
    if (from === to && !newest) continue;
    context.strokeStyle = fade(colour, 0.45 * person.alpha * ((band + 1) / TRAIL_BANDS) ** 1.5);
    context.beginPath();
    for (let i = from; i <= to; i += 1) context.lineTo(...view.toScreen(points[i][1], points[i][2]));
    if (newest) context.lineTo(...view.toScreen(person.x, person.y));
    context.stroke();
  }
}

function dot(context, view, person, colour, chosen) {
  const [x, y] = view.toScreen(person.x, person.y);
  const radius = person.device === null ? 6 : 7.5;
  context.globalAlpha = person.alpha;
  if (chosen !== null && person.device === chosen) {
    context.beginPath();
    context.arc(x, y, radius + 8, 0, 2 * Math.PI);
    context.fillStyle = fade(colour, 0.2);
    context.fill();
  }
  if (person.state === "unseen") {
    hollow(context, x, y, radius, colour);
    context.globalAlpha = 1;
    return;
  }
  // Seen this moment: filled. Only expected to be here: hollow.
  const coasting = person.state === "coasting";
  const heading = Math.hypot(person.vx, person.vy) > 0.25 ? Math.atan2(-person.vy, person.vx) : null;
  disc(context, x, y, radius + 2, heading, "#ffffff");
  disc(context, x, y, radius, heading, colour);
  if (coasting) disc(context, x, y, radius - 2.5, null, "#ffffff");
  context.globalAlpha = 1;
}

// No camera sees this person: a dashed ring, for a place that steps and radio tell.
function hollow(context, x, y, radius, colour) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = "#ffffffb0";
  context.fill();
  context.setLineDash([4, 3]);
  context.strokeStyle = colour;
  context.lineWidth = 2.5;
  context.stroke();
  context.setLineDash([]);
}

// Two standard deviations around it: the person is most likely within.
function doubt(context, view, person, colour) {
  if (person.accuracy === null) return;
  const [x, y] = view.toScreen(person.x, person.y);
  context.globalAlpha = person.alpha;
  context.beginPath();
  context.arc(x, y, 2 * person.accuracy * view.scale, 0, 2 * Math.PI);
  context.fillStyle = fade(colour, 0.07);
  context.fill();
  context.setLineDash([3, 5]);
  context.strokeStyle = fade(colour, 0.5);
  context.lineWidth = 1;
  context.stroke();
  context.setLineDash([]);
  context.globalAlpha = 1;
}

// A disc with a point in the direction of walking.
function disc(context, x, y, radius, heading, colour) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = colour;
  context.fill();
  if (heading === null) return;
  context.beginPath();
  for (const [reach, turn] of [[1, -0.75], [1.75, 0], [1, 0.75]]) {
    context.lineTo(x + reach * radius * Math.cos(heading + turn), y + reach * radius * Math.sin(heading + turn));
  }
  context.closePath();
  context.fill();
}

function label(context, view, person, identities) {
  const [x, y] = view.toScreen(person.x, person.y);
  const name = identities.labelOf(person.device);
  context.font = `600 12px ${FONT}`;
  const width = context.measureText(name).width + 12;
  context.globalAlpha = person.alpha;
  context.beginPath();
  context.roundRect(x + 11, y - 24, width, 18, 9);
  context.fillStyle = identities.colourOf(person.device);
  context.fill();
  text(context, name, x + 17, y - 15, 12, "#ffffff", "left", 600);
  context.globalAlpha = 1;
}

function text(context, words, x, y, size, colour, align, weight = 400, halo = false) {
  context.font = `${weight} ${size}px ${FONT}`;
  context.textAlign = align;
  context.textBaseline = "middle";
  if (halo) {
    context.strokeStyle = "#ffffffd0";
    context.lineWidth = 3;
    context.lineJoin = "round";
    context.strokeText(words, x, y);
  }
  context.fillStyle = colour;
  context.fillText(words, x, y);
}

function polygon(context, view, ring) {
  line(context, view, ring);
  context.closePath();
}

function line(context, view, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(...view.toScreen(x, y));
}

export function bounds(ring) {
  const xs = ring.map(([x]) => x);
  const ys = ring.map(([, y]) => y);
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

function middle(ring) {
  const [left, bottom, right, top] = bounds(ring);
  return [(left + right) / 2, (bottom + top) / 2];
}

function extent(ring) {
  const [left, , right] = bounds(ring);
  return right - left;
}

function fade(colour, alpha) {
  const value = Math.round(255 * Math.min(Math.max(alpha, 0), 1));
  return colour + value.toString(16).padStart(2, "0");
}

function readable(id) {
  const words = id.replaceAll(/[-_]+/g, " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}
