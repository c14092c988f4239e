"""What is promised on paper: the OpenAPI document, its examples, the keys, and the site as a map gets it."""

import json
import math
from pathlib import Path

import msgspec
import numpy as np
import pytest
import shapely
from pydantic import SecretStr

from services.api.admin.administration import Administration
from services.api.alerts.office import AlertOffice
from services.api.app import create_app
from services.api.auth import KeyRing
from services.api.erasures import ErasureBoard
from services.api.event_log import EventLog
from services.api.examples import EXAMPLES
from services.api.health_report import Presence, find_wrong
from services.api.history_link import HistoryLink
from services.api.learning_link import LearningLink
from services.api.live_state import LiveState
from services.api.map_picture import map_svg
from services.api.replies import AreaFreshness, HealthReport
from services.api.service import ApiService
from services.api.settings import ALL_SCOPES, ApiSettings
from services.api.site_view import site_view
from services.api.stream import Hub
from shared.keys import Keys
from shared.learning_report import MapGrid
from shared.settings import SettingsError, read_settings
from shared.site import CameraGeometry, load_site
from shared.site.footprint import footprint

SITE = "deploy/sites/hall/site.yaml"


@pytest.mark.parametrize("kind", EXAMPLES, ids=lambda kind: kind.__name__)
def test_every_example_is_what_it_exemplifies(kind: type[msgspec.Struct]) -> None:
    example = json.dumps(EXAMPLES[kind])
    decoded = msgspec.json.decode(example, type=kind)
    assert set(json.loads(msgspec.json.encode(decoded))) == set(EXAMPLES[kind])


def test_the_openapi_document_names_every_path_and_leads_nowhere_wrong(project: Path, tmp_path: Path) -> None:
    site = load_site(project / SITE)
    settings = ApiSettings(
        site_file=project / SITE, profile="demo", api_database_url=SecretStr(f"sqlite:///{tmp_path}/api.db")
    )
    live, hub = LiveState(site, 60.0, 5.0), Hub(EventLog(1, 10, 10), 10.0, 5.0, 10)
    empty = HealthReport(t=0.0, status="ok", problems=[], services=[], areas=[], cameras=[])
    admin = Administration.open(settings, site, live)
    alerts = AlertOffice(settings, site, lambda _: None, lambda _: None)
    learning, history = LearningLink(Keys("hall"), lambda *_: None), HistoryLink(Keys("hall"), lambda *_: None)
    document = create_app(
        settings, site, live, hub, lambda _: empty, learning, history, ErasureBoard([]), admin, alerts
    ).openapi()
    alerts.close()
    text = json.dumps(document)
    schemas = document["components"]["schemas"]
    for reference in {part.split('"')[0] for part in text.split("#/components/schemas/")[1:]}:
        assert reference in schemas
    assert {"Position", "TrackColumns", "Alert", "CameraReport", "Problem"} <= set(schemas)
    for path, operations in document["paths"].items():
        for operation in operations.values():
            answers = operation["responses"]
            assert {"401", "403", "429"} <= set(answers), path
            assert all(parameter.get("description") for parameter in operation["parameters"]), path
            assert "Retry-After" in answers["429"]["headers"], path
            (good,) = {"200", "201", "202", "204"} & set(answers)
            assert good == "204" or "example" in json.dumps(answers[good]), path
            if "requestBody" in operation:
                assert "example" in json.dumps(operation["requestBody"]), path
    assert document["security"]
    ids = [operation["operationId"] for operations in document["paths"].values() for operation in operations.values()]
    assert len(ids) == len(set(ids)) > 60
    assert {"positions_tracks", "zones_add", "stream_events"} <= set(ids)


def test_keys_are_read_in_every_documented_form(project: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def scopes(text: str, presented: str) -> frozenset[str] | None:
        monkeypatch.setenv("ATRIUM_API_KEYS", text)
        settings = read_settings(ApiSettings, ["--site-file", str(project / SITE)])
        assert presented not in str(settings.shown())
        holder = KeyRing(settings.api_keys).holder_of(presented.encode())
        return None if holder is None else holder.scopes

    everything = {"positions", "alerts", "site", "health", "learning"}
    assert scopes("a-long-secret-key-1", "a-long-secret-key-1") == everything
    assert scopes("a-long-secret-key-1, a-long-secret-key-2", "a-long-secret-key-2") == everything
    assert scopes('["a-long-secret-key-1"]', "a-long-secret-key-1") == everything
    assert scopes('{"guide": "a-long-secret-key-1"}', "a-long-secret-key-1") == everything
    one = '[{"name": "guide", "key": "a-long-secret-key-1", "scopes": ["positions"]}]'
    assert scopes(one, "a-long-secret-key-1") == {"positions"}
    assert scopes(one, "a-long-secret-key-2") is None
    assert scopes(one, "a-long-secret-key-") is None
    assert scopes("demo-api-key", "demo-api-key") == set(ALL_SCOPES)


def test_the_dashboards_key_may_do_what_its_pages_offer_unless_it_is_listed(project: Path) -> None:
    def scopes(**changes: object) -> set[str]:
        settings = ApiSettings(site_file=project / SITE, dashboard_key="the-key-of-a-dashboard", **changes)  # type: ignore[arg-type]
        holder = KeyRing(settings.keys).holder_of(b"the-key-of-a-dashboard")
        return set() if holder is None else set(holder.scopes)

    assert {"positions", "acknowledge", "zones-admin", "learning-admin", "stills", "setup"} <= scopes()
    assert not {"accounts", "audit", "webhooks"} & scopes()
    assert "acknowledge" not in scopes(api_keys="the-key-of-a-dashboard")
    with pytest.raises(ValueError, match="api_proxies"):
        scopes(api_proxies=["anywhere"])


@pytest.mark.parametrize(
    "keys",
    ["demo-api-key", "short-key", "aaaaaaaaaaaaaaaa", "password-password", '["a-long-secret-key-1", "demo-api-key"]'],
)
def test_keys_that_anybody_could_guess_are_refused_outside_the_demo(
    keys: str, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATRIUM_API_KEYS", keys)
    with pytest.raises(SettingsError, match="ATRIUM_API_KEYS"):
        ApiService.check(read_settings(ApiSettings, ["--site-file", str(project / SITE)]), load_site(project / SITE))


@pytest.mark.parametrize("keys", ["[", "", '[{"key": "a-long-secret-key-1", "scopes": ["all"]}]', '{"a": 1}'])
def test_malformed_keys_are_a_message_and_not_a_crash(
    keys: str, project: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATRIUM_API_KEYS", keys)
    with pytest.raises(SettingsError, match="api_keys"):
        read_settings(ApiSettings, ["--site-file", str(project / SITE)])


def test_the_site_view_tells_where_cameras_look_but_not_where_their_pictures_come_from(project: Path) -> None:
    site = load_site(project / SITE)
    view = site_view(site, [])
    text = msgspec.json.encode(view).decode()
    assert "http" not in text
    assert "02:a7" not in text
    polygon = shapely.Polygon(view.cameras[0].footprint)
    assert polygon.is_valid
    assert shapely.Polygon(site.floors[0].outline).buffer(0.01).contains(polygon)
    assert polygon.contains(shapely.Point(10.0, 6.0))


def test_an_access_point_nobody_has_placed_is_told_of_and_drawn_nowhere(project: Path) -> None:
    site = load_site(project / SITE)
    places = [point.model_copy(update={"position": None} if n else {}) for n, point in enumerate(site.access_points)]
    view = site_view(site.model_copy(update={"access_points": places}), [])
    assert [point.position is None for point in view.access_points] == [False] + [True] * (len(places) - 1)
    grid = MapGrid(area="hall", kind="visits", unit="", origin=(1.0, 1.0), cell=1.0, rows=[[1.0]])
    assert map_svg(grid, site.floors[0], places).count("<circle") == 1


@pytest.mark.parametrize("pitch_target", [0.0, 3.0, 5.9, 6.0, 8.0])
@pytest.mark.parametrize("fov", [40, 90, 120])
def test_a_camera_that_sees_the_horizon_has_a_finite_footprint_of_what_it_sees(pitch_target: float, fov: int) -> None:
    camera = CameraGeometry.from_pose((640, 480), (5.0, -2.0, 6.0), (10.0, 8.0, pitch_target), math.radians(fov))
    outline = shapely.box(0.0, 0.0, 20.0, 12.0)
    ring = footprint(camera, None, outline)
    generator = np.random.default_rng(0)
    points = generator.uniform((0.0, 0.0), (20.0, 12.0), (2000, 2))
    pixel = camera.to_image(np.column_stack([points, np.zeros(len(points))]))
    with np.errstate(invalid="ignore"):
        seen = (pixel >= 0.0).all(axis=1) & (pixel <= (639.0, 479.0)).all(axis=1)
    drawn = shapely.contains_xy(shapely.Polygon(ring), *points.T) if ring else np.zeros(len(points), bool)
    assert np.mean(seen != drawn) < 0.03


def test_health_says_in_plain_words_what_is_wrong() -> None:
    presence = Presence()
    presence.seen(["atrium/1/hall/alive/fusion/a", "atrium/1/hall/alive/fusion/b"])
    presence.seen(["atrium/1/hall/alive/fusion/a"])
    wrong = find_wrong(
        connected=True,
        services=presence.services(),
        areas=[AreaFreshness(area="hall", t=80.0, age=20.0, people=3)],
        cameras=[],
        expected=["fusion", "geofence"],
        stale_after=3.0,
    )
    assert [one.words for one in wrong] == [
        "the geofence service is not running: no alerts are raised",
        "fusion b was running and is gone",
        "area hall: no tracks for 20 s, positions are getting old",
    ]


def test_health_says_that_nobody_is_tracked_where_no_camera_hangs() -> None:
    wrong = find_wrong(
        connected=True,
        services=[],
        areas=[AreaFreshness(area="corridors", t=None, age=None, people=0)],
        cameras=[],
        expected=[],
        stale_after=3.0,
        unwatched=["corridors"],
    )
    assert [one.words for one in wrong] == ["area corridors has no camera: nobody is tracked or located there"]
