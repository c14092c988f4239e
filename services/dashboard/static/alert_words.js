// An alert in plain words: who did what where, and what was found where something is limited.

import { duration } from "./dom.js";

export const KINDS = {
  enter: "Entered",
  exit: "Left",
  dwell: "Stayed too long",
  cross: "Crossed a line",
  crowd: "Too many people",
  proximity: "Too close",
  speed: "Too fast",
};

// {who: "Phone 1b07", did: "entered Entrance"}
export function inWords(alert, identities, zone) {
  const who = someone(alert.device, identities);
  switch (alert.kind) {
    case "enter":
      return { who, did: `entered ${zone}` };
    case "exit":
      return { who, did: `left ${zone}` };
    case "dwell":
      return { who, did: `has stayed ${known(alert.value, duration, "long")} in ${zone}` };
    case "cross":
      return { who, did: `crossed ${zone}${alert.direction ? ` ${alert.direction}s` : ""}` };
    case "crowd": {
      const people = known(alert.value, (value) => `${Math.round(value)} people`, "Too many people");
      const most = alert.limit === null || alert.limit === undefined ? "" : `, allowed: ${Math.round(alert.limit)}`;
      return { who: people, did: `in ${zone}${most}` };
    }
    case "proximity": {
      const far = known(alert.value, (value) => `${value.toFixed(1)} m from`, "too close to");
      return { who, did: `came ${far} ${alert.other_device ? someone(alert.other_device, identities) : "somebody"} in ${zone}` };
    }
    case "speed":
      return { who, did: `went ${known(alert.value, (value) => `${value.toFixed(1)} m/s`, "too fast")} in ${zone}` };
    default:
      return { who, did: `${alert.kind} ${zone}` };
  }
}

function someone(device, identities) {
  return device ? `Phone ${identities.labelOf(device)}` : "Somebody";
}

function known(value, words, otherwise) {
  return value === null || value === undefined ? otherwise : words(value);
}
