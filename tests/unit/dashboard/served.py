"""The dashboard's web application on a real port, without its page."""

import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager

from standin_api import KEY
from waiting import wait_until

from services.dashboard.guesses import KnownBrowsers
from services.dashboard.pass_through import pass_through
from services.dashboard.relay import Relay
from services.dashboard.sessions import Sessions
from services.dashboard.staff_desk import StaffDesk
from services.dashboard.web_app import build_web_app
from shared.http_server import serve


@contextmanager
def served(
    port: int,
    api_url: str,
    password: str = "",
    key: str = KEY,
    proxies: Sequence[str] = (),
    sessions: Sessions | None = None,
) -> Iterator[str]:
    """Serve as the service does; yields the address and stops as the service does."""
    sessions = sessions or Sessions(password, key, 1.0)
    relay = Relay(api_url, key, lambda _: None)
    started, stopping = threading.Event(), threading.Event()
    browsers, desk = KnownBrowsers(password, key), StaffDesk(api_url, key)
    app = build_web_app(relay, sessions, browsers, desk, started=started.set)
    app.include_router(pass_through(api_url, key))
    settings = {"proxies": proxies}
    thread = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), kwargs=settings, daemon=True)
    thread.start()
    wait_until(started.is_set, 10, "the dashboard")
    yield f"http://127.0.0.1:{port}"
    relay.stop()
    stopping.set()
    thread.join(6)
    assert not thread.is_alive(), "the dashboard did not stop"
