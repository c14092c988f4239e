// Times are written in the reader's own time zone, which only the browser knows.

const today = new Intl.DateTimeFormat(undefined, { hour: "2-digit", minute: "2-digit" });
const earlier = new Intl.DateTimeFormat(undefined, { day: "numeric", month: "short", hour: "2-digit", minute: "2-digit" });

function write() {
  for (const element of document.querySelectorAll("time[data-t]:not([datetime])")) {
    const when = new Date(1000 * Number(element.dataset.t));
    const same = when.toDateString() === new Date().toDateString();
    element.setAttribute("datetime", when.toISOString());
    element.textContent = (same ? today : earlier).format(when);
  }
}

new MutationObserver(write).observe(document.body, { childList: true, subtree: true });
write();
