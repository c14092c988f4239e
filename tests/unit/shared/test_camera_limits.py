"""What cameras may be told of what was learned."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.camera.detector import check_detector
from services.learning.cameras.detector_choice import SWEEPS
from shared.camera_limits import LEARNED_OPTIONS, alignment_problem, options_problem
from shared.size_options import SIZE_OPTIONS

FLOOR = [(0.0, 0.0), (20.0, 0.0), (20.0, 30.0), (0.0, 30.0)]


@pytest.mark.parametrize("name", LEARNED_OPTIONS)
def test_the_detector_takes_all_that_may_be_learned_and_nothing_much_beyond(name: str) -> None:
    for value in LEARNED_OPTIONS[name]:
        check_detector("foreground", {name: value})
        assert options_problem({name: value}) == ""
    least, most = LEARNED_OPTIONS[name]
    for value in (least - 1.0, most + 1.0, float("nan")):
        assert f"options.{name}: found {value:g}; allowed: " in options_problem({name: value})


def test_all_that_is_looked_for_may_be_learned() -> None:
    assert {sweep.option for sweep in SWEEPS} | set(SIZE_OPTIONS) == set(LEARNED_OPTIONS)
    for sweep in SWEEPS:
        assert options_problem({sweep.option: sweep.least}) == options_problem({sweep.option: sweep.most}) == ""


@given(
    st.floats(-0.28, 0.28), st.floats(0.8, 1.25), st.floats(-1.5, 1.5), st.floats(-1.5, 1.5), st.floats(-0.001, 0.001)
)
def test_what_a_knock_does_may_be_taken_back(turn: float, size: float, x: float, y: float, bent: float) -> None:
    cos, sin = size * np.cos(turn), size * np.sin(turn)
    about = np.array([[1.0, 0.0, 10.0], [0.0, 1.0, 15.0], [0.0, 0.0, 1.0]])
    knock = about @ np.array([[cos, -sin, x], [sin, cos, y], [bent, 0.0, 1.0]]) @ np.linalg.inv(about)
    assert alignment_problem(knock.ravel().tolist(), FLOOR) == ""
    assert alignment_problem(knock.ravel().tolist(), []) == ""


@given(st.lists(st.floats(), min_size=9, max_size=9))
def test_whatever_is_let_through_keeps_the_floor_on_the_plan(homography: list[float]) -> None:
    if alignment_problem(homography, FLOOR):
        return
    matrix = np.reshape(homography, (3, 3))
    there = np.column_stack([FLOOR, np.ones(4)]) @ matrix.T
    assert np.median(np.linalg.norm(there[:, :2] / there[:, 2:] - FLOOR, axis=1)) <= 10.0


@pytest.mark.parametrize(
    ("homography", "words"),
    [
        ([1e300, 0, 0, 0, 1e300, 0, 0, 0, 1], "allowed: nine finite numbers"),
        ([float("nan"), 0, 0, 0, 1, 0, 0, 0, 1], "allowed: nine finite numbers"),
        ([0] * 9, "mirrors or flattens the plan"),
        ([1, 0, 0, 0, -1, 0, 0, 0, 1], "mirrors or flattens the plan"),
        ([1, 0, 11, 0, 1, 0, 0, 0, 1], "by 11 m; allowed: at most 10 m"),
        ([1, 0, 0, 0, 3, 0, 0, 0, 1], "stretches the plan by 1 to 3; allowed: 0.5 to 2"),
        ([1, 0, 0, 0, 1, 0, 0, -0.05, 1], "beyond the horizon"),
    ],
)
def test_what_would_blind_an_area_is_refused(homography: list[float], words: str) -> None:
    assert words in alignment_problem(homography, FLOOR)
