from pathlib import Path

import pytest

from services.dashboard.service import DashboardService
from services.dashboard.settings import DashboardSettings
from shared.settings import SettingsError, read_settings
from shared.site import load_site


@pytest.fixture
def site_file(project: Path) -> str:
    return str(project / "deploy/sites/hall/site.yaml")


def test_the_demo_needs_no_secret(site_file: str) -> None:
    settings = read_settings(DashboardSettings, ["--site-file", site_file, "--profile", "demo"])
    DashboardService.check(settings, load_site(site_file))
    assert settings.dashboard_port == 8082
    assert "demo-api-key" not in str(settings.shown())


@pytest.mark.parametrize(
    ("given", "missing"),
    [
        ([], "api_key"),
        (["--dashboard-password", "a password of my own"], "api_key"),
    ],
)
def test_production_refuses_demo_secrets(site_file: str, given: list[str], missing: str) -> None:
    with pytest.raises(SettingsError, match=missing):
        read_settings(DashboardSettings, ["--site-file", site_file, *given])


@pytest.mark.parametrize(("password", "words"), [("password", "at least 12"), ("password-123", "guessed first")])
def test_production_refuses_a_weak_password_and_needs_none(site_file: str, password: str, words: str) -> None:
    given = ["--site-file", site_file, "--api-key", "a key of my own house"]
    with pytest.raises(SettingsError, match=words):
        DashboardService.check(
            read_settings(DashboardSettings, [*given, "--dashboard-password", password]), load_site(site_file)
        )
    DashboardService.check(read_settings(DashboardSettings, given), load_site(site_file))
    with pytest.raises(SettingsError, match="ATRIUM_API_KEY"):
        DashboardService.check(read_settings(DashboardSettings, [*given[:2], "--api-key", ""]), load_site(site_file))


@pytest.mark.parametrize("url", ["localhost:8081", "ftp://host", "http://", "http://me:secret@host"])
def test_an_address_that_is_none_is_refused(site_file: str, url: str) -> None:
    with pytest.raises(SettingsError, match="api_url"):
        read_settings(DashboardSettings, ["--site-file", site_file, "--profile", "demo", "--api-url", url])
