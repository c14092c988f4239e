"""The API's application without bus or port: for tests of routes."""

import functools
import shutil
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from fastapi.testclient import TestClient
from pydantic import SecretStr

from services.api.admin.administration import Administration
from services.api.admin.database import migrate
from services.api.alerts.database import migrate as migrate_alerts
from services.api.alerts.office import AlertOffice
from services.api.app import create_app
from services.api.erasures import ErasureBoard
from services.api.event_log import EventLog
from services.api.history_link import HistoryLink
from services.api.learning_link import LearningLink
from services.api.live_state import LiveState
from services.api.pseudonyms import Pseudonyms
from services.api.replies import HealthReport
from services.api.settings import ApiSettings
from services.api.stream import Hub
from shared.keys import Keys
from shared.messages import TrackFrame
from shared.site import Site, load_site
from shared.zones import ZoneSet

SITE = Path(__file__).resolve().parent.parent / "deploy/sites/hall/site.yaml"
DEMO = {"Authorization": "Bearer demo-api-key"}
ANCHOR = {"latitude": 48.8606, "longitude": 2.3376}


class Published:
    """Stands for the bus."""

    def __init__(self) -> None:
        self.sets: list[ZoneSet] = []

    def publish(self, message: ZoneSet) -> None:
        self.sets.append(message)


@functools.cache
def _tables() -> Path:
    """A database with empty tables, made once: a migration takes longer than most tests."""
    path = Path(tempfile.mkdtemp(prefix="atrium-api-")) / "api.db"
    migrate(f"sqlite:///{path}")
    migrate_alerts(f"sqlite:///{path}")
    return path


class Api:
    """One application, what it published and asks of the bus (``ask``), and a client with the demo's key."""

    def __init__(self, folder: Path, site: Site, **changes: Any) -> None:
        url = changes.pop("api_database_url", f"sqlite:///{folder}/api.db")
        if url.startswith("sqlite") and not (folder / "api.db").exists():
            shutil.copy(_tables(), folder / "api.db")
        # Of its own: what is set up is saved beside the site file.
        site_file = Path(shutil.copy(SITE, folder))
        settings = ApiSettings(site_file=site_file, profile="demo", api_database_url=SecretStr(url), **changes)
        self.published = Published()
        self.live = LiveState(site, 60.0, 60.0)
        self.pseudonyms = Pseudonyms()
        self.erased: list[str] = []
        self.admin = Administration.open(
            settings,
            site,
            self.live,
            self.published,  # type: ignore[arg-type]
            self.pseudonyms,
            self.erased.append,
        )
        self.ask: Callable[[str, float, bytes | None], bytes | None] = lambda *_: None
        empty = HealthReport(t=0.0, status="ok", problems=[], services=[], areas=[], cameras=[])
        link = LearningLink(Keys("hall"), lambda *_: None)
        hub = Hub(EventLog(1, 1000, 1 << 20), 10.0, 5.0, 10, 2)
        # Not in the same file: tests take that away.
        shutil.copy(_tables(), folder / "alerts.db")
        apart = settings.model_copy(update={"api_database_url": SecretStr(f"sqlite:///{folder}/alerts.db")})
        self.alerts = AlertOffice(apart, site, lambda _: None, lambda _: None)
        past = HistoryLink(Keys("hall"), lambda *query: self.ask(*query))
        self.app = create_app(
            settings,
            site,
            self.live,
            hub,
            lambda _: empty,
            link,
            past,
            ErasureBoard(["hall"]),
            self.admin,
            self.alerts,
            ask=lambda *query: self.ask(*query),
        )
        self.client = TestClient(self.app, headers=DEMO, raise_server_exceptions=False)

    def close_database(self) -> None:
        """Close the file, so that it may be moved away or back."""
        for engine in (self.admin.engine, self.alerts._engine):
            engine.dispose()

    def people(self, *places: tuple[str | None, float, float], **columns: Any) -> None:
        """Let people be seen at (device, x, y) on the hall's ground floor, now."""
        now = time.time()
        assert self.live.take_tracks(people(now, *places, **columns), now)


def people(t: float, *places: tuple[str | None, float, float], **columns: Any) -> TrackFrame:
    """A frame with people at (device, x, y) on the hall's ground floor."""
    n = len(places)
    told: dict[str, Any] = {
        "area": "hall",
        "chunk": 0,
        "tracker": "test",
        "track": list(range(1, n + 1)),
        "floor": ["ground"] * n,
        "x": [x for _, x, _ in places],
        "y": [y for _, _, y in places],
        "covariance": [(0.01, 0.0, 0.01)] * n,
        "vx": [0.0] * n,
        "vy": [0.0] * n,
        "state": ["confirmed"] * n,
        "device": [device for device, _, _ in places],
        "probability": [0.9] * n,
        "runner_up": [None] * n,
        "runner_up_probability": [0.0] * n,
        "former": [[] for _ in range(n)],
        "sources": [["hall-east"] for _ in range(n)],
        "quality": [0.8] * n,
    }
    return TrackFrame(t=t, **(told | columns))


def hall(**changes: Any) -> Site:
    return load_site(SITE).model_copy(update=changes)


@contextmanager
def api(folder: Path, site: Site | None = None, **changes: Any) -> Iterator[Api]:
    """One application until the block ends."""
    made = Api(folder, site or hall(), **changes)
    with made.client:
        yield made
    made.alerts.close()
