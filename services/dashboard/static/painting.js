// How does a floor look? Draws the plan and what hangs there onto a canvas context; holds no state of its own.

const QUIET = "#6b7684";
const CAMERA = "#b27a1e";
const RADIO = "#6a63b5";
export const FONT = "system-ui, -apple-system, 'Segoe UI', Roboto, 'Liberation Sans', sans-serif";

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

export function text(context, words, x, y, size, colour, align, weight = 400, halo = false) {
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

// A name cut to `most` pixels, with what must stay behind it: {words, width}; no words where nothing of it fits.
export function shortened(context, name, behind, most, size, weight = 400) {
  context.font = `${weight} ${size}px ${FONT}`;
  const widthOf = (words) => context.measureText(words).width;
  if (widthOf(name + behind) <= most) return { words: name + behind, width: widthOf(name + behind) };
  let [low, high] = [0, Math.min(name.length, 100)];
  while (low < high) {
    const half = Math.ceil((low + high) / 2);
    if (widthOf(`${name.slice(0, half)}…${behind}`) <= most) low = half;
    else high = half - 1;
  }
  const words = low < 2 ? "" : `${name.slice(0, low).trimEnd()}…${behind}`;
  return { words, width: widthOf(words) };
}

export function polygon(context, view, ring) {
  line(context, view, ring);
  context.closePath();
}

export function line(context, view, points) {
  context.beginPath();
  for (const [x, y] of points) context.lineTo(...view.toScreen(x, y));
}

export function bounds(ring) {
  const xs = ring.map(([x]) => x);
  const ys = ring.map(([, y]) => y);
  return [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)];
}

export function middle(ring) {
  const [left, bottom, right, top] = bounds(ring);
  return [(left + right) / 2, (bottom + top) / 2];
}

export function extent(ring) {
  const [left, , right] = bounds(ring);
  return right - left;
}

export function fade(colour, alpha) {
  const value = Math.round(255 * Math.min(Math.max(alpha, 0), 1));
  return colour + value.toString(16).padStart(2, "0");
}

function readable(id) {
  const words = id.replaceAll(/[-_]+/g, " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

// Even-odd rule; a point on the edge may fall either way.
export function inside(ring, x, y) {
  let within = false;
  for (let i = 0, j = ring.length - 1; i < ring.length; j = i, i += 1) {
    const [xi, yi] = ring[i];
    const [xj, yj] = ring[j];
    if (yi > y !== yj > y && x < ((xj - xi) * (y - yi)) / (yj - yi) + xi) within = !within;
  }
  return within;
}
