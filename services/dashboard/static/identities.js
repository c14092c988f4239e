// Which colour, which shape and which short name does a phone have? A hash of its id tells: the same after every reload,
// on every page, in every browser. The shape says it to those who do not see the colour.

import { element } from "./dom.js";

// Okabe and Ito's palette without the purple, which deuteranopes see as the grey of people without a phone; a dark blue
// for its black.
const COLOURS = ["#0072b2", "#d55e00", "#009e73", "#e69f00", "#56b4e9", "#f0e442", "#26323f"];
export const ANONYMOUS = "#8791a0"; // and round

// Corners within a circle of radius 1, y downwards.
export const SHAPES = {
  square: [[-0.8, -0.8], [0.8, -0.8], [0.8, 0.8], [-0.8, 0.8]],
  diamond: [[0, -1.1], [1.1, 0], [0, 1.1], [-1.1, 0]],
  triangle: [[0, -1.1], [1.05, 0.8], [-1.05, 0.8]],
  wedge: [[-1.05, -0.8], [1.05, -0.8], [0, 1.1]],
  plus: cross(),
  cross: cross().map(([x, y]) => [0.707 * (x - y), 0.707 * (x + y)]),
};
const NAMES = Object.keys(SHAPES);

export class Identities {
  #looks = new Map();
  #labels = new Map();
  #taken = new Set();

  colourOf(device) {
    return this.#lookOf(device).colour;
  }

  // A name in SHAPES; null: round, for people without a phone.
  shapeOf(device) {
    return this.#lookOf(device).shape;
  }

  // The mark of a phone in a list, as it is on the map.
  swatch(device) {
    const { colour, shape } = this.#lookOf(device);
    const mark = element("span", { class: "swatch" });
    mark.style.background = colour;
    if (shape === null) return mark;
    const corners = SHAPES[shape].map(([x, y]) => `${(50 + 45 * x).toFixed(1)}% ${(50 + 45 * y).toFixed(1)}%`);
    mark.classList.add("shaped");
    mark.style.clipPath = `polygon(${corners.join(", ")})`;
    return mark;
  }

  labelOf(device) {
    if (device === null || device === undefined) return "";
    let label = this.#labels.get(device);
    if (label === undefined) {
      label = device;
      // Ids are long and random: the last characters will do as long as no other device ends like that.
      for (let length = 4; device.length > 10 && length <= device.length; length += 1) {
        label = device.slice(-length);
        if (!this.#taken.has(label)) break;
      }
      this.#taken.add(label);
      this.#labels.set(device, label);
    }
    return label;
  }

  #lookOf(device) {
    if (device === null || device === undefined) return { colour: ANONYMOUS, shape: null };
    let look = this.#looks.get(device);
    if (look === undefined) {
      const number = hash(device) % (COLOURS.length * NAMES.length);
      look = { colour: COLOURS[number % COLOURS.length], shape: NAMES[Math.floor(number / COLOURS.length)] };
      this.#looks.set(device, look);
    }
    return look;
  }
}

// Black or white, whichever is easier to read on a colour (relative luminance of WCAG 2).
export function inkOn(colour) {
  const [red, green, blue] = [1, 3, 5].map((i) => (Number.parseInt(colour.slice(i, i + 2), 16) / 255) ** 2.2);
  return 0.2126 * red + 0.7152 * green + 0.0722 * blue > 0.18 ? "#10161d" : "#ffffff";
}

function cross() {
  const [near, far] = [0.4, 1.1];
  return [[-near, -far], [near, -far], [near, -near], [far, -near], [far, near], [near, near],
    [near, far], [-near, far], [-near, near], [-far, near], [-far, -near], [-near, -near]];
}

// FNV-1a, 32 bit, its bits mixed (the finalizer of MurmurHash3): ids that differ in their last character look different.
function hash(text) {
  let value = 0x811c9dc5;
  for (let i = 0; i < text.length; i += 1) value = Math.imul(value ^ text.charCodeAt(i), 0x01000193);
  value = Math.imul(value ^ (value >>> 16), 0x85ebca6b);
  value = Math.imul(value ^ (value >>> 13), 0xc2b2ae35);
  return (value ^ (value >>> 16)) >>> 0;
}
