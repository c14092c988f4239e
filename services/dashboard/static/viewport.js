// Where on the screen does a place on the plan appear? Metres, y upwards, to CSS pixels, y downwards.

const MOST = 400; // pixels per metre

export class Viewport {
  width = 1;
  height = 1;
  scale = 20; // pixels per metre
  #x = 0; // the place in the middle of the screen
  #y = 0;
  #least = 1;

  resize(width, height) {
    this.width = width;
    this.height = height;
  }

  toScreen(x, y) {
    return [(x - this.#x) * this.scale + this.width / 2, (this.#y - y) * this.scale + this.height / 2];
  }

  toPlan(px, py) {
    return [(px - this.width / 2) / this.scale + this.#x, this.#y - (py - this.height / 2) / this.scale];
  }

  // Show the rectangle [left, bottom, right, top] with a margin.
  fit([left, bottom, right, top]) {
    const margin = Math.min(56, 0.08 * Math.min(this.width, this.height) + 16);
    const wide = Math.max(right - left, 0.5);
    const high = Math.max(top - bottom, 0.5);
    this.scale = Math.min((this.width - 2 * margin) / wide, (this.height - 2 * margin) / high);
    this.scale = Math.min(Math.max(this.scale, 0.5), MOST);
    this.#least = this.scale / 4;
    this.centre((left + right) / 2, (bottom + top) / 2);
  }

  centre(x, y) {
    this.#x = x;
    this.#y = y;
  }

  pan(dx, dy) {
    this.#x -= dx / this.scale;
    this.#y += dy / this.scale;
  }

  // Zoom so that the place under (px, py) stays where it is.
  zoom(factor, px = this.width / 2, py = this.height / 2) {
    const [x, y] = this.toPlan(px, py);
    this.scale = Math.min(Math.max(this.scale * factor, this.#least), MOST);
    const [nowX, nowY] = this.toPlan(px, py);
    this.#x += x - nowX;
    this.#y += y - nowY;
  }
}
