// What is true of corners on a plan: lengths, crossings, and the nearest thing worth snapping to. Metres.

export function middleOf([x0, y0], [x1, y1]) {
  return [(x0 + x1) / 2, (y0 + y1) / 2];
}

// The edges of a shape, [[index of its first corner, corner, next corner]]; an area is closed, a line is not.
export function edges(points, shape) {
  const last = shape === "area" && points.length > 2 ? points.length : points.length - 1;
  const all = [];
  for (let i = 0; i < last; i += 1) all.push([i, points[i], points[(i + 1) % points.length]]);
  return all;
}

export function areaOf(points) {
  let twice = 0;
  for (let i = 0; i < points.length; i += 1) {
    const [x0, y0] = points[i];
    const [x1, y1] = points[(i + 1) % points.length];
    twice += x0 * y1 - x1 * y0;
  }
  return Math.abs(twice) / 2;
}

export function lengthOf(points) {
  let sum = 0;
  for (let i = 1; i < points.length; i += 1) sum += Math.hypot(points[i][0] - points[i - 1][0], points[i][1] - points[i - 1][1]);
  return sum;
}

// Whether the outline crosses or touches itself.
export function crossesItself(points, shape) {
  const all = edges(points, shape);
  for (let i = 0; i < all.length; i += 1) {
    for (let j = i + 1; j < all.length; j += 1) {
      const neighbours = j === i + 1 || (shape === "area" && i === 0 && j === all.length - 1);
      if (!neighbours && meet(all[i][1], all[i][2], all[j][1], all[j][2])) return true;
    }
  }
  return false;
}

// Why this shape cannot be a zone, in words; empty where it can.
export function whatIsWrong(points, shape) {
  if (shape === "point") return "";
  if (shape === "area") {
    if (points.length < 3) return "An area needs three corners.";
    if (crossesItself(points, shape)) return "The outline crosses itself: move a corner.";
    if (areaOf(points) < 0.01) return "This area is too small for anybody to be in.";
    return "";
  }
  if (points.length < 2 || lengthOf(points) < 0.1) return "A line needs two ends.";
  return crossesItself(points, shape) ? "The line crosses itself: move a corner." : "";
}

// The place to use for `place`: the nearest of `targets` within `reach` metres, otherwise on a grid of `step` metres.
export function snapped([x, y], targets, reach, step) {
  let best = null;
  for (const target of targets) {
    const far = Math.hypot(target[0] - x, target[1] - y);
    if (far <= reach && (best === null || far < best.far)) best = { far, target };
  }
  return best === null ? [rounded(x, step), rounded(y, step)] : [...best.target];
}

export function rounded(value, step) {
  return Number((Math.round(value / step) * step).toFixed(3));
}

function meet(a, b, c, d) {
  const side = (p, q, r) => Math.sign((q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0]));
  const between = (p, q, r) => Math.min(p[0], q[0]) <= r[0] && r[0] <= Math.max(p[0], q[0])
    && Math.min(p[1], q[1]) <= r[1] && r[1] <= Math.max(p[1], q[1]);
  const [s1, s2, s3, s4] = [side(a, b, c), side(a, b, d), side(c, d, a), side(c, d, b)];
  if (s1 !== s2 && s3 !== s4 && s1 * s2 <= 0 && s3 * s4 <= 0) return true;
  return (s1 === 0 && between(a, b, c)) || (s2 === 0 && between(a, b, d))
    || (s3 === 0 && between(c, d, a)) || (s4 === 0 && between(c, d, b));
}
