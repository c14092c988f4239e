"""The site file: every mistake is one message that names file, place, value and what is allowed."""
# ruff: noqa: E501 (the table of mistakes reads better with one mistake a line)

import copy
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from shared.redaction import redact_url
from shared.site import Site, SiteError, load_site
from shared.site.site_file import expand_environment

SITES = Path(__file__).resolve().parents[3] / "deploy" / "sites"
HALL: dict[str, Any] = yaml.safe_load((SITES / "hall" / "site.yaml").read_text(encoding="utf-8"))
Document = dict[str, Any]


@pytest.fixture
def hall() -> Document:
    return copy.deepcopy(HALL)


@pytest.fixture
def load(tmp_path: Path) -> Callable[[Document], Site]:
    def write_and_load(document: Document) -> Site:
        file = tmp_path / "site.yaml"
        file.write_text(yaml.safe_dump(document), encoding="utf-8")
        return load_site(file)

    return write_and_load


def put(document: Document, place: str, value: object) -> None:
    """Set the value at a place written as the messages write it: ``cameras[0].geometry.kind``."""
    steps = [int(s) if s.isdigit() else s for s in re.findall(r"\w+", place)]
    at: Any = document
    for step in steps[:-1]:
        at = at[step]
    at[steps[-1]] = value


def test_the_demo_hall_loads() -> None:
    site = load_site(SITES / "hall" / "site.yaml")
    assert site.site == "hall"
    assert [camera.id for camera in site.cameras_of("hall")] == ["hall-east"]
    assert site.camera("hall-east").geometry.build().position[2] > 2.0
    assert not site.floor("ground").plan().obstacles.is_empty
    assert site.area("hall").floor == "ground"
    with pytest.raises(KeyError, match=r"cellar.*it has: ground"):
        site.floor("cellar")


def test_an_access_point_may_hang_nobody_knows_where(hall: Document, load: Callable[[Document], Site]) -> None:
    del hall["access_points"][1]["position"]
    assert [point.position is None for point in load(hall).access_points[:3]] == [False, True, False]


def test_the_site_of_the_real_clip_loads(data_folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("ATRIUM_DATA", str(data_folder.resolve()))
    site = load_site(SITES / "pets09" / "site.yaml")
    source = site.camera("view1").source.file
    assert source is not None
    assert source.is_file()


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        ("colour", "red", r"colour: unknown key; allowed here: format, site, name, north, time_zone, anchor"),
        ("floors[0].height", 3, r"floors\[0\]\.height: unknown key; allowed here: id, name, level, outline"),
        ("floors[0].obstacles[0].size", 3, r"floors\[0\]\.obstacles\[0\]\.size: unknown key; allowed here: id, polygon"),
        ("cameras[0].geometry.points", [], r"cameras\[0\]\.geometry\.points: unknown key; allowed here: kind, image_size"),
        ("cameras[0].source.loops", True, r"source\.loops: unknown key; allowed here: file, folder, url, device"),
        ("format", "atrium-site/2", r"format: .*'atrium-site/1' \(found 'atrium-site/2'\)"),
        ("site", "my hall", r"site: must be 1 to 64 of the letters.* \(found 'my hall'\)"),
        ("site", 7, r"site: must be text; write it in quotes \(found 7\)"),
        ("north", 400, r"north: .*less than or equal to 360 \(found 400\)"),
        ("floors", [], r"floors: must hold at least 1 \(found none\)$"),
        ("floors", None, r"floors: must be a list \(found null\)$"),
        ("floors[0].outline[1]", "far", r"floors\[0\]\.outline\[1\]: must be a list of numbers \(found 'far'\)$"),
        ("floors[0].outline[1][0]", {"x": 1}, r"outline\[1\]\[0\]: must be a number \(found a mapping\)$"),
        ("north", "up", r"north: must be a number \(found 'up'\)$"),
        ("cameras[0].latency", None, r"cameras\[0\]\.latency: must be a number \(found null\)$"),
        ("cameras[0].latency", [None, True], r"cameras\[0\]\.latency: must be a number \(found \[null, true\]\)$"),
        ("cameras[0].geometry.image_size[0]", 640.5, r"geometry\.image_size\[0\]: must be a whole number \(found 640.5\)$"),
        ("cameras[0].geometry.image_size[0]", "wide", r"geometry\.image_size\[0\]: must be a whole number \(found 'wide'\)$"),
        ("floors[0].outline", [[0, 0], [9, 9], [9, 0], [0, 9]], r"floors\[0\]\.outline: .*must not cross .*\(found \[\["),
        ("floors[0].outline", [[0, 0], [1, 1], [3, 3]], r"floors\[0\]\.outline: .*lie on one line"),
        ("floors[0].outline", [[0, 0], [0, 0], [0, 0]], r"floors\[0\]\.outline: .*lie on one line"),
        ("floors[0].outline", [[0, 0], [1, 1]], r"floors\[0\]\.outline: .*at least 3 corners, this one has 2"),
        ("floors[0].outline[1]", [1, 2, 3], r"floors\[0\]\.outline\[1\]: .*at most 2"),
        ("floors[0].outline[1][0]", float("nan"), r"floors\[0\]\.outline\[1\]\[0\]: must be a finite number \(found nan\)"),
        ("floors[0].outline[1][0]", float("inf"), r"outline\[1\]\[0\]: must be a finite number"),
        ("floors[0].walls[0]", [[0, 0]], r"floors\[0\]\.walls\[0\]: .*at least 2"),
        ("floors[0].obstacles[1].id", "vase", r"floors\[0\]\.obstacles: id 'vase' is used 2 times"),
        ("areas[0].floor", "attic", r"areas\[0\]\.floor: 'attic' is no floor; allowed: ground"),
        ("zones[0].floor", "attic", r"zones\[0\]\.floor: 'attic' is no floor; allowed: ground"),
        ("zones[1].id", "entrance", r"zones: id 'entrance' is used 2 times, ids must differ"),
        ("zones[0].polygon", [[0, 0], [9, 9], [9, 0], [0, 9]], r"zones\[0\]\.polygon: .*must not cross"),
        ("zones[0].alert_on", ["stay"], r"zones\[0\]\.alert_on\[0\]: .*'enter' or 'exit' \(found 'stay'\)"),
        ("exhibits[1].id", "vase", r"exhibits: id 'vase' is used 2 times, ids must differ"),
        ("exhibits[0].floor", "attic", r"exhibits\[0\]\.floor: 'attic' is no floor; allowed: ground"),
        ("exhibits[0].position", [50, 4], r"exhibits\[0\]\.position: \(50, 4\) lies nowhere on floor 'ground'"),
        ("exhibits[0].reach", 0, r"exhibits\[0\]\.reach: .*greater than 0 \(found 0\)"),
        ("access_points[1].id", "ap-1", r"access_points: id 'ap-1' is used 2 times"),
        ("access_points[1].addresses", ["02:A7:00:00:00:01"], r"address '02:a7:00:00:00:01' stands at 2 places: ap-1, ap-2; one"),
        ("access_points[2].receivers", ["desk", " DESK"], r"receiver 'desk' stands at 2 places: ap-3, ap-3; one receiver"),
        ("access_points[0].addresses", [42], r"access_points\[0\]\.addresses\[0\]: must be text; write it in quotes"),
        ("access_points[0].power_1m", 20, r"access_points\[0\]\.power_1m: .*less than or equal to 0 \(found 20\)"),
        ("access_points[0].position", [1, 2], r"access_points\[0\]\.position\[2\]: is missing$"),
        ("cameras[0].area", "cellar", r"cameras\[0\]\.area: 'cellar' is no area; allowed: hall"),
        ("cameras[0].id", "a/b", r"cameras\[0\]\.id: .*\(found 'a/b'\)"),
        ("cameras[0].latency", -1, r"cameras\[0\]\.latency: .*greater than or equal to 0 \(found -1\)"),
        ("cameras[0].geometry.kind", "guess", r"cameras\[0\]\.geometry\.kind: must be one of tsai, points, pose \(found 'guess'\)"),
        ("cameras[0].geometry", {"image_size": [9, 9]}, r"cameras\[0\]\.geometry\.kind: must be one of tsai, points, pose"),
        ("cameras[0].geometry.image_size", [-960, 720], r"geometry\.image_size\[0\]: .*equal to 16 \(found -960\)"),
        ("cameras[0].geometry.horizontal_fov", 180, r"geometry\.horizontal_fov: .*less than 170 \(found 180\)"),
        ("cameras[0].geometry.look_at", HALL["cameras"][0]["geometry"]["position"], r"cameras\[0\]\.geometry: look_at is the camera's own position"),
        ("cameras[0].geometry.look_at", [10, 5, 90], r"cameras\[0\]\.geometry: no pixel of this camera sees the floor"),
        ("cameras[0].geometry.position", [10, -3, -8], r"cameras\[0\]\.geometry: the camera hangs -8.00 m above its floor"),
        ("cameras[0].area_of_interest", [[0, 0], [2000, 0], [0, 9]], r"area_of_interest: \(2000, 0\) lies outside the 960 x 720"),
        ("cameras[0].source", {}, r"cameras\[0\]\.source: exactly one of file, folder, url, device is needed, found none"),
        ("cameras[0].source", {"device": 0, "file": "a"}, r"cameras\[0\]\.source: exactly one .* found file and device"),
        ("cameras[0].source", {"folder": "a"}, r"cameras\[0\]\.source: a folder of pictures needs frames_per_s"),
        ("cameras[0].source", {"device": -1}, r"cameras\[0\]\.source\.device: .*greater than or equal to 0"),
        ("cameras[0].source", {"url": "ftp://cam/1"}, r"cameras\[0\]\.source: 'ftp://cam/1': a URL must start with rtsp"),
        ("cameras[0].source", {"url": "rtsp://${NO_SUCH_NAME}@cam"}, r"source\.url: environment variable NO_SUCH_NAME is not set"),
        ("cameras[0].source", {"file": "${NO_SUCH_NAME}/a"}, r"source\.file: environment variable NO_SUCH_NAME is not set"),
        ("cameras[0].source", {"file": "~nobody-here/a"}, r"cameras\[0\]\.source\.file: .*home directory"),
        ("cameras[0].source", "cam.avi", r"cameras\[0\]\.source: must be a mapping of keys to values \(found 'cam.avi'\)"),
        ("cameras", {"id": "c"}, r"cameras: .*list"),
        ("cameras[0].geometry", {"kind": "tsai", "file": "gone.xml"}, r"cameras\[0\]\.geometry: .*gone\.xml: No such file"),
    ],
)  # fmt: skip
def test_one_mistake_is_one_message(
    hall: Document, load: Callable[[Document], Site], tmp_path: Path, place: str, value: object, told: str
) -> None:
    put(hall, place, value)
    with pytest.raises(SiteError) as refusal:
        load(hall)
    lines = str(refusal.value).splitlines()
    assert not re.search(r"should|valid|Input|None|True|found .*found ", str(refusal.value)), lines
    assert re.match(re.escape(f"{tmp_path / 'site.yaml'}: ") + f".*{told}", lines[0]), lines
    assert len(lines) == 1, lines


def points(**changes: object) -> Document:
    image = [[100, 700], [860, 700], [650, 250], [310, 250]]
    plan = [[0, 0], [6, 0], [6, 9], [0, 9]]
    return {"kind": "points", "image_size": [960, 720], "image": image, "plan": plan, **changes}


@pytest.mark.parametrize(
    ("geometry", "told"),
    [
        (points(plan=[[0, 0], [1, 1], [2, 2], [3, 3]]), r"geometry: the plan points lie on one line"),
        (points(plan=[[1, 1]] * 4), r"geometry: the plan points lie on one line"),
        (points(plan=[[0, 0], [6, 0], [6, 9]]), r"geometry\.plan: .*at least 4"),
        (points(plan=[[0, 0], [6, 0], [6, 9], [0, 9], [3, 3]]), r"geometry: 4 image points but 5 plan points"),
        (points(plan=[[0, 0], [6, 9], [6, 0], [0, 9]]), r"geometry: no camera above the floor sees these points"),
    ],
)
def test_point_pairs_that_cannot_be_are_told(
    hall: Document, load: Callable[[Document], Site], geometry: Document, told: str
) -> None:
    put(hall, "cameras[0].geometry", geometry)
    with pytest.raises(SiteError, match=rf"cameras\[0\]\.{told}"):
        load(hall)


def test_four_point_pairs_calibrate_a_camera(hall: Document, load: Callable[[Document], Site]) -> None:
    put(hall, "cameras[0].geometry", points())
    assert load(hall).cameras[0].geometry.build().position[2] > 1.0


def test_all_mistakes_are_named_at_once(hall: Document, load: Callable[[Document], Site]) -> None:
    put(hall, "north", "up")
    put(hall, "cameras[0].latency", -1)
    with pytest.raises(SiteError, match=r"(?s)north.*\n.*cameras\[0\]\.latency"):
        load(hall)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"floors:\n\t- id: ground\n", r", line 2, column 1: not YAML: .*'\\t'.*; indent with spaces"),
        (b"floors: [1, 2", r", line 1, column \d+: not YAML: expected ',' or '\]'"),
        (b"site: a\nsite: b\n", r", line 2, column 1: not YAML: key 'site' stands here a second time"),
        (b"site: 2026-13-45\n", r": not YAML: month must be in"),
        (b"\xff\xfe\x00", r": not YAML: "),
        (b"a: \x00", r": not YAML: "),
        (b"a: !!python/object/apply:os.getcwd []", r", line 1, column 4: not YAML: could not determine a constructor"),
        (b"", r": must hold a mapping with 'format', 'site', 'floors' …, found nothing"),
        (b"- a\n- b\n", r": must hold a mapping .*found list"),
        (b"just words", r": must hold a mapping .*found str"),
        (b"1: 2\n", r": "),
        (b"format: atrium-site/1\nsite: &a [*a]\n", r": site: must be text; write it in quotes \(found \[\[\[\[\[\["),
        (
            b"format: atrium-site/1\nsite: 2026-01-13\n",
            r": site: must be text; write it in quotes \(found 2026-01-13\)",
        ),
        (b"[" * 5000, r": not YAML: "),
    ],
)
def test_what_is_no_site_file_is_one_line(tmp_path: Path, text: bytes, told: str) -> None:
    file = tmp_path / "site.yaml"
    file.write_bytes(text)
    with pytest.raises(SiteError) as refusal:
        load_site(file)
    assert re.match(re.escape(str(file)) + told, str(refusal.value)), str(refusal.value)


def test_a_file_that_is_not_there_or_a_folder_is_told(tmp_path: Path) -> None:
    with pytest.raises(SiteError, match=r"gone\.yaml: cannot be read: No such file"):
        load_site(tmp_path / "gone.yaml")
    with pytest.raises(SiteError, match="cannot be read: Is a directory"):
        load_site(tmp_path)


def test_paths_are_meant_from_the_site_files_own_folder(
    hall: Document, load: Callable[[Document], Site], tmp_path: Path
) -> None:
    put(hall, "cameras[0].source", {"file": "clips/one.avi"})
    assert load(hall).cameras[0].source.file == tmp_path / "clips" / "one.avi"


def test_environment_variables_fill_in_and_defaults_stand_in(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CAMERA_PASSWORD", "s3cret")
    monkeypatch.delenv("CAMERA_HOST", raising=False)
    assert expand_environment("rtsp://a:${CAMERA_PASSWORD}@${CAMERA_HOST:-cam}/1") == "rtsp://a:s3cret@cam/1"
    assert expand_environment("plain $HOME text") == "plain $HOME text"
    monkeypatch.setenv("CAMERA_PASSWORD", "")
    with pytest.raises(ValueError, match="CAMERA_PASSWORD is empty"):
        expand_environment("${CAMERA_PASSWORD}")


@pytest.mark.parametrize(
    ("url", "shown"),
    [
        ("rtsp://admin:pw@cam:554/1", "rtsp://***@cam:554/1"),
        ("rtsp://admin:p@w/d@cam/1", "rtsp://***@cam/1"),
        ("http://cam/live.cgi?user=admin&pwd=pw&channel=2", "http://cam/live.cgi?user=***&pwd=***&channel=2"),
        ("http://cam/a?token=abc#x", "http://cam/a?token=***#x"),
        ("rtsp://cam/1", "rtsp://cam/1"),
        ("http://[broken", "http://[broken"),
    ],
)
def test_passwords_in_urls_are_hidden(url: str, shown: str) -> None:
    assert redact_url(url) == shown


@pytest.mark.parametrize(
    "source",
    [
        {"url": "ftp://admin:hunter2@cam/1"},
        {"url": "rtsp://admin:hunter2@cam/1", "device": 0},
        {"url": ["rtsp://admin:hunter2@cam/1"]},
        ["rtsp://admin:hunter2@cam/1"],
        "rtsp://admin:hunter2@cam/1",
        {"file": 1, "url": "rtsp://admin:hunter2@[cam/1"},
    ],
)
def test_no_message_tells_a_cameras_password(hall: Document, load: Callable[[Document], Site], source: object) -> None:
    put(hall, "cameras[0].source", source)
    with pytest.raises(SiteError) as refusal:
        load(hall)
    assert "hunter2" not in str(refusal.value)


def test_a_source_names_itself_without_its_password(hall: Document, load: Callable[[Document], Site]) -> None:
    put(hall, "cameras[0].source", {"url": "rtsp://admin:hunter2@cam/1"})
    source = load(hall).cameras[0].source
    assert str(source) == "rtsp://***@cam/1"
