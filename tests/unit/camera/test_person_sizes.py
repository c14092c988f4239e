"""How tall people look from place to place: measured on who walks alone, drawn towards what was expected."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.camera import person_sizes
from services.camera.detector import Detections
from services.camera.foreground import ForegroundDetector, ForegroundOptions
from services.camera.person_sizes import LEAST, PersonSizes
from services.camera.size_prior import SizePrior
from services.camera.splitting import PersonTemplates
from shared.site import CameraGeometry

SIZE = (320, 240)
CAMERA = CameraGeometry.from_pose(SIZE, (0.0, 0.0, 5.0), (0.0, 12.0, 0.0), math.radians(60))
TEMPLATES = PersonTemplates.build(CAMERA, 1.75, 0.4, 0.3)
Mask = NDArray[np.uint8]


def mask_of(*people: tuple[float, float, float]) -> Mask:
    """Filled rectangles of people at x, y who are so many times 1.75 m tall."""
    mask = np.zeros(SIZE[::-1], np.uint8)
    for x, y, factor in people:
        (u0, _), (u1, _), (_, v1), (_, v0) = CAMERA.to_image(
            np.array([[x - 0.2, y, 0.9], [x + 0.2, y, 0.9], [x, y, 0.0], [x, y, 1.75]])
        )
        mask[round(v1 - factor * (v1 - v0)) : round(v1), round(u0) : round(u1)] = 1
    return mask


def look(sizes: PersonSizes, mask: Mask, t: float) -> None:
    sizes.take(mask, TEMPLATES.split(mask.copy(), 0.1), t)


def walked(factor: object, looks: int, seed: int = 1) -> PersonSizes:
    """One person after the other, elsewhere each second; ``factor`` tells from x, y how tall they look."""
    sizes = PersonSizes(CAMERA, 1.75, 0.4)
    rng = np.random.default_rng(seed)
    for number in range(looks):
        x, y = rng.uniform(-4.5, 4.5), rng.uniform(10.0, 16.0)
        tall = factor(x, y) * math.exp(rng.normal(0.0, 0.04))  # type: ignore[operator]
        look(sizes, mask_of((x, y, tall)), 100.0 + number)
    return sizes


@pytest.mark.parametrize("factor", [0.87, 1.0, 1.13])
def test_people_of_another_height_are_noticed(factor: float) -> None:
    learned = walked(lambda x, y: factor, 250).learned()
    assert learned is not None
    assert learned.height == pytest.approx(factor, abs=0.03)
    assert abs(learned.right) < 0.03
    assert abs(learned.down) < 0.05
    assert learned.width == pytest.approx(1.0, abs=0.1)


def test_what_differs_from_place_to_place_is_noticed_there() -> None:
    learned = walked(lambda x, y: math.exp(0.02 * x), 400).learned()
    assert learned is not None
    left, right = learned.heights(CAMERA.to_image(np.array([[-4.0, 12.0, 0.0], [4.0, 12.0, 0.0]])), SIZE)
    assert right / left == pytest.approx(math.exp(0.16), abs=0.05)


def test_few_people_say_nothing_and_some_say_less_than_many() -> None:
    assert walked(lambda x, y: 1.2, 30).learned() is None
    some, many = walked(lambda x, y: 1.2, 70).learned(), walked(lambda x, y: 1.2, 300).learned()
    assert some is not None
    assert many is not None
    assert 1.1 < some.height <= many.height + 0.02


def test_who_stands_touches_another_or_is_cut_off_is_not_measured() -> None:
    for people in (
        [(0.0, 10.0, 1.0)],  # stands
        [(0.0, 10.0, 1.0), (0.4, 10.0, 1.0)],
        [(0.0, 10.0, 1.0), (0.6, 10.0, 1.0)],
    ):
        sizes = PersonSizes(CAMERA, 1.75, 0.4)
        for number in range(2 * int(LEAST)):
            look(sizes, mask_of(*people), float(number))
        assert sizes.learned() is None
    sizes = PersonSizes(CAMERA, 1.75, 0.4)
    for number in range(2 * int(LEAST)):
        mask = mask_of((0.0, 8.0 + number % 5, 1.0))
        mask[:, 160:162] = 1  # a door post that flickers, up to both edges
        look(sizes, mask, float(number))
    assert sizes.learned() is None


def test_pictures_between_looks_cost_nothing_and_a_clock_set_back_stops_nothing() -> None:
    sizes = PersonSizes(CAMERA, 1.75, 0.4)
    for number in range(250):  # 25 pictures a second
        look(sizes, mask_of((-2.0 + 4.0 * (number % 2), 10.0, 1.0)), 1000.0 + number / 25.0)
    assert sizes.learned() is None
    for number in range(80):
        look(sizes, mask_of((-2.0 + 4.0 * (number % 2), 10.0, 1.0)), float(number))
    assert sizes.learned() is not None


def test_years_of_people_are_forgotten_by_those_who_come_after(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(person_sizes, "MOST", 100.0)
    sizes = PersonSizes(CAMERA, 1.75, 0.4)
    tall, small = (
        [(mask, TEMPLATES.split(mask.copy(), 0.1)) for mask in (mask_of((x, 10.0, factor)) for x in (-1.5, 1.5))]
        for factor in (1.15, 0.9)
    )
    for number in range(400):
        sizes.take(*tall[number % 2], float(number))
    for number in range(400, 800):
        sizes.take(*small[number % 2], float(number))
    learned = sizes.learned()
    assert learned is not None
    assert learned.height < 1.0


@given(
    st.floats(0.5, 2.0),
    st.floats(-0.5, 0.5),
    st.floats(-0.5, 0.5),
    st.lists(st.floats(-1e4, 1e4), min_size=2, max_size=2),
)
def test_no_place_makes_a_size_that_is_none(height: float, right: float, down: float, foot: list[float]) -> None:
    factor = SizePrior(height, right, down).heights(np.array([foot]), SIZE)
    assert 0.5 <= factor[0] <= 2.0


def test_templates_follow_the_sizes() -> None:
    plain = PersonTemplates.build(CAMERA, 1.75, 0.4, 0.3)
    same = PersonTemplates.build(CAMERA, 1.4, 0.32, 0.3, SizePrior(1.25, 0.0, 0.0, 1.25))
    assert np.array_equal(plain.feet, same.feet)
    assert np.array_equal(plain.slices, same.slices)
    tilted = PersonTemplates.build(CAMERA, 1.75, 0.4, 0.3, SizePrior(right=0.2))
    tall = dict(zip(map(tuple, plain.feet.tolist()), plain.feet[:, 1] - plain.heads[:, 1], strict=True))
    ratio = [
        (foot[0], (foot[1] - head[1]) / tall[tuple(foot)])
        for foot, head in zip(tilted.feet.tolist(), tilted.heads.tolist(), strict=True)
        if tuple(foot) in tall
    ]
    assert all((r > 1.0) == (u > 160.0) for u, r in ratio if abs(u - 160.0) > 20.0)


def test_learned_sizes_are_options_the_detector_takes() -> None:
    detector = ForegroundDetector(CAMERA, ForegroundOptions())
    assert detector.learned_sizes == {}
    detector._sizes.take(mask_of(), Detections.none(), 0.0)
    assert detector.learned_sizes == {}
    detector._sizes = walked(lambda x, y: 1.1, 100)
    wanted = ForegroundOptions.model_validate(detector.learned_sizes)
    assert wanted.height_scale == pytest.approx(1.1, abs=0.05)
    assert detector.adopt(wanted)
    detector.forget_sizes()
    assert detector.learned_sizes == {}
