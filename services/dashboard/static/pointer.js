// Moving the map: drag and wheel, two fingers, or the keyboard; and a tap on a place.

const STEP = 60;
const TAP = 5; // pixels a tap may move

export class Pointer {
  #fingers = new Map();
  #began = null;

  // `tap(px, py)`: somebody pointed at a place; `grab(px, py)` may return a handle to drag, {move(px, py), drop()}.
  constructor(canvas, view, fit, { tap = () => {}, grab = () => null } = {}) {
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      const place = [event.offsetX, event.offsetY];
      if (this.#fingers.size === 0) this.#began = { place, moved: false, handle: grab(...place) };
      else this.#began.moved = true;
      this.#fingers.set(event.pointerId, place);
    });
    canvas.addEventListener("pointermove", (event) => {
      const before = this.#fingers.get(event.pointerId);
      if (before === undefined) return;
      const now = [event.offsetX, event.offsetY];
      this.#began.moved ||= Math.hypot(now[0] - this.#began.place[0], now[1] - this.#began.place[1]) > TAP;
      if (this.#began.handle !== null) {
        if (this.#began.moved) this.#began.handle.move(...now);
        this.#fingers.set(event.pointerId, now);
        return;
      }
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
      canvas.addEventListener(end, (event) => {
        if (!this.#fingers.delete(event.pointerId) || this.#fingers.size > 0) return;
        const { moved, handle } = this.#began;
        if (handle !== null) handle.drop(moved);
        else if (end === "pointerup" && !moved) tap(event.offsetX, event.offsetY);
      });
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
