"""What the health page says of cameras, phones and what could not be used."""

import re
from pathlib import Path

from services.fusion.reasons import EXPLANATIONS, coarse, explain
from services.fusion.watch import Watch
from shared.runner import Health


def watching(cameras: tuple[str, ...] = ()) -> tuple[Watch, Health]:
    health = Health()
    return Watch(health, cameras, camera_silence=5.0, phones_silence=60.0, now=0.0), health


def test_a_silent_camera_is_named_until_it_speaks() -> None:
    watch, health = watching(("west", "east"))
    watch.camera_spoke("east", 4.0)
    watch.look({}, [], 0, 6.0)
    assert list(health.problems()) == ["camera west"]
    assert "no frames from camera west for 5 s or more" in health.problems()["camera west"]
    watch.camera_spoke("west", 6.5)
    watch.look({}, [], 0, 7.0)
    assert health.problems() == {}


def test_words_do_not_change_with_every_look() -> None:
    watch, health = watching(("west",))
    said = set()
    for quarter in range(20, 400):
        watch.look({}, [], 0, quarter / 4)
        said |= {health.problems()["camera west"]}
    assert len(said) == 4  # 5, 10, 20 and 50 seconds


def test_phones_that_all_fall_silent_while_people_are_there_are_a_problem() -> None:
    watch, health = watching()
    watch.look({}, [], 5, 1000.0)
    assert health.problems() == {}  # no phone was ever heard: there may be none
    watch.phone_spoke(1000.0)
    watch.look({}, [], 5, 1059.0)
    assert health.problems() == {}
    watch.look({}, [], 5, 1061.0)
    assert "is the gateway running" in health.problems()["phones"]
    watch.look({}, [], 0, 1070.0)  # everybody has gone home
    assert health.problems() == {}
    watch.look({}, [], 5, 1080.0)
    watch.phone_spoke(1081.0)
    watch.look({}, [], 5, 1082.0)
    assert health.problems() == {}


def test_what_is_counted_often_is_explained_while_it_lasts() -> None:
    watch, health = watching()
    reason = "radio without a known access point"
    for second in range(0, 70, 5):
        watch.look({reason: 2 * second}, [], 0, float(second))
    words = health.problems()[reason]
    assert "100 or more x radio without a known access point in the last minute" in words
    assert "add the addresses" in words
    for second in range(70, 200, 5):
        watch.look({reason: 140}, [], 0, float(second))
    assert health.problems() == {}


def test_a_few_of_what_happens_every_day_are_no_problem() -> None:
    assert explain("radio told again or out of order", 3) is None
    assert explain("time went backwards", 1) is not None
    assert explain("something new", 29) is None
    assert "something new" in (explain("something new", 30) or "")


def test_what_the_tracker_finds_wrong_with_its_sensors_is_told() -> None:
    watch, health = watching()
    watch.look({}, ["camera west's clock is 0.3 s ahead"], 0, 1.0)
    assert health.problems() == {"sensors": "camera west's clock is 0.3 s ahead"}
    watch.look({}, [], 0, 2.0)
    assert health.problems() == {}


def test_numbers_are_told_coarsely() -> None:
    assert [coarse(n) for n in (0.5, 1, 3, 7, 10, 19, 49, 51, 999, 1000)] == [1, 1, 2, 5, 10, 10, 20, 50, 500, 1000]


def test_every_reason_fusion_counts_has_its_explanation(project: Path) -> None:
    counted = set()
    for file in (project / "services" / "fusion").rglob("*.py"):
        counted |= set(re.findall(r'(?:ignored|dropped|_counted|_count)\["([^"{]+)"\] \+=', file.read_text()))
        counted |= set(re.findall(r'_ignore\(\s*"([^"]+)"', file.read_text()))
    assert len(counted) > 10
    assert counted - EXPLANATIONS.keys() == set()


def test_after_a_restart_a_name_stands_for_a_phone_that_spoke_before() -> None:
    watch, health = watching()
    for now in range(0, 70, 10):  # names out of the restored state: they do not stand for a phone that speaks now
        watch.phone_known(float(now))
    watch.look({}, [], 5, 59.0)
    assert health.problems() == {}
    watch.look({}, [], 5, 61.0)
    assert "is the gateway running" in health.problems()["phones"]
