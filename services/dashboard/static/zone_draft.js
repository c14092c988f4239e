// A zone or exhibit that is being changed: what it is now, what it was before each change, and whether it differs from what is
// saved.

const TYPING_MS = 1500; // changes of one field in quick succession are undone together
const MOST_STEPS = 200;

export class Draft {
  #saved;
  #past = [];
  #future = [];
  #last = { label: null, at: 0 };

  // `zone`: as the API tells it, or a new one; `etag`: of the version it was read in; null: it is new.
  constructor(zone, etag) {
    this.zone = definition(zone);
    this.etag = etag;
    this.#saved = etag === null ? null : JSON.stringify(this.zone);
  }

  get fresh() {
    return this.etag === null;
  }

  get changed() {
    return JSON.stringify(this.zone) !== this.#saved;
  }

  get undoable() {
    return this.#past.length > 0;
  }

  get redoable() {
    return this.#future.length > 0;
  }

  // Change it by `act(zone)`; `label` names what is changed, null where each change is one of its own.
  change(act, label = null) {
    const now = performance.now();
    const goesOn = label !== null && label === this.#last.label && now - this.#last.at < TYPING_MS;
    if (!goesOn) this.mark();
    this.#last = { label, at: now };
    act(this.zone);
  }

  // What is here now is what undo returns to.
  mark() {
    this.#past.push(JSON.stringify(this.zone));
    if (this.#past.length > MOST_STEPS) this.#past.shift();
    this.#future = [];
    this.#last = { label: null, at: 0 };
  }

  undo() {
    this.#go(this.#past, this.#future);
  }

  redo() {
    this.#go(this.#future, this.#past);
  }

  #go(from, to) {
    if (from.length === 0) return;
    to.push(JSON.stringify(this.zone));
    this.zone = JSON.parse(from.pop());
    this.#last = { label: null, at: 0 };
  }
}

// What the API takes, no more: what it tells of a zone holds counts besides.
function definition(zone) {
  if (zone.shape === "point") {
    const { id, name = "", floor, shape, points, reach = 8, facing = null } = zone;
    return structuredClone({ id, name, floor, shape, points, reach, facing });
  }
  return structuredClone({
    id: zone.id,
    name: zone.name ?? "",
    floor: zone.floor,
    shape: zone.shape ?? "area",
    points: zone.points ?? zone.polygon,
    rules: zone.rules ?? (zone.alert_on ?? []).map((kind) => ({ id: kind, kind })),
  });
}

// Where the API keeps it: a zone and an exhibit may have the same id.
export function pathOf({ id, shape }) {
  return `${kindOf(shape)}/${encodeURIComponent(id)}`;
}

export function kindOf(shape) {
  return shape === "point" ? "exhibits" : "zones";
}

// An id made of a name, unlike any of `taken`.
export function idFor(name, taken) {
  const plain = name.normalize("NFD").toLowerCase().replaceAll(/[^a-z0-9]+/g, "-").replaceAll(/^-+|-+$/g, "");
  const stem = plain.slice(0, 50) || "zone";
  let id = stem;
  for (let number = 2; taken.includes(id); number += 1) id = `${stem}-${number}`;
  return id;
}
