// From little to much, light to dark: viridis, which the colour-blind and a grey printer tell apart as well.

const VIRIDIS = [
  "#fde725", "#c2df23", "#86d549", "#52c569", "#2ab07f", "#1e9b8a", "#25858e", "#2d708e", "#38588c", "#433e85", "#482173", "#440154",
].map((colour) => [1, 3, 5].map((i) => Number.parseInt(colour.slice(i, i + 2), 16)));

// Of a share from 0 to 1.
export function colourOf(share) {
  const place = Math.min(Math.max(share, 0), 1) * (VIRIDIS.length - 1);
  const low = Math.min(Math.floor(place), VIRIDIS.length - 2);
  const mixed = VIRIDIS[low].map((value, i) => Math.round(value + (place - low) * (VIRIDIS[low + 1][i] - value)));
  return `rgb(${mixed.join(",")})`;
}

// Whether text on it should be white.
export function isDark(share) {
  return share > 0.45;
}

// What is not told: grey with stripes, so that it is no shade of the scale.
export function hatch(context) {
  const tile = document.createElement("canvas");
  tile.width = tile.height = 8;
  const pen = tile.getContext("2d");
  pen.fillStyle = "#f4f6f8";
  pen.fillRect(0, 0, 8, 8);
  pen.strokeStyle = "#c3cad3";
  pen.lineWidth = 1;
  pen.beginPath();
  for (const from of [-8, 0, 8]) {
    pen.moveTo(from, 8);
    pen.lineTo(from + 8, 0);
  }
  pen.stroke();
  return context.createPattern(tile, "repeat");
}

// Colours of things that are no amounts, after Okabe and Ito; with dashes for more than eight.
const DISTINCT = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5b5b00", "#26323f"];
const DASHES = [[], [8, 4], [2, 3]];

export function strokeOf(number) {
  return { colour: DISTINCT[number % DISTINCT.length], dash: DASHES[Math.floor(number / DISTINCT.length) % DASHES.length] };
}
