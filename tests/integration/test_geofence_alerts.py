"""The geofence service on a real router: tracks in, alerts out, once each, and kept for those who join later."""

import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import msgspec
import pytest
from waiting import wait_until

from services.geofence.service import GeofenceService
from services.geofence.settings import GeofenceSettings
from services.geofence.zone_plan import MOST_ZONES, ZonePlan
from shared.bus import Bus, Inbox, router
from shared.keys import Keys
from shared.messages import Alert, Erasure, ErasureDone, Message, Occupancy, TrackFrame
from shared.runner import Health
from shared.setup_told import SetupTold
from shared.site import Site, load_site
from shared.site.setup_file import CameraSetup, SetUp
from shared.zones import ZoneDefinition, ZoneRule, ZoneSet

KEYS = Keys("hall")
DEADLINE = 15.0
SITE = "deploy/sites/hall/site.yaml"


def frame(
    t: float, x: float, y: float, track: int = 1, device: str | None = "phone-1", unseen: float | None = None
) -> TrackFrame:
    """One person in the hall; the zone "entrance" spans 7 to 13 by 0 to 2.5 m."""
    return TrackFrame(
        t=t,
        area="hall",
        chunk=int(t * 15),
        tracker="test",
        track=[track],
        floor=["ground"],
        x=[x],
        y=[y],
        covariance=[(0.04, 0.0, 0.04) if unseen is None else (unseen**2, 0.0, unseen**2)],
        vx=[0.0],
        vy=[0.0],
        state=["confirmed" if unseen is None else "unseen"],
        device=[device],
        probability=[0.9],
        runner_up=[None],
        runner_up_probability=[0.0],
        former=[[]],
        sources=[["hall-east"]],
        quality=[1.0],
    )


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / SITE)


@contextmanager
def running(site: Site, project: Path, endpoint: str, **changes: object) -> Iterator[GeofenceService]:
    settings = GeofenceSettings(site_file=project / SITE, profile="demo", bus=[endpoint], **changes)  # type: ignore[arg-type]
    with Bus([endpoint]) as bus:
        service = GeofenceService(settings, site, bus, Health.__new__(Health))
        # A second Health in one process would register its gauge twice.
        service.health.__dict__.update(_problems={}, _lock=threading.Lock(), ready=threading.Event())
        thread = threading.Thread(target=service.run, daemon=True)
        thread.start()
        assert service.health.ready.wait(DEADLINE)
        try:
            yield service
        finally:
            service.stop()
            thread.join(DEADLINE)
            assert not thread.is_alive()


def alerts(inbox: Inbox, known: list[Alert]) -> list[Alert]:
    known += [d.message for d in inbox.receive(timeout=0.05) if isinstance(d.message, Alert)]
    return known


def walk_until(
    bus: Bus,
    t: float,
    x: float,
    y: float,
    inbox: Inbox,
    known: list[Alert],
    count: int,
    device: str | None = "phone-1",
    track: int | None = 1,
) -> float:
    """Stand at (x, y), or as no ``track`` nowhere, from ``t`` on until there are ``count`` alerts.

    Returns the time after.
    """
    tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)

    def step() -> bool:
        nonlocal t
        t += 0.2
        nobody = TrackFrame(t=t, area="hall", chunk=int(t * 15), tracker="test")
        tracks.publish(nobody if track is None else frame(t, x, y, track, device))
        return len(alerts(inbox, known)) >= count

    wait_until(step, DEADLINE, f"{count} alerts")
    return t


def test_enter_and_exit_arrive_once_with_the_device_and_wait_for_late_joiners(
    site: Site, project: Path, zenoh_router: str
) -> None:
    with running(site, project, zenoh_router), Bus([zenoh_router]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        t = walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 1)
        walk_until(bus, t, 10.0, 5.0, inbox, known, 2)
        assert [(a.kind, a.zone, a.track, a.device, a.floor) for a in known] == [
            ("enter", "entrance", 1, "phone-1", "ground"),
            ("exit", "entrance", 1, "phone-1", "ground"),
        ]
        assert len({a.id for a in known}) == 2
        assert known[0].t < known[1].t
        with Bus([zenoh_router]) as later:
            late, seen = later.inbox(), []
            late.subscribe(KEYS.alert(), Alert, cached=True)
            wait_until(lambda: len(alerts(late, seen)) == 2, DEADLINE, "the cached alerts")
            assert [a.id for a in seen] == [a.id for a in known]


def test_frames_that_wait_are_told_of_until_they_no_longer_do(
    site: Site, project: Path, zenoh_router: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("services.geofence.service.LATE", 0.2)
    with running(site, project, zenoh_router) as service, Bus([zenoh_router]) as bus:
        inbox, known, busy = bus.inbox(), [], threading.Event()
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        t = walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 1)
        assert service.health.problems() == {}
        told: list[tuple[str, str]] = []
        monkeypatch.setattr(service.health, "degraded", lambda *problem: told.append(problem))
        monkeypatch.setattr(service.health, "well", lambda topic: told.append((topic, "")))
        counting: list[float] = []

        def count() -> None:
            counting.append(time.monotonic())
            busy.wait(DEADLINE)

        monkeypatch.setattr(service, "_count", count)
        tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)

        def crowd() -> bool:
            nonlocal t
            t += 0.2
            tracks.publish(frame(t, 10.0, 1.2))
            return bool(counting) and time.monotonic() > counting[0] + 0.5

        wait_until(crowd, DEADLINE, "frames that wait")
        told.clear()
        busy.set()
        walk_until(bus, t, 10.0, 5.0, inbox, known, 2)
        pace = [words for topic, words in told if topic == "pace"]
        assert "alerts and counts come late" in pace[0]
        assert pace[-1] == "", "it keeps pace again"


def test_an_alert_names_no_device_that_the_track_has_lost(site: Site, project: Path, zenoh_router: str) -> None:
    with running(site, project, zenoh_router), Bus([zenoh_router]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        t = walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 1)
        t = walk_until(bus, t, 10.0, 5.0, inbox, known, 2, device=None)
        t = walk_until(bus, t, 10.0, 1.2, inbox, known, 3)
        walk_until(bus, t, 10.0, 1.2, inbox, known, 4, track=None)
        assert [(a.kind, a.device) for a in known] == [
            ("enter", "phone-1"),
            ("exit", None),
            ("enter", "phone-1"),
            ("exit", "phone-1"),  # the last it had, since it vanished with it
        ]


def test_silence_lets_nobody_leave_and_what_is_not_seen_is_not_counted(
    site: Site, project: Path, zenoh_router: str
) -> None:
    often = {"geofence_silence": 0.5, "geofence_occupancy_every": 0.1}
    with running(site, project, zenoh_router, **often) as service, Bus([zenoh_router]) as bus:
        inbox, known, counted = bus.inbox(), [], []
        counts: Inbox = bus.inbox()
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        counts.subscribe(KEYS.occupancy(), Occupancy)
        t = walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 1)
        blind = wait_until(
            lambda: next((one for one in of_kind(counts, Occupancy, counted) if one.blind), None),  # type: ignore[attr-defined]
            DEADLINE,
            "a count of what is not seen",
        )
        assert isinstance(blind, Occupancy)
        assert ("entrance" in blind.blind, "entrance" in blind.zone, blind.t > t - 1.0) == (True, False, True)
        assert "nobody knows who is in its zones" in service.health.problems()["tracks of hall"]
        # The same phone under another number goes on where it was, and leaves.
        t = walk_until(bus, t + 60.0, 10.0, 1.2, inbox, known, 1, track=7)
        walk_until(bus, t, 10.0, 5.0, inbox, known, 2, track=7)
        assert [(one.kind, one.device) for one in known] == [("enter", "phone-1"), ("exit", "phone-1")]


def test_a_recording_played_again_starts_afresh(site: Site, project: Path, zenoh_router: str) -> None:
    with running(site, project, zenoh_router), Bus([zenoh_router]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        walk_until(bus, 5000.0, 10.0, 1.2, inbox, known, 1)
        walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 3)
        assert [a.kind for a in known[:3]] == ["enter", "exit", "enter"]
        assert len({a.id for a in known}) == len(known)


def test_alerts_go_on_after_the_router_restarts(site: Site, project: Path, free_port: int) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port}"
    broker = router(endpoint)
    with running(site, project, endpoint), Bus([endpoint]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        t = walk_until(bus, 100.0, 10.0, 1.2, inbox, known, 1)
        broker.close()
        broker = router(endpoint)
        wait_until(lambda: bus.connected, DEADLINE, "the new router")
        began = time.monotonic()
        walk_until(bus, t, 10.0, 5.0, inbox, known, 2)
        assert time.monotonic() - began < DEADLINE
        assert {a.kind for a in known} == {"enter", "exit"}
    broker.close()


def test_whom_no_camera_sees_crosses_a_border_only_when_that_is_sure(
    site: Site, project: Path, zenoh_router: str
) -> None:
    class Ear:
        def __init__(self) -> None:
            self.alerts: list[Alert] = []

        def publish(self, alert: Alert, _origin: float) -> None:
            self.alerts.append(alert)

    with running(site, project, zenoh_router) as service:
        ear = Ear()
        service._publisher = lambda zone: ear  # type: ignore[assignment, method-assign, return-value]
        t = 1000.0
        scenes = [(1.5, 1.2, []), (0.3, 1.2, ["enter"]), (1.5, 4.5, ["enter"]), (0.3, 4.5, ["enter", "exit"])]
        for sigma, y, expected in scenes:
            for _ in range(30):
                t += 1 / 15
                service._take(frame(t, 10.0, y, unseen=sigma), t)
            assert [alert.kind for alert in ear.alerts] == expected, (sigma, y)


def zones(version: int, *found: ZoneDefinition) -> ZoneSet:
    return ZoneSet(t=float(version), version=version, zones=list(found))


def west(*kinds: str, limit: float | None = None) -> ZoneDefinition:
    """The western part of the hall."""
    rules = [ZoneRule(id=f"r-{kind}", kind=kind, limit=limit) for kind in kinds]  # type: ignore[arg-type]
    return ZoneDefinition(id="west", floor="ground", points=[(0, 0), (6, 0), (6, 8), (0, 8)], rules=rules)


def of_kind(inbox: Inbox, kind: type[Message], known: list[Message]) -> list[Message]:
    known += [delivery.message for delivery in inbox.receive(timeout=0.05) if isinstance(delivery.message, kind)]
    return known


def test_zones_that_staff_draw_are_watched_instead_of_the_site_files(
    site: Site, project: Path, zenoh_router: str
) -> None:
    with running(site, project, zenoh_router) as service, Bus([zenoh_router]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        publisher = bus.publisher(KEYS.zones(), ZoneSet, cached=True)
        publisher.publish(zones(7, west("enter", "dwell", limit=1.0)))
        wait_until(lambda: "west" in service._watch.plan.zones, DEADLINE, "the new zones")
        t = walk_until(bus, 100.0, 3.0, 3.0, inbox, known, 2)
        assert [(a.zone, a.kind, a.rule, a.limit) for a in known] == [
            ("west", "enter", "r-enter", 1.0),
            ("west", "dwell", "r-dwell", 1.0),
        ]
        # An older set is no news; a zone that cannot be watched is said, and the others are watched.
        broken = ZoneDefinition(id="broken", floor="ground", points=[(0, 0), (1, 1), (1, 0), (0, 1)])
        publisher.publish(zones(6))
        publisher.publish(zones(8, west("exit"), broken))
        wait_until(lambda: "zone broken" in service.health.problems(), DEADLINE, "the complaint")
        t = walk_until(bus, t, 10.0, 3.0, inbox, known, 3)
        assert [(a.zone, a.kind, a.rule) for a in known[2:]] == [("west", "exit", "r-exit")]
        publisher.publish(zones(9, west("exit")))
        wait_until(lambda: "zone broken" not in service.health.problems(), DEADLINE, "the complaint to go")
        # More than can be watched change nothing.
        publisher.publish(zones(10, *[west("enter")] * (MOST_ZONES + 1)))
        wait_until(lambda: "zones" in service.health.problems(), DEADLINE, "the refusal")
        assert "those of version 9 stay in force" in service.health.problems()["zones"]
        tracks = bus.publisher(KEYS.tracks("hall"), TrackFrame)
        for number in range(10):
            tracks.publish(frame(t + 0.2 * number, 3.0, 3.0))
        walk_until(bus, t + 2.0, 10.0, 3.0, inbox, known, 4)
        assert [(a.zone, a.kind, a.rule) for a in known[3:]] == [("west", "exit", "r-exit")]
        publisher.publish(zones(11, west("exit")))
        wait_until(lambda: "zones" not in service.health.problems(), DEADLINE, "the refusal to go")


def test_people_in_zones_are_told_every_few_seconds(site: Site, project: Path, zenoh_router: str) -> None:
    with running(site, project, zenoh_router, geofence_occupancy_every=0.1), Bus([zenoh_router]) as bus:
        inbox, alerted, told = bus.inbox(), [], []
        counts: Inbox = bus.inbox()
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        counts.subscribe(KEYS.occupancy(), Occupancy)
        walk_until(bus, 100.0, 10.0, 1.2, inbox, alerted, 1)
        newest = wait_until(
            lambda: next((one for one in reversed(of_kind(counts, Occupancy, told)) if sum(one.people)), None),  # type: ignore[attr-defined]
            DEADLINE,
            "a count",
        )
        assert isinstance(newest, Occupancy)
        assert dict(zip(newest.zone, zip(newest.people, newest.phones, strict=True), strict=True)) == {
            "entrance": (1, 1),
            "model-corner": (0, 0),
        }


def test_a_restart_tells_nobody_inside_anew_and_keeps_the_zones(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    with Bus([zenoh_router]) as bus:
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        with running(site, project, zenoh_router, state_folder=tmp_path) as service:
            publisher = bus.publisher(KEYS.zones(), ZoneSet)
            publisher.publish(zones(3, west("enter", "exit")))
            wait_until(lambda: "west" in service._watch.plan.zones, DEADLINE, "the new zones")
            t = walk_until(bus, 100.0, 3.0, 3.0, inbox, known, 1)
        # Nobody tells the zones again: they are as they were.
        with running(site, project, zenoh_router, state_folder=tmp_path) as service:
            assert service._watch.counts() == {"west": (1, 1)}
            walk_until(bus, t, 10.0, 3.0, inbox, known, 2)
        assert [(a.zone, a.kind, a.device) for a in known] == [
            ("west", "enter", "phone-1"),
            ("west", "exit", "phone-1"),
        ]


def test_an_erased_device_leaves_the_rules_and_the_saved_state_and_that_is_told(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    file = tmp_path / "geofence.state"
    hers = ZoneRule(id="hers", kind="enter", devices=["phone-1"])
    theirs = ZoneRule(id="theirs", kind="exit", devices=["phone-1", "phone-2"])
    named = west("enter")
    named = msgspec.structs.replace(named, rules=[*named.rules, hers, theirs])
    with (
        running(site, project, zenoh_router, state_folder=tmp_path, state_every=0.1) as service,
        Bus([zenoh_router]) as bus,
    ):
        inbox, known = bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        told = bus.inbox()
        told.subscribe(KEYS.erased("phone-1", "geofence"), ErasureDone, cached=True)
        zones_told = bus.publisher(KEYS.zones(), ZoneSet)
        zones_told.publish(zones(3, named))
        wait_until(lambda: "west" in service._watch.plan.zones, DEADLINE, "the new zones")
        t = walk_until(bus, 100.0, 3.0, 3.0, inbox, known, 2)
        wait_until(lambda: file.is_file() and b"phone-1" in file.read_bytes(), DEADLINE, "the saved state")
        bus.publisher(KEYS.erasure("phone-1"), Erasure).publish(Erasure(t=t, device="phone-1"))
        wait_until(lambda: bool(told.receive(timeout=0.05)), DEADLINE, "geofence to say that it has erased her")
        assert b"phone-1" not in file.read_bytes()
        assert [rule.id for rule in service._watch.plan.zones["west"].rules] == ["r-enter", "theirs"]
        zones_told.publish(zones(4, named))
        wait_until(lambda: service._version == 4, DEADLINE, "zones that name her still")
        assert [rule.devices for rule in service._watch.plan.zones["west"].rules] == [[], ["phone-2"]]
    assert b"phone-1" not in file.read_bytes()


@pytest.mark.parametrize("content", [b"", b"\xc1 no state", b"\x80"])
def test_a_state_that_cannot_be_read_is_left_aside(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path, content: bytes
) -> None:
    (tmp_path / "geofence.state").write_bytes(content)
    with running(site, project, zenoh_router, state_folder=tmp_path) as service:
        assert set(service._watch.counts()) == {"entrance", "model-corner"}


def test_after_a_restart_into_silence_time_goes_on_from_the_last_frame(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    with Bus([zenoh_router]) as bus:
        inbox, alerted, counts, told = bus.inbox(), [], bus.inbox(), []
        inbox.subscribe(KEYS.alert(), Alert, cached=True)
        with running(site, project, zenoh_router, state_folder=tmp_path):
            t = walk_until(bus, 100.0, 10.0, 1.2, inbox, alerted, 1)
        counts.subscribe(KEYS.occupancy(), Occupancy)
        quick = {"state_folder": tmp_path, "geofence_silence": 0.2, "geofence_occupancy_every": 0.05}
        with running(site, project, zenoh_router, **quick):
            blind = wait_until(
                lambda: [one for one in of_kind(counts, Occupancy, told) if one.blind],  # type: ignore[attr-defined]
                DEADLINE,
                "a count in silence",
            )
        assert blind[0].t < t + DEADLINE  # type: ignore[attr-defined]


def test_what_cameras_watch_is_taken_up_as_it_is_set_up(site: Site, project: Path, zenoh_router: str) -> None:
    with running(site, project, zenoh_router) as service, Bus([zenoh_router]) as bus:
        before = service._sight.areas["hall"].views["hall-east"].area
        near = CameraSetup(area_of_interest=((300.0, 415.0), (600.0, 415.0), (600.0, 580.0), (300.0, 580.0)))
        setup = SetUp(site=site.site, version=1, cameras={"hall-east": near})
        publisher = bus.publisher(KEYS.setup(), SetupTold, cached=True)
        publisher.publish(SetupTold(t=1.0, version=1, setup=setup.model_dump_json()))
        wait_until(lambda: service._sight.areas["hall"].views["hall-east"].area < before / 2, DEADLINE, "the new view")


def test_of_zones_that_changed_many_times_meanwhile_only_the_newest_are_made_ready(
    site: Site, project: Path, zenoh_router: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    made: list[int] = []
    held, plan = threading.Event(), GeofenceService._plan

    def slowly(self: GeofenceService, found: Sequence[ZoneDefinition], version: int) -> ZonePlan:
        made.append(version)
        if version == 1:
            assert held.wait(DEADLINE)
        return plan(self, found, version)

    monkeypatch.setattr(GeofenceService, "_plan", slowly)
    with running(site, project, zenoh_router) as service, Bus([zenoh_router]) as bus:
        publisher = bus.publisher(KEYS.zones(), ZoneSet)
        publisher.publish(zones(1, west("enter")))
        wait_until(lambda: 1 in made, DEADLINE, "the first")
        for version in range(2, 30):
            publisher.publish(zones(version, west("enter", "exit")))
        wait_until(lambda: len(service._inbox._waiting) == 28, DEADLINE, "all of them to wait")
        held.set()
        wait_until(lambda: service._version == 29, DEADLINE, "the newest")
    assert made == [0, 1, 29]
