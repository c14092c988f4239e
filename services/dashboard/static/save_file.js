// Pictures and numbers to take away: PNG of what a page draws, CSV of what it knows.

import { text } from "./painting.js";

const SAVED_WIDTH = 1200;
const SAVED_RATIO = 2;
const TITLE = 44;

// Draw `picture` onto a canvas of the page, as wide as it stands there.
export function show(canvas, picture, data) {
  const ratio = window.devicePixelRatio || 1;
  const width = canvas.parentElement.clientWidth - 32;
  const height = picture.height(width, data);
  canvas.style.height = `${height}px`;
  canvas.style.width = `${width}px`;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  picture.draw(context, width, data);
}

// Save `picture` as PNG with a title above it: what, where and when must not be lost on the way.
export async function savePicture(picture, data, title, name) {
  const canvas = document.createElement("canvas");
  const height = picture.height(SAVED_WIDTH, data);
  canvas.width = SAVED_WIDTH * SAVED_RATIO;
  canvas.height = (height + TITLE) * SAVED_RATIO;
  const context = canvas.getContext("2d");
  context.setTransform(SAVED_RATIO, 0, 0, SAVED_RATIO, 0, 0);
  context.fillStyle = "#ffffff";
  context.fillRect(0, 0, SAVED_WIDTH, height + TITLE);
  text(context, title, 20, TITLE / 2, 16, "#26323f", "left", 600);
  context.translate(0, TITLE);
  picture.draw(context, SAVED_WIDTH, data);
  save(await new Promise((resolve) => canvas.toBlob(resolve, "image/png")), `${name}.png`);
}

// Save rows as CSV (RFC 4180); null is an empty field.
export function saveTable(header, rows, name) {
  const lines = [header, ...rows].map((row) => row.map(cell).join(","));
  save(new Blob([`${lines.join("\r\n")}\r\n`], { type: "text/csv" }), `${name}.csv`);
}

function cell(value) {
  if (value === null || value === undefined) return "";
  if (typeof value === "number") return String(value);
  // A spreadsheet takes what begins like a formula for one.
  const words = /^[=+\-@\t\r]/.test(value) ? `'${value}` : value;
  return /[",\r\n]/.test(words) ? `"${words.replaceAll('"', '""')}"` : words;
}

function save(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}
