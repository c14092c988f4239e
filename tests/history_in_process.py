"""One history service in this process, on a real bus; what others tell it, and what it is asked."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import msgspec
from history_world import NOON, frame, walker
from waiting import wait_until

from services.history.service import HistoryService
from services.history.settings import HistorySettings
from shared.bus import Bus
from shared.history_query import HistoryAnswer, decode_answer
from shared.keys import Keys
from shared.messages import Alert, Occupancy, Revision, TrackFrame
from shared.runner import Health
from shared.site import Site
from shared.zones import ZoneDefinition, ZoneSet

KEYS = Keys("hall")
DEADLINE = 15.0
SITE = "deploy/sites/hall/site.yaml"


@contextmanager
def running(site: Site, project: Path, endpoint: str, folder: Path, url: str = "") -> Iterator[HistoryService]:
    """One history service, in this process, until the block ends."""
    settings = HistorySettings(
        site_file=project / SITE,
        bus=[endpoint],
        history_database_url=url or f"sqlite:///{folder / 'history.db'}",  # type: ignore[arg-type]
        history_spool=folder / "spool",
        history_write_every=0.1,
        # What these tests tell of was long ago.
        history_phone_days=3660.0,
        history_people_days=3660.0,
        history_detail_days=3660.0,
        history_alert_days=3660.0,
        history_count_days=3660.0,
    )
    with Bus([endpoint]) as bus:
        health = Health.__new__(Health)
        # A second Health in one process would register its gauge twice.
        health.__dict__.update(_problems={}, _lock=threading.Lock(), ready=threading.Event())
        service = HistoryService(settings, site, bus, health)
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        assert health.ready.wait(DEADLINE)
        try:
            yield service
        finally:
            service.stop()
            thread.join(DEADLINE)
            assert not thread.is_alive()


class Teller:
    """What other services publish."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)
        self._revisions = bus.publisher(KEYS.revisions("hall"), Revision)
        self._alerts = bus.publisher(KEYS.alert("entrance"), Alert, cached=True)
        self._occupancy = bus.publisher(KEYS.occupancy(), Occupancy)
        self._zones = bus.publisher(KEYS.zones(), ZoneSet, cached=True)
        self.until_heard()

    def until_heard(self) -> None:
        told = (self._tracks, self._revisions, self._occupancy)
        wait_until(lambda: all(publisher.matched for publisher in told), DEADLINE, "history to listen")

    def until_alone(self) -> None:
        wait_until(lambda: not self._tracks.matched, DEADLINE, "history to be gone")

    def walk(self, since: int, until: int, people: int = 1) -> None:
        """Seconds from noon of a walk, all of ``people`` one behind the other, the first with a phone."""
        for second in range(since, until):
            rows = [
                (number + 1, *walker(NOON + second - number), "d-1" if number == 0 else None)
                for number in range(people)
            ]
            self._tracks.publish(frame(NOON + second, rows))

    def revise(self, since: float, until: float) -> None:
        self._revisions.publish(
            Revision(
                t=NOON + until, area="hall", chunk=1, tracker="test", device=["d-1"], since=[NOON + since],
                of=[0], at=[NOON + since], track=[0], x=[1.0], y=[1.0], covariance=[(0.1, 0.0, 0.1)], probability=[0.6],
            )
        )  # fmt: skip

    def alert(self, number: int, device: str | None = None) -> None:
        self._alerts.publish(
            Alert(
                t=NOON, id=f"a-{number}", zone="entrance", kind="enter", area="hall", track=1, floor="ground",
                x=1.0, y=1.0, device=device,
            )
        )  # fmt: skip

    def count(self, t: float, people: int) -> None:
        self._occupancy.publish(Occupancy(t=NOON + t, zone=["entrance"], people=[people], phones=[1]))

    def zones(self, version: int, zones: list[ZoneDefinition]) -> None:
        self._zones.publish(ZoneSet(t=NOON, version=version, zones=zones))


def ask(bus: Bus, question: msgspec.Struct) -> HistoryAnswer:
    """The answer, once it is known on the bus who answers."""
    payload = msgspec.json.encode(question)
    (told,) = wait_until(lambda: [a for _, a in bus.ask(KEYS.history(), DEADLINE, payload)], DEADLINE, "an answer")
    return decode_answer(told)
