// Days and clocks of the site's own time zone, wherever the reader sits.

// Seconds since the epoch of a wall clock, "2026-05-17T09:30", in a time zone.
export function atSite(wall, timeZone) {
  const [date, clock = "00:00"] = wall.split("T");
  const [year, month, day] = date.split("-").map(Number);
  const [hour, minute] = clock.split(":").map(Number);
  const asUtc = Date.UTC(year, month - 1, day, hour, minute) / 1000;
  const first = asUtc - offset(asUtc, timeZone);
  // Where the clocks change between the two, the second look is right.
  return asUtc - offset(first, timeZone);
}

// The wall clock at a moment, "2026-05-17T09:30".
export function wallClock(t, timeZone) {
  const parts = partsOf(t, timeZone);
  return `${parts.year}-${parts.month}-${parts.day}T${parts.hour}:${parts.minute}`;
}

// The day that holds a moment, and the one `days` before, both as "2026-05-17".
export function dayBefore(t, days, timeZone) {
  const [date] = wallClock(t, timeZone).split("T");
  const [year, month, day] = date.split("-").map(Number);
  return new Date(Date.UTC(year, month - 1, day - days)).toISOString().slice(0, 10);
}

export function words(t, timeZone, withDay = true) {
  const day = withDay ? { day: "numeric", month: "short" } : {};
  return new Intl.DateTimeFormat(undefined, { ...day, hour: "2-digit", minute: "2-digit", hourCycle: "h23", timeZone }).format(new Date(1000 * t));
}

export function dayWords(t, timeZone) {
  return new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short", timeZone }).format(new Date(1000 * t));
}

function offset(t, timeZone) {
  const parts = partsOf(t, timeZone);
  const wall = Date.UTC(Number(parts.year), Number(parts.month) - 1, Number(parts.day), Number(parts.hour), Number(parts.minute), Number(parts.second));
  return Math.round(wall / 1000 - t);
}

function partsOf(t, timeZone) {
  const format = new Intl.DateTimeFormat("en-GB", {
    timeZone, year: "numeric", month: "2-digit", day: "2-digit", hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23",
  });
  return Object.fromEntries(format.formatToParts(new Date(1000 * t)).map(({ type, value }) => [type, value]));
}
