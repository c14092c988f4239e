"""A lost camera is one thing that is wrong, and what lasts is told once, and once when it is over."""

from pathlib import Path

import msgspec
import pytest
from sqlalchemy import Engine

from services.api.alerts.database import migrate, open_alerts
from services.api.alerts.webhook_replies import WebhookDefinition
from services.api.alerts.webhook_store import WebhookStore
from services.api.health_report import find_wrong
from services.api.replies import AreaFreshness, CameraReport, ServicePresence
from services.api.trouble import Finding, Trouble, TroubleWatch

CAMERA = CameraReport(
    camera="east", area="hall", state="ok", reason="", frames=9, dropped=0, frames_per_s=15.0, t=1.0, age=0.1
)
LOST = msgspec.structs.replace(CAMERA, state="degraded", reason="stopped sending pictures", frames_per_s=0.0)
SILENT = AreaFreshness(area="hall", t=1.0, age=20.0, people=0)
FOLLOWS = [
    Finding("fusion", "hall", "camera east", "fusion: no frames from camera east"),
    Finding("geofence", "0", "tracks of hall", "geofence: no tracks"),
]


def wrong(cameras: list[CameraReport], services: list[ServicePresence] | None = None) -> list[str]:
    found = find_wrong(
        connected=True,
        services=services or [],
        areas=[SILENT],
        cameras=cameras,
        expected=["camera"],
        stale_after=3.0,
        told=FOLLOWS,
    )
    return [one.words for one in found]


def running(service: str, instance: str, alive: bool = True) -> ServicePresence:
    return ServicePresence(service=service, instance=instance, alive=alive)


def test_a_lost_camera_is_told_once() -> None:
    assert wrong([LOST]) == ["camera east: stopped sending pictures"]
    both = [CAMERA, msgspec.structs.replace(CAMERA, camera="west", area="yard")]
    gone = [running("camera", "east", False), running("camera", "west")]
    assert wrong(both, gone) == ["camera east was running and is gone"]
    none = [running("camera", "east", False), running("api", "0")]
    assert wrong([CAMERA], none) == ["the camera service is not running: no pictures are evaluated"]


def test_what_no_camera_explains_is_told() -> None:
    area, fed = "area hall: no tracks for 20 s, positions are getting old", FOLLOWS[0].words
    assert wrong([CAMERA]) == [area, fed]
    other = msgspec.structs.replace(CAMERA, camera="west")
    assert wrong([LOST, other]) == ["camera east: stopped sending pictures", area]


def test_trouble_is_told_once_when_it_lasted_and_once_when_it_is_over() -> None:
    watch, told = TroubleWatch(30.0), []
    for t in range(200):
        # It is away for a moment, as a flicker; its words change; for a while nobody can tell.
        there = t < 100 and t not in (10, 60)
        found = [Finding("camera", "east", "", f"camera east: {t} s")] if there and not 70 <= t < 80 else []
        told += watch.take(float(t), found, connected=not 70 <= t < 80)
    assert [(one.kind, one.t, one.since, one.topic) for one in told] == [
        ("trouble", 30.0, 0.0, "east"),
        ("recovered", 129.0, 0.0, "east"),
    ]
    assert len({one.id for one in told}) == 2


def test_short_trouble_is_told_nobody() -> None:
    watch, found = TroubleWatch(30.0), [Finding("camera", "east", "", "words")]
    assert [watch.take(float(t), found if t % 20 < 10 else [], connected=True) for t in range(100)] == [[]] * 100


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    url = f"sqlite:///{tmp_path / 'alerts.db'}"
    migrate(url)
    return open_alerts(url)


def test_webhooks_that_name_trouble_get_it_whatever_their_zones(engine: Engine) -> None:
    store = WebhookStore(engine, most=9, most_waiting=1, dead_seconds=60.0)
    url = "https://guard.example.org"
    asked = store.create(WebhookDefinition(url=url, kinds=["trouble", "exit"], zones=["room"]), "office", 0.0)
    store.create(WebhookDefinition(url=url), "office", 0.0)
    one = Trouble(id="a", t=2.0, kind="trouble", service="camera", topic="east", words="lost", since=1.0)
    store.enqueue_trouble(one)
    store.enqueue_trouble(msgspec.structs.replace(one, id="b", kind="recovered"))
    store.enqueue_trouble(msgspec.structs.replace(one, id="c"))
    due = store.due(9e9, {}, 4, set())
    assert [(each.webhook, each.alert, each.trouble) for each in due] == [(asked.id, None, one)]
    dead = store.dead(asked.id, 0, 9)
    assert [(each.alert, each.trouble and each.trouble.id) for each in dead] == [(None, "c")]
