// Moving the map: drag and wheel, two fingers, or the keyboard.

const STEP = 60;

export class Pointer {
  #fingers = new Map();

  constructor(canvas, view, fit) {
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.#fingers.set(event.pointerId, [event.offsetX, event.offsetY]);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = this.#fingers.get(event.pointerId);
      if (before === undefined) return;
      const now = [event.offsetX, event.offsetY];
      const other = [...this.#fingers].find(([id]) => id !== event.pointerId)?.[1];
      if (other === undefined) {
        view.pan(now[0] - before[0], now[1] - before[1]);
      } else {
        const middle = [(now[0] + other[0]) / 2, (now[1] + other[1]) / 2];
        const apart = (place) => Math.max(Math.hypot(place[0] - other[0], place[1] - other[1]), 10);
        view.pan((now[0] - before[0]) / 2, (now[1] - before[1]) / 2);
        view.zoom(apart(now) / apart(before), ...middle);
      }
      this.#fingers.set(event.pointerId, now);
    });
    for (const end of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(end, (event) => this.#fingers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const pixels = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? 30 * event.deltaY : event.deltaY;
      view.zoom(Math.exp(-0.0015 * pixels), event.offsetX, event.offsetY);
    }, { passive: false });
    const keys = {
      ArrowLeft: () => view.pan(STEP, 0),
      ArrowRight: () => view.pan(-STEP, 0),
      ArrowUp: () => view.pan(0, STEP),
      ArrowDown: () => view.pan(0, -STEP),
      "+": () => view.zoom(1.25),
      "=": () => view.zoom(1.25),
      "-": () => view.zoom(0.8),
      0: fit,
    };
    canvas.addEventListener("keydown", (event) => {
      const act = event.ctrlKey || event.metaKey || event.altKey ? undefined : keys[event.key];
      if (act === undefined) return;
      event.preventDefault();
      act();
    });
  }
}
