"""How many cameras one area may have: which of them saw a person is never told wrongly."""

from pathlib import Path

import pytest
import yaml
from fusion_world import SITE, chunk, frame

from services.fusion.area_view import AreaView
from services.fusion.evidence.tracker import AnonymousTracker
from services.fusion.service import FusionService
from services.fusion.settings import FusionSettings
from shared.settings import SettingsError
from shared.site import Site, load_site


def crowded(folder: Path, cameras: int) -> tuple[Path, Site]:
    site = yaml.safe_load(SITE)
    west = site["cameras"][0]
    site["cameras"] = [{**west, "id": f"cam-{number:02}"} for number in range(cameras)]
    path = folder / "site.yaml"
    path.write_text(yaml.safe_dump(site))
    return path, load_site(path)


def test_more_cameras_than_can_be_told_apart_are_refused(tmp_path: Path) -> None:
    path, site = crowded(tmp_path, 64)
    settings = FusionSettings.model_validate({"site_file": path, "area": "hall", "bus": ["tcp/127.0.0.1:1"]})
    with pytest.raises(SettingsError, match=r"area: 'hall' has 64 cameras in .*; allowed: at most 63"):
        FusionService.check(settings, site)
    with pytest.raises(ValueError, match="64 cameras"):
        AnonymousTracker(AreaView.of(site, "hall"))
    path, site = crowded(tmp_path, 63)
    FusionService.check(settings, site)


def test_each_of_as_many_cameras_as_allowed_is_credited(tmp_path: Path) -> None:
    tracker = AnonymousTracker(AreaView.of(crowded(tmp_path, 63)[1], "hall"))
    for number in range(20):
        t = 100.0 + number / 10
        tracks = tracker.step(chunk(*(frame(t, [(8.0, 7.0)], f"cam-{one}") for one in ("00", "61", "62"))))
    assert tracks.sources == [["cam-00", "cam-61", "cam-62"]]
