"""What is kept for how long is what services tell of themselves, as they are set, and who does not tell is named."""

from pathlib import Path

from services.api.retention import retention_report
from services.camera.settings import CameraSettings
from services.fusion.settings import FusionSettings
from services.gateway.settings import GatewaySettings
from services.geofence.settings import GeofenceSettings
from services.history.settings import HistorySettings
from shared.kept import encode_kept
from shared.keys import Keys
from shared.settings import ServiceSettings

SITE = Path("site.yaml")
KEYS = Keys("hall")


def told(service: str, instance: str, settings: ServiceSettings) -> tuple[str, bytes]:
    return KEYS.kept(service, instance), encode_kept(settings.kept())


def test_the_table_shows_what_is_set_once_per_kind_and_names_who_is_silent() -> None:
    history = HistorySettings(site_file=SITE, history_phone_days=2.0, history_people_days=60.0)
    camera = CameraSettings(site_file=SITE, camera="a", ring_minutes=3.0)
    answers = [
        told("history", "0", history),
        told("camera", "a", camera),
        told("camera", "b", camera),
        told("gateway", "0", GatewaySettings(site_file=SITE, profile="demo", token_days=3.0)),
        (KEYS.kept("learning", "0"), b"not JSON"),
    ]
    report = retention_report(1.0, answers, ["camera", "gateway", "history", "learning"])
    rows = {(row.service, row.what): row for row in report.kept}
    assert len(rows) == len(report.kept), "two cameras that are set alike are told of once"
    assert rows["history", "where phones were"].seconds == 2 * 86400.0
    assert "after 30 days every 10 s" in rows["history", "where people without names were"].note
    assert rows["camera", "pictures, shrunk"].seconds == 180.0
    assert rows["gateway", "that a phone's token is valid"].seconds == 3 * 86400.0
    assert report.silent == ["learning"]


def test_every_setting_that_is_named_is_one() -> None:
    fusion = FusionSettings(site_file=SITE, state_folder=Path("state"))
    geofence = GeofenceSettings(site_file=SITE, state_folder=Path("state"))
    gateway = GatewaySettings(site_file=SITE, profile="demo")
    for settings in (
        HistorySettings(site_file=SITE),
        CameraSettings(site_file=SITE, camera="a"),
        fusion,
        gateway,
        geofence,
    ):
        named = {name for row in settings.kept() for name in row.settings}
        assert named <= set(type(settings).model_fields)
