// How a camera is doing, as a light and a few words.

import { sentence } from "./dom.js";

export function cameraInWords(camera) {
  const reason = camera?.reason ? `: ${camera.reason}` : "";
  switch (camera?.state) {
    case "ok": {
      const rate = camera.frames_per_s ? `, ${Math.round(camera.frames_per_s)} pictures a second` : "";
      return { light: "good", words: `Working${rate}` };
    }
    case "starting":
      return { light: "wait", words: `Starting${reason}` };
    case "degraded":
      return { light: "bad", words: camera.reason ? sentence(camera.reason) : "Has a problem" };
    case "ended":
      return { light: "off", words: camera.reason ? sentence(camera.reason) : "Its recording has ended" };
    default:
      return { light: "off", words: "Not heard of yet" };
  }
}
