// Small things every page needs: elements, the moment a page is built, times in words.

// element("button", {type: "button", class: "row", onclick: act}, "text", otherElement, …)
export function element(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name in made && typeof value !== "string") made[name] = value;
    else made.setAttribute(name, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

// NiceGUI builds the page after the modules have loaded: wait for these elements, by id.
export function appeared(ids) {
  return new Promise((resolve) => {
    const look = () => {
      const found = Object.fromEntries(ids.map((id) => [id, document.getElementById(id)]));
      if (Object.values(found).some((one) => one === null)) return false;
      resolve(found);
      return true;
    };
    if (look()) return;
    const observer = new MutationObserver(() => look() && observer.disconnect());
    observer.observe(document.body, { childList: true, subtree: true });
  });
}

// Make `list` hold these children in this order. What stays is not touched: what is taken out and put back loses the
// keyboard's focus. When the child in focus is gone, the one in its place has the focus.
export function arrange(list, wanted) {
  const staying = new Set(wanted);
  const focused = [...list.children].findIndex((child) => child.contains(document.activeElement));
  const before = list.children[focused];
  const active = document.activeElement;
  for (const child of [...list.children]) if (!staying.has(child)) child.remove();
  let place = list.firstElementChild;
  for (const child of wanted) {
    if (child === place) place = place.nextElementSibling;
    else list.insertBefore(child, place);
  }
  if (focused < 0 || active === document.activeElement) return;
  const heir = staying.has(before) ? active : wanted[Math.min(focused, wanted.length - 1)]?.querySelector("button, a");
  heir?.focus({ preventScroll: true });
}

// A long list of buttons is one stop of the Tab key; within it, arrows, Home and End go from row to row.
export function oneStop(list) {
  const rows = () => [...list.querySelectorAll("button.row")];
  let last = null;
  const stopAt = (chosen) => {
    last = chosen;
    for (const row of rows()) row.tabIndex = row === chosen ? 0 : -1;
  };
  list.addEventListener("focusin", (event) => stopAt(event.target));
  list.addEventListener("keydown", (event) => {
    const all = rows();
    const at = all.indexOf(document.activeElement);
    const to = { ArrowDown: at + 1, ArrowUp: at - 1, Home: 0, End: all.length - 1 }[event.key];
    if (at < 0 || to === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    all[to]?.focus();
  });
  const renewed = () => stopAt(list.contains(last) ? last : rows()[0]);
  new MutationObserver(renewed).observe(list, { childList: true });
  renewed();
}

const clock = new Intl.DateTimeFormat(undefined, {
  hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23",
});
const calendar = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short" });
const longCalendar = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short", year: "numeric" });
const LAST = 8.64e12; // seconds: beyond it a browser knows no dates

// A moment (seconds since the epoch) in the reader's own time zone, which only the browser knows.
export function spoken(t) {
  if (!isDate(t)) return t > 0 ? "never" : "unknown";
  const when = new Date(1000 * t);
  const now = new Date();
  if (now.toDateString() === when.toDateString()) return clock.format(when);
  return `${(now.getFullYear() === when.getFullYear() ? calendar : longCalendar).format(when)}, ${clock.format(when)}`;
}

function isDate(t) {
  return Math.abs(t) <= LAST;
}

export function timeOf(t) {
  if (!isDate(t)) return element("span", {}, spoken(t));
  return element("time", { datetime: new Date(1000 * t).toISOString() }, spoken(t));
}

// 42 s, 3 min, 2 h 5 min
export function duration(seconds) {
  if (seconds < 60) return `${Math.round(seconds)} s`;
  const minutes = Math.round(seconds / 60);
  if (minutes < 60) return `${minutes} min`;
  const rest = minutes % 60;
  return `${Math.floor(minutes / 60)} h${rest ? ` ${rest} min` : ""}`;
}

// Rows of words or elements; the first of each is its heading.
export function table(header, rows) {
  return element("table", {}, element("thead", {}, element("tr", {}, ...header.map((name) => element("th", { scope: "col" }, name)))),
    element("tbody", {}, ...rows.map(([first, ...rest]) => element("tr", {}, element("th", { scope: "row" }, first),
      ...rest.map((value) => element("td", {}, value))))));
}

export function sentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

export function count(number, one, many) {
  return `${number} ${number === 1 ? one : many}`;
}

// A screen on the wall shows the same after every restart. A browser may forbid storing: then it forgets.
export function remember(name, value) {
  try {
    localStorage.setItem(`atrium.${name}`, value);
  } catch {
    // forgotten
  }
}

export function remembered(name) {
  try {
    return localStorage.getItem(`atrium.${name}`);
  } catch {
    return null;
  }
}
