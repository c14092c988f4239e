// How do people look? Hundreds of them, thirty times a second: what looks alike is drawn in one stroke.

import { inkOn, SHAPES } from "./identities.js";
import { fade, FONT, text } from "./painting.js";

const MARKER = "#2f7d76";
const OUTLINE = "#26323f"; // of phones
const FADES = 5; // steps in which people fade in and out
const LABELS_KEPT = 500;

const labels = new Map();

// `people`: from Tracks.at; `chosen(person)`: whether to point one out; `layers`: what is switched on.
export function paintPeople(context, view, people, identities, layers, chosen) {
  const onScreen = people.filter((person) => near(view, person));
  const looks = grouped(onScreen, identities);
  if (layers.doubt) for (const look of looks) doubts(context, view, look);
  for (const person of onScreen) if (chosen(person)) halo(context, view, person, identities.colourOf(person.device));
  for (const look of looks) dots(context, view, look);
  context.globalAlpha = 1;
  const ratio = context.getTransform().a;
  for (const person of onScreen) if (person.device !== null) label(context, view, person, identities, ratio);
  context.globalAlpha = 1;
}

export function paintMarker(context, view, marker, now) {
  const age = (now - marker.since) / 1500;
  if (age > 2) return false;
  const [x, y] = view.toScreen(marker.x, marker.y);
  context.beginPath();
  context.arc(x, y, 10 + 22 * (age % 1), 0, 2 * Math.PI);
  context.strokeStyle = fade(MARKER, 1 - (age % 1));
  context.lineWidth = 3;
  context.stroke();
  return true;
}

function near(view, person) {
  const [x, y] = view.toScreen(person.x, person.y);
  const margin = 2 * (person.accuracy ?? 0) * view.scale + 80;
  return x > -margin && y > -margin && x < view.width + margin && y < view.height + margin;
}

// Whoever has the same colour, shape, state and shade looks the same; people with a phone come last, on top.
export function grouped(people, identities) {
  const looks = new Map();
  for (const person of people) {
    const shade = Math.ceil(FADES * person.alpha) / FADES;
    const colour = identities.colourOf(person.device);
    const shape = identities.shapeOf(person.device);
    const key = `${person.device === null ? 0 : 1} ${colour} ${shape} ${person.state} ${shade}`;
    let look = looks.get(key);
    if (look === undefined) {
      look = { key, colour, shape, shade, state: person.state, radius: person.device === null ? 6 : 7.5, people: [] };
      looks.set(key, look);
    }
    look.people.push(person);
  }
  return [...looks.values()].sort((a, b) => (a.key < b.key ? -1 : 1));
}

// Two standard deviations: the person is most likely within. Dashed where steps and radio alone tell the place.
function doubts(context, view, { people, colour, shade, state, radius }) {
  context.beginPath();
  for (const person of people) {
    if (person.accuracy === null) continue;
    const wide = 2 * person.accuracy * view.scale;
    if (wide < radius + 2) continue; // no wider than the dot itself
    const [x, y] = view.toScreen(person.x, person.y);
    context.moveTo(x + wide, y);
    context.arc(x, y, wide, 0, 2 * Math.PI);
  }
  context.fillStyle = fade(colour, (state === "unseen" ? 0.07 : 0.12) * shade);
  context.fill();
  if (state !== "unseen") return;
  context.setLineDash([3, 5]);
  context.strokeStyle = fade(colour, 0.5 * shade);
  context.lineWidth = 1;
  context.stroke();
  context.setLineDash([]);
}

function halo(context, view, person, colour) {
  const [x, y] = view.toScreen(person.x, person.y);
  context.beginPath();
  context.arc(x, y, 16, 0, 2 * Math.PI);
  context.fillStyle = fade(colour, 0.22);
  context.fill();
  context.strokeStyle = colour;
  context.lineWidth = 1.5;
  context.stroke();
}

// Seen this moment: filled. Only expected to be here: hollow. No camera sees this person: a dashed ring.
function dots(context, view, { people, colour, shape, shade, state, radius }) {
  context.globalAlpha = shade;
  if (state === "unseen") {
    marks(context, view, people, shape, radius, false);
    context.fillStyle = "#ffffffb0";
    context.fill();
    context.setLineDash([4, 3]);
    context.strokeStyle = colour;
    context.lineWidth = 2.5;
    context.stroke();
    context.setLineDash([]);
    return;
  }
  marks(context, view, people, shape, radius + 2, true);
  context.fillStyle = "#ffffff";
  context.fill();
  marks(context, view, people, shape, radius, true);
  if (shape !== null) {
    context.strokeStyle = OUTLINE;
    context.lineWidth = 1.5;
    context.stroke();
  }
  context.fillStyle = colour;
  context.fill();
  if (state === "coasting") {
    marks(context, view, people, shape, radius - 2.5, false);
    context.fillStyle = "#ffffff";
    context.fill();
  }
}

// One path of marks, each with a point in the direction of walking where `headings`.
function marks(context, view, people, shape, radius, headings) {
  context.beginPath();
  for (const person of people) {
    const [x, y] = view.toScreen(person.x, person.y);
    if (shape === null) {
      context.moveTo(x + radius, y);
      context.arc(x, y, radius, 0, 2 * Math.PI);
    } else {
      SHAPES[shape].forEach(([right, down], i) => context[i === 0 ? "moveTo" : "lineTo"](x + radius * right, y + radius * down));
      context.closePath();
    }
    if (!headings || Math.hypot(person.vx, person.vy) <= 0.25) continue;
    const heading = Math.atan2(-person.vy, person.vx);
    const at = (reach, turn) => [
      x + reach * radius * Math.cos(heading + turn),
      y + reach * radius * Math.sin(heading + turn),
    ];
    context.moveTo(...at(1, -0.75));
    context.lineTo(...at(1.75, 0));
    context.lineTo(...at(1, 0.75));
    context.closePath();
  }
}

// Text is slow to draw: every name is drawn once, and copied.
function label(context, view, person, identities, ratio) {
  const name = identities.labelOf(person.device);
  const colour = identities.colourOf(person.device);
  const key = `${ratio} ${colour} ${name}`;
  let picture = labels.get(key);
  if (picture === undefined) {
    if (labels.size >= LABELS_KEPT) labels.clear();
    picture = labelPicture(name, colour, ratio);
    labels.set(key, picture);
  }
  const [x, y] = view.toScreen(person.x, person.y);
  context.globalAlpha = person.alpha;
  context.drawImage(picture, x + 11, y - 24, picture.width / ratio, picture.height / ratio);
}

function labelPicture(name, colour, ratio) {
  const canvas = document.createElement("canvas");
  const context = canvas.getContext("2d");
  context.font = `600 12px ${FONT}`;
  const width = context.measureText(name).width + 12;
  canvas.width = Math.ceil(width * ratio);
  canvas.height = Math.ceil(18 * ratio);
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.beginPath();
  context.roundRect(0, 0, width, 18, 9);
  context.fillStyle = colour;
  context.fill();
  text(context, name, 6, 9, 12, inkOn(colour), "left", 600);
  return canvas;
}
