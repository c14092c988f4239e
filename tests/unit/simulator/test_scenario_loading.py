"""A scenario that cannot be is refused with one line: file, place, what was found, what is allowed."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from services.simulator.scenario_loading import ScenarioError, load_scenario, scenario_digest

PROJECT = Path(__file__).resolve().parents[3]
SITES = PROJECT / "deploy" / "sites"
SHIPPED = sorted(path.parent.name for path in SITES.glob("*/scenario.yaml"))
NEEDS_DATA = {"pets09"}

SITE = {
    "format": "atrium-site/1",
    "site": "room",
    "floors": [
        {
            "id": "ground",
            "outline": [[0, 0], [10, 0], [10, 8], [0, 8]],
            "walls": [[[0, 3], [0, 0], [10, 0]]],
            "obstacles": [{"id": "case", "polygon": [[4, 4], [5, 4], [5, 5], [4, 5]]}],
        }
    ],
    "areas": [{"id": "room", "floor": "ground"}],
    "cameras": [
        {
            "id": "lobby",
            "area": "room",
            "source": {"url": "http://127.0.0.1/lobby.mjpeg"},
            "geometry": {
                "kind": "pose",
                "image_size": [640, 480],
                "position": [5, 0.5, 5],
                "look_at": [5, 4, 0],
                "horizontal_fov": 80,
            },
        }
    ],
    "access_points": [{"id": "ap-1", "floor": "ground", "position": [0, 0, 3], "addresses": ["02:a7:09:00:00:01"]}],
}
SCENARIO = {
    "format": "atrium-scenario/1",
    "scenario": "room",
    "duration": 60,
    "seeds": {"train": 1, "test": 2},
    "people": {"kind": "walkers", "walkers": {"pool": 6, "present": [2, 4]}},
    "views": [{"level": "detections", "frames_per_s": 5}],
    "phones": [{"name": "phone", "count": 2}],
}


def written(folder: Path, scenario: dict[str, Any], site: dict[str, Any] = SITE) -> Path:
    (folder / "site.yaml").write_text(yaml.safe_dump(site))
    path = folder / "scenario.yaml"
    path.write_text(yaml.safe_dump(scenario))
    return path


def changed(document: dict[str, Any], place: str, value: Any) -> dict[str, Any]:
    """A deep copy with one place, written as ``a.0.b``, set."""
    copy: dict[str, Any] = yaml.safe_load(yaml.safe_dump(document))
    *steps, last = (int(step) if step.isdigit() else step for step in place.split("."))
    inner: Any = copy
    for step in steps:
        inner = inner[step]
    inner[last] = value
    return copy


def test_the_example_is_right(tmp_path: Path) -> None:
    scenario, site = load_scenario(written(tmp_path, SCENARIO))
    assert (scenario.scenario, site.site, scenario.seeds.test) == ("room", "room", 2)


@pytest.mark.parametrize(
    ("place", "value", "told"),
    [
        ("durations", 5, "durations: unknown key; allowed here: format, scenario"),
        ("people.walkers.pol", 5, "people.walkers.pol: unknown key; allowed here: behaviour, pool"),
        ("duration", -1, "duration: must be greater than 0 (found -1)"),
        ("duration", "long", "duration: must be a number (found 'long')"),
        ("duration", float("nan"), "duration: "),
        ("seeds", {"train": 1}, "seeds.test: is missing"),
        ("seeds", {"train": 3, "test": 3}, "seeds: train and test must differ"),
        ("people.kind", "ghosts", "people.kind: must be one of walkers, recorded (found 'ghosts')"),
        ("people.walkers.present", "many", "people.walkers.present: must be a list such as [8, 12] (found 'many')"),
        ("people.walkers.present", [4, 2], "people.walkers.present: a range is [low, high], found [4, 2]"),
        ("people.walkers.speed", [-1, 1], "speed: must lie within"),
        ("views.0.level", "smell", "views[0].level: must be one of detections, video, file (found 'smell')"),
        ("views.0.camera", "attic", "views[0].camera: 'attic' is no camera; allowed: lobby"),
        ("views.0.frames_per_s", 0, "views[0].frames_per_s: "),
        ("views.0.detection", {"clutter": -0.5}, "views[0].detection.clutter: "),
        ("views", [{"level": "detections"}, {"level": "video"}], "views: camera lobby is described 2 times"),
        ("phones", [], "phones: must hold at least 1 (found none)"),
        ("phones", None, "phones: must be a list (found null)"),
        ("phones.0.count", 0, "phones[0].count: "),
        ("phones.0.count", 7, "phones: 7 phones, but people.walkers.present lets 4 people in at most"),
        ("phones.0.inertial_rate", -50, "phones[0].inertial_rate: "),
        ("phones.0.ble", {"kind": "adverts"}, "phones[0].ble: nobody here sends ble; access points of site room: wifi"),
        ("phones.0.wifi", {"kind": "regular", "every": -1}, "phones[0].wifi.every: "),
        ("radio", {"noise_sigma": -2}, "radio.noise_sigma: "),
        ("radio", {"changes": [{"at": 5, "kind": "power", "access_point": "ap-9", "by": 3}]}, "ap-9"),
        (
            "radio",
            {"changes": [{"at": 5, "kind": "moved", "access_point": "ap-1", "position": [900, 900, 3]}]},
            "radio.changes[0].position: [900.0, 900.0, 3.0] is 1260.1 m outside the outline of floor ground; allowed: "
            "up to 20 m",
        ),
        (
            "radio",
            {"changes": [{"at": 5, "kind": "wall", "line": [[5, 5], [900, 900], [901, 900]], "floor": "ground"}]},
            "radio.changes[0].line[1]: [900.0, 900.0] is 1260.1 m outside the outline of floor ground; allowed: up to",
        ),
        ("faults", [{"kind": "camera-off", "camera": "attic", "start": 1, "end": 2}], "faults[0].camera: 'attic'"),
        ("faults", [{"kind": "camera-off", "camera": "all"}], "'all' is no camera; allowed: lobby, or '*' for all"),
        ("faults", [{"kind": "camera-off", "camera": "a b"}], "faults[0].camera: must be a camera of the site, or '*'"),
        (
            "faults",
            [{"kind": "phone-gone", "phone": "bob", "start": 1, "end": 2}],
            "faults[0].phone: 'bob' carries no phone; allowed: person-1, person-2, or '*' for all",
        ),
        (
            "faults",
            [{"kind": "phone-clock"}, {"kind": "phone-clock", "phone": 99}],
            "faults[1].phone: there is no phone 99; allowed: 0 to 1, or '*' for all",
        ),
        ("faults", [{"kind": "phone-clock", "phone": "all"}], "faults[0].phone: 'all' carries no phone; allowed"),
        (
            "faults",
            [{"kind": "phone-clock", "phone": True}],
            "faults[0].phone: must be a person's id, the place of a phone counted from 0, or '*'",
        ),
        ("faults", [{"kind": "phone-clock", "phone": -1}], "faults[0].phone: must be a person's id, the place of a"),
        ("faults", [{"kind": "earthquake"}], "faults[0].kind: must be one of camera-off"),
    ],
)
def test_a_mistake_is_told_with_its_place(tmp_path: Path, place: str, value: Any, told: str) -> None:
    path = written(tmp_path, changed(SCENARIO, place, value))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    text = str(caught.value)
    assert told in text
    assert text.startswith(f"{path}: ")
    assert len(text.splitlines()) == 1
    assert text.count("found ") <= 1
    assert "should" not in text


def test_a_fault_of_every_camera_and_phone_is_right(tmp_path: Path) -> None:
    faults = [{"kind": "camera-off", "camera": "*"}, {"kind": "phone-clock", "phone": "*"}, {"kind": "phone-clock"}]
    scenario, _ = load_scenario(written(tmp_path, changed(SCENARIO, "faults", faults)))
    assert [getattr(fault, "phone", None) for fault in scenario.faults] == [None, "*", "*"]


def test_walls_and_access_points_may_change_a_little_way_outside(tmp_path: Path) -> None:
    changes = [
        {"at": 5, "kind": "moved", "access_point": "ap-1", "position": [-15, 4, 3]},
        {"at": 5, "kind": "wall", "line": [[5, 5], [5, 25]], "floor": "ground"},
    ]
    assert load_scenario(written(tmp_path, changed(SCENARIO, "radio", {"changes": changes})))


@pytest.mark.parametrize(
    ("rows", "told"),
    [
        (
            [(700, 1, 2, 2), (701, 1, 3, 2)],
            "people.file: the rows of walk.csv lie from 700 to 701 s; allowed: some from 0",
        ),
        (
            [(-9, 1, 2, 2), (-8, 1, 3, 2)],
            "the rows of walk.csv lie from -9 to -8 s; allowed: some from 0 to the duration",
        ),
        (
            [(5, 1, 2, -90), (6, 1, 3, -90), (5, 2, 44, 4), (6, 2, 45, 4), (70, 1, 2, 2)],
            "people.file: nobody in walk.csv is ever on floor ground, the nearest row is 34.0 m outside its outline",
        ),
    ],
)
def test_recorded_people_nobody_would_ever_meet_are_told(
    tmp_path: Path, rows: list[tuple[float, ...]], told: str
) -> None:
    table = tmp_path / "walk.csv"
    scenario = changed(SCENARIO, "people", {"kind": "recorded", "file": "walk.csv"})
    path = written(tmp_path, changed(scenario, "phones.0.count", 1))
    table.write_text("t,id,x,y\n" + "\n".join(",".join(map(str, row)) for row in rows))
    with pytest.raises(ScenarioError) as caught:
        load_scenario(path)
    assert told in str(caught.value)
    assert str(caught.value).startswith(f"{path}: people.file: ")
    assert len(str(caught.value).splitlines()) == 1
    table.write_text(table.read_text() + "\n59,3,5,2\n60,3,6,2")
    load_scenario(path)


def turned_to_the_sky(site: dict[str, Any]) -> dict[str, Any]:
    return changed(site, "cameras.0.geometry.look_at", [5, -60, 4])


def nameless(site: dict[str, Any]) -> dict[str, Any]:
    return changed(site, "access_points.0.addresses", [])


def nowhere(site: dict[str, Any]) -> dict[str, Any]:
    return changed(site, "access_points.0.position", None)


def wall_through_the_case(site: dict[str, Any]) -> dict[str, Any]:
    return changed(site, "floors.0.walls", [[[2, 4.5], [8, 4.5]]])


@pytest.mark.parametrize(
    ("spoil", "told"),
    [
        (wall_through_the_case, "floors[0].walls[0]: the wall runs through obstacle 'case'"),
        (nameless, "phones[0].wifi: phones would hear nobody: addresses is empty for every wifi access point"),
        (nowhere, "phones: site room does not say where access point ap-1 hangs; allowed: sites that give a position"),
        (turned_to_the_sky, "camera lobby sees 0.00 m² of floor ground; allowed: 0.5 or more"),
    ],
)
def test_a_site_nobody_could_measure_on_is_refused(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], dict[str, Any]], told: str
) -> None:
    with pytest.raises(ScenarioError) as caught:
        load_scenario(written(tmp_path, SCENARIO, spoil(SITE)))
    assert told in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_missing_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(ScenarioError, match=r"nowhere\.yaml: cannot be read"):
        load_scenario(tmp_path / "nowhere.yaml")


def test_the_digest_follows_what_the_world_is_made_of_and_nothing_else(tmp_path: Path) -> None:
    first = scenario_digest(*load_scenario(written(tmp_path, SCENARIO)))
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    assert scenario_digest(*load_scenario(written(elsewhere, changed(SCENARIO, "about", "the same")))) == first
    for place, value in (("duration", 61), ("views.0.frames_per_s", 6), ("radio", {"noise_sigma": 9.0})):
        assert scenario_digest(*load_scenario(written(tmp_path, changed(SCENARIO, place, value)))) != first
    moved = changed(SITE, "access_points.0.position", [1, 0, 3])
    assert scenario_digest(*load_scenario(written(tmp_path, SCENARIO, moved))) != first


@pytest.mark.parametrize("name", SHIPPED)
def test_every_shipped_scenario_is_right(name: str, request: pytest.FixtureRequest) -> None:
    if name in NEEDS_DATA:
        request.getfixturevalue("data_folder")
    scenario, site = load_scenario(SITES / name / "scenario.yaml")
    assert scenario.scenario == name == site.site
    assert scenario.seeds.train != scenario.seeds.test


def test_what_the_issue_asks_for_ships() -> None:
    assert {"museum", "construction-1", "construction-2", "crowd", "office", "mall"} <= set(SHIPPED)
