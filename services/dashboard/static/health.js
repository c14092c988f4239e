// Does it all work, and what does not? The API's health in plain words, every few seconds.

import { ask } from "./ask.js";
import { cameraInWords } from "./camera_words.js";
import { appeared, count, duration, element, sentence, table } from "./dom.js";

const EVERY_MS = 3000;
const OLD = 5; // seconds
const DOES = {
  api: "answers programs and this dashboard",
  camera: "finds people in pictures",
  dashboard: "shows these pages",
  fusion: "tracks people and finds out who they are",
  gateway: "hears phones",
  geofence: "tells who enters and leaves which zone",
  history: "remembers",
  learning: "learns radio, cameras and strides",
  simulator: "plays people: this is no real site",
};

const page = await appeared(["health-verdict", "health-problems", "health-areas", "health-cameras", "health-services"]);
let shown = "";

async function look() {
  try {
    draw(await ask("health"));
  } catch (refusal) {
    shown = "";
    verdict(`Nobody knows: ${refusal.message}`, "bad");
    page["health-problems"].replaceChildren();
    for (const name of ["areas", "cameras", "services"]) page[`health-${name}`].replaceChildren();
  }
  setTimeout(look, EVERY_MS);
}

function draw(health) {
  const now = JSON.stringify([health.status, health.problems, health.services,
    health.areas.map((area) => [area.area, area.people, area.age === null ? null : Math.floor(area.age)]), health.cameras.map(cameraInWords)]);
  if (now === shown) return;
  shown = now;
  const wrong = health.problems.length;
  if (health.status === "ok") verdict("All is well.", "good");
  else verdict(wrong === 0 ? "Something is wrong." : `${count(wrong, "thing is", "things are")} wrong:`, "bad");
  page["health-problems"].replaceChildren(...health.problems.map((words) => element("li", {}, sentence(words))));
  page["health-areas"].replaceChildren(table(["Area", "People seen by cameras", "Last heard"], health.areas.map((area) => [
    area.area, String(area.people),
    lit(area.age === null ? "off" : area.age > OLD ? "bad" : "good", area.age === null ? "never" : area.age < 2 ? "now" : `${duration(area.age)} ago`),
  ])));
  page["health-cameras"].replaceChildren(health.cameras.length === 0 ? element("p", { class: "empty" }, "This site has no camera.")
    : table(["Camera", "How it is doing"], health.cameras.map((camera) => {
      const { light, words } = cameraInWords(camera);
      return [camera.camera, lit(light, words)];
    })));
  page["health-services"].replaceChildren(table(["Program", "What it does", "Now"], health.services.map(({ service, instance, alive }) => [
    instance === "0" ? service : `${service} ${instance}`, DOES[service] ?? "",
    lit(alive ? "good" : "bad", alive ? "running" : "gone"),
  ])));
}

function verdict(words, light) {
  page["health-verdict"].textContent = words;
  page["health-verdict"].className = `verdict ${light}`;
}

// Colour alone tells nobody who cannot see it: the words say it, too.
function lit(light, words) {
  return element("span", { class: "lit" }, element("span", { class: `light ${light}` }), words);
}

look();
