// The layers that stand still: plan, zones, walls, exhibits, cameras, access points. Painted once, copied under every picture.

import { paintExhibits } from "./exhibits.js";
import * as painting from "./painting.js";
import { paintZones } from "./zone_painting.js";

export class Ground {
  #canvas = document.createElement("canvas");
  #painted = null;

  // Anew only where the view, the floor, the zones or exhibits (of all floors) or what is shown has changed.
  picture(view, ratio, site, floor, zones, exhibits, layers) {
    const [x, y] = view.toScreen(0, 0);
    const shown = [layers.zones, layers.exhibits, layers.cameras, layers.radio];
    const key = [site, floor, zones, exhibits, ratio, view.width, view.height, view.scale, x, y, ...shown];
    if (this.#painted !== null && key.every((part, i) => part === this.#painted[i])) return this.#canvas;
    this.#painted = key;
    this.#canvas.width = Math.max(Math.round(view.width * ratio), 1);
    this.#canvas.height = Math.max(Math.round(view.height * ratio), 1);
    const context = this.#canvas.getContext("2d");
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const cameras = site.cameras.filter((camera) => camera.floor === floor.id);
    painting.paintPlan(context, view, floor);
    if (layers.cameras) painting.paintFootprints(context, view, cameras);
    const names = [];
    if (layers.zones) paintZones(context, view, zones.filter((zone) => zone.floor === floor.id), names);
    painting.paintWalls(context, view, floor);
    if (layers.exhibits) paintExhibits(context, view, exhibits.filter((one) => one.floor === floor.id), names);
    if (layers.radio) {
      painting.paintRadio(context, view, site.access_points.filter((one) => one.floor === floor.id && one.position));
    }
    if (layers.cameras) painting.paintCameras(context, view, cameras);
    painting.paintScale(context, view, site.north);
    return this.#canvas;
  }
}
