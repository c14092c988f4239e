"""Wrong settings of the simulator are refused before anything opens, with name, value and what is allowed."""

from pathlib import Path

import pytest

from services.simulator.service import Simulator
from services.simulator.settings import SimulatorSettings
from shared.settings import SettingsError, read_settings
from shared.site import load_site

SITE = Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml"


def check(*flags: str) -> SimulatorSettings:
    settings = read_settings(SimulatorSettings, ["--site-file", str(SITE), "--profile", "demo", *flags])
    Simulator.check(settings, load_site(SITE))
    return settings


@pytest.mark.parametrize(
    ("flags", "told"),
    [
        (("--phones", "many"), "phones: "),
        (("--phones", "visitor-1,ghost"), "there is nobody called ghost"),
        (("--walkers", "attic"), "walkers: 'attic' is no area or floor of the site file; it has: hall, ground"),
        (("--trajectories", "nowhere.csv"), "nowhere.csv: cannot be read"),
        (("--trajectory-camera", "west", "--trajectories", "nowhere.csv"), "trajectory_camera: 'west'"),
        (("--gateway-url", "ftp://x"), "gateway_url: "),
        (("--people", "-1"), "people: "),
        (("--scan-interval", "0"), "scan_interval: "),
    ],
)
def test_a_wrong_setting_is_refused_by_name(flags: tuple[str, ...], told: str) -> None:
    with pytest.raises(SettingsError) as caught:
        check(*flags)
    assert told in str(caught.value)


def test_the_demo_key_is_refused_outside_the_demo() -> None:
    with pytest.raises(SettingsError, match="enrolment_key"):
        read_settings(SimulatorSettings, ["--site-file", str(SITE)])


def test_phones_are_a_number_or_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert check("--phones", "3").explicit_phones() is None
    assert check("--phones", "visitor-2, visitor-5").explicit_phones() == ["visitor-2", "visitor-5"]
    for text, expected in (("phones: 4", None), ("phones: [visitor-1]", ["visitor-1"])):
        (tmp_path / "simulator.yaml").write_text(text)
        monkeypatch.setenv("ATRIUM_CONFIG", str(tmp_path / "simulator.yaml"))
        assert check().explicit_phones() == expected


def test_zero_phones_and_zero_people_are_a_world_too() -> None:
    check("--phones", "0")
    check("--people", "0")
