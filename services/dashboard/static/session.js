// A page of somebody who is no longer signed in goes to the sign-in page by itself.

const EVERY_MS = 5000;

setInterval(async () => {
  const session = await fetch("/session").catch(() => null);
  if (session?.status === 401) window.location.assign("/login");
}, EVERY_MS);
