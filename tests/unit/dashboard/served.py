"""The dashboard's web application on a real port, without its page."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from standin_api import KEY
from waiting import wait_until

from services.dashboard.relay import Relay
from services.dashboard.sessions import AttemptLimit, Sessions
from services.dashboard.web_app import build_web_app
from shared.http_server import serve


@contextmanager
def served(port: int, api_url: str, password: str = "", key: str = KEY) -> Iterator[str]:
    """Serve as the service does; yields the address and stops as the service does."""
    relay = Relay(api_url, key, lambda _: None)
    started, stopping = threading.Event(), threading.Event()
    app = build_web_app(relay, Sessions(password, key, 1.0), AttemptLimit(), started=started.set)
    thread = threading.Thread(target=serve, args=(app, "127.0.0.1", port, stopping), daemon=True)
    thread.start()
    wait_until(started.is_set, 10, "the dashboard")
    yield f"http://127.0.0.1:{port}"
    relay.stop()
    stopping.set()
    thread.join(6)
    assert not thread.is_alive(), "the dashboard did not stop"
