// The pictures of the visits page. Each is drawn by (context, width, data) and tells how high it is; so the one on the
// page and the one that is saved are the same.

import { colourOf, hatch, isDark, strokeOf } from "./colour_scale.js";
import { duration } from "./dom.js";
import { bounds, FONT, paintPlan, paintWalls, text } from "./painting.js";
import { dayWords, words } from "./site_time.js";
import { Viewport } from "./viewport.js";

const INK = "#26323f";
const QUIET = "#5d6875";
const LEGEND = 60; // pixels
const NOTE = 22; // pixels
const FEW = "fewer than 5 people: not told";

// A heat map on the plan: {floor, heat, most}. Cells of few people are striped.
export const heatPicture = {
  height: (width, { floor }) => {
    const [left, bottom, right, top] = bounds(floor.outline);
    return Math.min(Math.max(((width - 40) * (top - bottom)) / (right - left) + 30, 180), 700) + LEGEND;
  },
  draw(context, width, { floor, heat, most }) {
    const view = new Viewport();
    view.resize(width, this.height(width, { floor }) - LEGEND);
    view.fit(bounds(floor.outline));
    paintPlan(context, view, floor);
    const stripes = hatch(context);
    const side = heat.cell * view.scale;
    heat.seconds.forEach((row, j) => row.forEach((seconds, i) => {
      if (seconds === 0) return;
      const [x, y] = view.toScreen(heat.origin[0] + i * heat.cell, heat.origin[1] + (j + 1) * heat.cell);
      context.fillStyle = seconds === null ? stripes : colourOf(seconds / most);
      context.globalAlpha = seconds === null ? 1 : 0.88;
      context.fillRect(x, y, side + 0.3, side + 0.3);
    }));
    context.globalAlpha = 1;
    paintWalls(context, view, { ...floor, obstacles: floor.obstacles.map((part) => ({ ...part })) });
    legend(context, width, view.height + 10, most);
  },
};

function legend(context, width, y, most) {
  const wide = Math.min(220, width - 40);
  for (let i = 0; i < wide; i += 1) {
    context.fillStyle = colourOf(i / wide);
    context.fillRect(20 + i, y, 1.5, 12);
  }
  text(context, "0", 20, y + 22, 11, QUIET, "left");
  text(context, `${duration(most)} and more`, 20 + wide, y + 22, 11, QUIET, "right");
  const beside = width > wide + 260;
  const [x, at] = beside ? [20 + wide + 24, y] : [20, y + 34];
  context.fillStyle = hatch(context);
  context.fillRect(x, at, 22, 12);
  text(context, FEW, x + 28, at + 6, 11, QUIET, "left");
}

// The same picture and below it the `note` of its data, if there is one: what is left out.
function withNote(picture) {
  return {
    height: (width, data) => picture.height(width, data) + (data.note ? NOTE : 0),
    draw(context, width, data) {
      picture.draw(context, width, data);
      text(context, data.note, 0, picture.height(width, data) + NOTE / 2, 11, QUIET, "left");
    },
  };
}

// Stays by zone, a bar to the median and a line to where nine in ten have left: {rows: [{name, median, p90, …}]}.
export const dwellPicture = withNote({
  height: (_, { rows }) => 34 + 34 * rows.length,
  draw(context, width, { rows }) {
    const left = Math.min(150, width * 0.34);
    const most = Math.max(...rows.map((row) => row.p90 ?? row.median ?? 0), 1);
    const long = (seconds) => ((width - left - 90) * seconds) / most;
    rows.forEach((row, i) => {
      const y = 24 + 34 * i;
      text(context, shortened(context, row.name, left - 12, 13), left - 8, y, 13, INK, "right");
      if (row.median === null) {
        context.fillStyle = hatch(context);
        context.fillRect(left, y - 9, 22, 18);
        text(context, FEW, left + 30, y, 11, QUIET, "left");
        return;
      }
      context.fillStyle = "#0072b2";
      context.fillRect(left, y - 9, Math.max(long(row.median), 1), 18);
      context.strokeStyle = INK;
      context.lineWidth = 1.5;
      context.beginPath();
      context.moveTo(left + long(row.median), y);
      context.lineTo(left + long(row.p90), y);
      context.moveTo(left + long(row.p90), y - 5);
      context.lineTo(left + long(row.p90), y + 5);
      context.stroke();
      text(context, `${duration(row.median)} – ${duration(row.p90)}`, left + long(row.p90) + 6, y, 11, QUIET, "left");
    });
    text(context, "bar: half have left; mark: nine in ten have", 0, 24 + 34 * rows.length, 11, QUIET, "left");
  },
});

// A matrix of ways from zone to zone: {names, counts}.
export const flowPicture = withNote({
  height: (_, { names }) => 130 + 38 * names.length,
  draw(context, width, { names, counts }) {
    const left = Math.min(140, width * 0.32);
    const top = 104;
    const side = Math.min((width - left - 10) / names.length, 90);
    const most = Math.max(...counts.flat().map((value) => value ?? 0), 1);
    names.forEach((name, i) => {
      context.save();
      context.translate(left + side * (i + 0.5), top - 8);
      context.rotate(-Math.PI / 5);
      text(context, shortened(context, name, 120, 12), 0, 0, 12, INK, "left");
      context.restore();
      text(context, shortened(context, name, left - 12, 12), left - 8, top + 38 * i + 19, 12, INK, "right");
    });
    counts.forEach((row, j) => row.forEach((value, i) => {
      const [x, y] = [left + side * i, top + 38 * j];
      const share = (value ?? 0) / most;
      context.fillStyle = value === null ? hatch(context) : value === 0 ? "#ffffff" : colourOf(share);
      context.fillRect(x, y, side - 2, 36);
      context.strokeStyle = "#dfe4ea";
      context.lineWidth = 1;
      context.strokeRect(x, y, side - 2, 36);
      const words_ = value === null ? "< 5" : String(value);
      text(context, words_, x + side / 2 - 1, y + 18, 12, value && isDark(share) ? "#ffffff" : INK, "center", 600, value === null);
    }));
    context.fillStyle = hatch(context);
    context.fillRect(left, top + 38 * names.length + 4, 20, 12);
    text(context, FEW, left + 28, top + 38 * names.length + 10, 11, QUIET, "left");
  },
});

// People over time, a line per zone: {t, step, series: [{name, people}], timeZone}. A gap: nothing is known.
export const occupancyPicture = withNote({
  height: (_, { series }) => 290 + 18 * Math.ceil(series.length / 3),
  draw(context, width, { t, step, series, timeZone }) {
    const [left, top, bottom] = [44, 14, 250];
    const right = width - 14;
    const most = Math.max(...series.flatMap(({ people }) => people.map((value) => value ?? 0)), 1);
    const tick = niceStep(most / 4);
    const until = t.at(-1) + step;
    const x = (when) => left + ((right - left) * (when - t[0])) / (until - t[0]);
    const y = (value) => bottom - ((bottom - top) * value) / (tick * Math.ceil(most / tick));
    context.lineWidth = 1;
    for (let value = 0; value <= tick * Math.ceil(most / tick) + 1e-9; value += tick) {
      context.strokeStyle = "#e4e8ed";
      context.beginPath();
      context.moveTo(left, y(value));
      context.lineTo(right, y(value));
      context.stroke();
      text(context, String(Number(value.toFixed(2))), left - 8, y(value), 11, QUIET, "right");
    }
    const byDay = until - t[0] > 2 * 86400;
    const every = Math.max(Math.ceil(t.length / Math.max(Math.floor((right - left) / 80), 1)), 1);
    t.forEach((when, i) => {
      if (i % every === 0) text(context, byDay ? dayWords(when, timeZone) : words(when, timeZone, false), x(when), bottom + 14, 11, QUIET, "left");
    });
    series.forEach(({ name, people }, number) => {
      const { colour, dash } = strokeOf(number);
      context.strokeStyle = colour;
      context.lineWidth = 2;
      context.lineJoin = "round";
      context.setLineDash(dash);
      context.beginPath();
      people.forEach((value, i) => {
        if (value === null) return;
        if (i === 0 || people[i - 1] === null) context.moveTo(x(t[i]), y(value));
        else context.lineTo(x(t[i]), y(value));
        context.lineTo(x(t[i] + step), y(value));
      });
      context.stroke();
      const [lx, ly] = [left + ((right - left) / 3) * (number % 3), bottom + 38 + 18 * Math.floor(number / 3)];
      context.beginPath();
      context.moveTo(lx, ly);
      context.lineTo(lx + 22, ly);
      context.stroke();
      context.setLineDash([]);
      text(context, shortened(context, name, (right - left) / 3 - 40, 12), lx + 28, ly, 12, INK, "left");
    });
  },
});

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(Math.max(least, 0.1)));
  return [1, 2, 5, 10].map((factor) => factor * power).find((step) => step >= least);
}

function shortened(context, words_, most, size) {
  context.font = `400 ${size}px ${FONT}`;
  let short = words_;
  while (short.length > 3 && context.measureText(short).width > most) short = `${short.slice(0, -2)}…`;
  return short;
}
