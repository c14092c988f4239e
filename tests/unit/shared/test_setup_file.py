"""What is set up beside the site file: laid over it, replaced as a whole, never half, never one that would not load."""

import threading
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

from shared.site import SiteError, load_site
from shared.site.setup_change import SetupRefusedError, SetupUnwritableError, change_setup
from shared.site.setup_file import KEPT, CameraSetup, PointPlace, SetUp, setup_path
from shared.site.site_file import PointsGeometry

PAIRS = {
    "kind": "points",
    "image_size": [1920, 1080],
    "image": [[1036, 868], [1330, 546], [1009, 401], [542, 571]],
    "plan": [[5, 3], [11, 3.5], [15, 10], [6, 9]],
}
AREA = [(0.0, 1000.0), (0.0, 400.0), (1900.0, 400.0)]


@pytest.fixture
def site_file(tmp_path: Path) -> Path:
    path = tmp_path / "site.yaml"
    pose = {
        "kind": "pose",
        "image_size": [1280, 720],
        "position": [1, 1, 3],
        "look_at": [8, 6, 0],
        "horizontal_fov": 80,
    }
    camera = {"area": "hall", "source": {"device": 0}, "geometry": pose}
    site = {
        "format": "atrium-site/1",
        "site": "shop",
        "floors": [{"id": "ground", "outline": [[0, 0], [24, 0], [24, 14], [0, 14]]}],
        "areas": [{"id": "hall", "floor": "ground"}],
        "cameras": [{"id": "door", **camera}, {"id": "till", **camera, "area_of_interest": [[0, 700], [0, 9], [9, 9]]}],
        "access_points": [{"id": "ap-1", "floor": "ground"}, {"id": "ap-2", "floor": "ground", "position": [1, 2, 3]}],
    }
    path.write_text("# mine\n" + yaml.safe_dump(site))
    return path


def calibrated(camera: str = "door", **more: object) -> Callable[[SetUp], SetUp]:
    entry = CameraSetup.model_validate({"geometry": PAIRS, "saved": 1.0, "by": "me", **more})
    return lambda setup: setup.model_copy(update={"cameras": {**setup.cameras, camera: entry}})


def placed(x: float) -> Callable[[SetUp], SetUp]:
    return lambda setup: setup.model_copy(update={"access_points": {"ap-1": PointPlace(position=(x, 2.0, 2.5))}})


def test_what_is_set_up_goes_over_the_site_file_and_that_stays_as_it_was(site_file: Path) -> None:
    mine = site_file.read_text()
    change_setup(site_file, calibrated(area_of_interest=AREA))
    change_setup(site_file, placed(4.0))
    change_setup(site_file, calibrated("till", geometry=None, whole_picture=True))
    site = load_site(site_file)
    assert isinstance(site.camera("door").geometry, PointsGeometry)
    assert site.camera("door").area_of_interest == AREA
    assert site.camera("till").geometry.kind == "pose"
    assert site.camera("till").area_of_interest is None
    assert [point.position for point in site.access_points] == [(4.0, 2.0, 2.5), (1, 2, 3)]
    assert site_file.read_text() == mine
    setup_path(site_file).unlink()
    assert load_site(site_file).camera("door").geometry.kind == "pose"


def test_earlier_versions_are_kept_but_not_all_of_them(site_file: Path) -> None:
    for x in range(KEPT + 4):
        assert change_setup(site_file, placed(float(x))).version == x + 1
    kept = sorted(int(path.name.split(".")[2]) for path in site_file.parent.glob("site.setup.*.yaml"))
    assert kept == list(range(4, KEPT + 4))
    before = yaml.safe_load((site_file.parent / "site.setup.20.yaml").read_text())
    assert before["access_points"]["ap-1"]["position"] == [19.0, 2.0, 2.5]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (calibrated("garden"), r"cameras.garden: the site file has none of this name; allowed: door, till"),
        (calibrated(area_of_interest=[(0, 0), (5000, 0), (0, 900)]), "lies outside the 1920 x 1080 picture"),
        (calibrated(geometry={**PAIRS, "plan": [[0, 0], [1, 1], [2, 2], [3, 3]]}), "on one line"),
        (lambda setup: setup.model_copy(update={"site": "elsewhere"}), "another site"),
    ],
)
def test_what_would_not_load_is_not_stored(site_file: Path, change: Callable[[SetUp], SetUp], words: str) -> None:
    change_setup(site_file, placed(4.0))
    before = setup_path(site_file).read_text()
    with pytest.raises(SetupRefusedError, match=words):
        change_setup(site_file, change)
    assert setup_path(site_file).read_text() == before


def test_a_set_up_for_what_is_no_longer_there_is_named_with_its_file(site_file: Path) -> None:
    change_setup(site_file, calibrated("till"))
    site = yaml.safe_load(site_file.read_text())
    site["cameras"].pop()
    site_file.write_text(yaml.safe_dump(site))
    with pytest.raises(SiteError, match=r"site\.setup\.yaml: cameras\.till: the site file has none of this name"):
        load_site(site_file)
    setup_path(site_file).write_text("format: atrium-setup/1\nsite: shop\ncameras: {door: {geometri: 3}}\n")
    with pytest.raises(SiteError, match=r"site\.setup\.yaml: .*geometri: unknown key"):
        load_site(site_file)


def test_a_folder_that_cannot_be_written_is_named_and_nothing_changes(
    site_file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    change_setup(site_file, placed(4.0))

    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("shared.site.setup_file.os.fsync", full)
    with pytest.raises(SetupUnwritableError, match=r"site\.setup\.yaml cannot be written: No space left on device"):
        change_setup(site_file, placed(9.0))
    assert load_site(site_file).access_points[0].position == (4.0, 2.0, 2.5)


def test_two_who_save_at_once_lose_nothing(site_file: Path) -> None:
    def work(camera: str) -> None:
        for _ in range(5):
            change_setup(site_file, calibrated(camera))

    threads = [threading.Thread(target=work, args=(camera,)) for camera in ("door", "till")]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(30)
    setup = change_setup(site_file, lambda setup: setup)
    assert setup.version == 11
    assert set(setup.cameras) == {"door", "till"}
