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
        (("--scenario", "nowhere.yaml"), "scenario: nowhere.yaml: cannot be read"),
        (("--gateway-url", "ftp://x"), "gateway_url: "),
        (("--seed", "-1"), "seed: "),
        (("--video-port", "70000"), "video_port: "),
    ],
)
def test_a_wrong_setting_is_refused_by_name(flags: tuple[str, ...], told: str) -> None:
    with pytest.raises(SettingsError) as caught:
        check(*flags)
    assert told in str(caught.value)


def test_the_demo_key_is_refused_outside_the_demo() -> None:
    with pytest.raises(SettingsError, match="enrolment_key"):
        read_settings(SimulatorSettings, ["--site-file", str(SITE)])


def test_the_scenario_beside_the_site_is_played_unless_another_is_named() -> None:
    assert check().scenario_file() == SITE.parent / "scenario.yaml"
    other = SITE.parent.parent / "museum" / "scenario.yaml"
    # The site is always the one all services read; a scenario of another site fits only where its names do.
    with pytest.raises(SettingsError, match="camera"):
        check("--scenario", str(SITE.parent.parent / "mall" / "scenario.yaml"))
    assert check("--scenario", str(other)).scenario_file() == other
