// Who is where on the screen at this very moment? Frames come a few times a second; people move smoothly in between.
//
// Frames are placed in time by their arrival, not by the time they carry: clocks may differ and recordings may be
// replayed at any speed. The picture runs a little more than one frame behind, so that there is always a next place.

const TRAIL_MS = 5000;
const FADE_MS = 600;
const STALE_MS = 5000; // an area that sends nothing for this long has nobody we can still vouch for
const AHEAD_MS = 250;

export class Tracks {
  #areas = new Map();
  frames = 0;

  // Take one frame of an area, arrived at `now` (milliseconds of performance.now()).
  accept(frame, now) {
    let area = this.#areas.get(frame.area);
    if (area === undefined) {
      area = { people: new Map(), interval: 100, arrived: now };
      this.#areas.set(frame.area, area);
    }
    const gap = now - area.arrived;
    if (gap > 5 && gap < 1000) area.interval += 0.1 * (gap - area.interval);
    area.arrived = now;
    this.frames += 1;
    const present = new Set();
    for (let i = 0; i < frame.track.length; i += 1) {
      const id = frame.track[i];
      present.add(id);
      let person = area.people.get(id);
      if (person === undefined || person.floor !== frame.floor[i]) {
        person = { key: `${frame.area}/${id}`, track: id, samples: [], born: now, since: Date.now() / 1000 };
        area.people.set(id, person);
      }
      person.floor = frame.floor[i];
      person.named = frame.device_since?.[i] ?? null;
      person.device = frame.device[i];
      person.probability = frame.probability[i];
      person.state = frame.state[i];
      person.accuracy = frame.accuracy?.[i] ?? null;
      person.vx = frame.vx[i];
      person.vy = frame.vy[i];
      person.gone = null;
      person.samples.push([now, frame.x[i], frame.y[i]]);
    }
    for (const [id, person] of area.people) {
      if (!present.has(id)) person.gone ??= now;
    }
  }

  clear() {
    this.#areas.clear();
  }

  // Everybody at `now`: [{key, track, floor, device, probability, state, accuracy, x, y, vx, vy, alpha, trail, since,
  // named}], the last two in seconds since the epoch: when this page first saw the track, and since when it
  // has its name (null where nobody tells).
  at(now) {
    const everybody = [];
    for (const area of this.#areas.values()) {
      const shown = now - Math.min(Math.max(1.3 * area.interval, 60), 400);
      for (const [id, person] of area.people) {
        if (person.gone === null && now - area.arrived > STALE_MS) person.gone = now;
        const alpha = person.gone === null ? 1 : 1 - (now - person.gone) / FADE_MS;
        if (alpha <= 0) {
          area.people.delete(id);
          continue;
        }
        const { samples } = person;
        while (samples.length > 2 && samples[1][0] < now - TRAIL_MS) samples.shift();
        const [x, y, upTo] = placeAt(person, shown);
        everybody.push({
          ...person,
          x,
          y,
          alpha: alpha * Math.min(1, (now - person.born + 150) / 300),
          trail: samples.slice(0, upTo),
        });
      }
    }
    return everybody;
  }
}

// The place of a person at a time, and how many samples lie before it.
function placeAt(person, time) {
  const { samples } = person;
  let after = samples.length;
  while (after > 0 && samples[after - 1][0] > time) after -= 1;
  if (after === 0) return [samples[0][1], samples[0][2], 0];
  const [t0, x0, y0] = samples[after - 1];
  if (after < samples.length) {
    const [t1, x1, y1] = samples[after];
    const share = (time - t0) / Math.max(t1 - t0, 1);
    return [x0 + share * (x1 - x0), y0 + share * (y1 - y0), after];
  }
  if (person.gone !== null) return [x0, y0, after];
  // The next frame is late: walk on a little, then wait.
  const ahead = Math.min(time - t0, AHEAD_MS) / 1000;
  return [x0 + ahead * person.vx, y0 + ahead * person.vy, after];
}
