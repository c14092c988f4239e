// Which colour and which short name does a device have? The same all day, and the same in every browser.

// Twelve hues readable on a light plan, neighbours chosen far apart.
const COLOURS = [
  "#1f6fb2", "#d1570b", "#1b8a5a", "#a03ba0", "#c4283c", "#0f8d9d",
  "#7a5a14", "#5b50c8", "#c2468b", "#4c7d17", "#85483a", "#2c4f73",
];
export const ANONYMOUS = "#8791a0";

export class Identities {
  #colours = new Map();
  #labels = new Map();
  #used = COLOURS.map(() => 0);
  #taken = new Set();

  colourOf(device) {
    if (device === null || device === undefined) return ANONYMOUS;
    let colour = this.#colours.get(device);
    if (colour === undefined) {
      // The hash decides where to start, so that most devices look the same in every browser;
      // a colour already worn gives way to the next that is worn least.
      const least = Math.min(...this.#used);
      let slot = hash(device) % COLOURS.length;
      while (this.#used[slot] > least) slot = (slot + 1) % COLOURS.length;
      this.#used[slot] += 1;
      colour = COLOURS[slot];
      this.#colours.set(device, colour);
    }
    return colour;
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
}

// FNV-1a, 32 bit.
function hash(text) {
  let value = 0x811c9dc5;
  for (let i = 0; i < text.length; i += 1) value = Math.imul(value ^ text.charCodeAt(i), 0x01000193);
  return value >>> 0;
}
