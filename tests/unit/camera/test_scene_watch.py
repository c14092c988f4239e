"""A camera that looks elsewhere is noticed, in plain words; light, people and furniture are not taken for that."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from services.camera.scene_watch import EVERY, SceneWatch, same_place

Image = NDArray[np.uint8]
SIZE = (320, 240)


def scene(seed: int) -> Image:
    """Floor, walls and things, as edges of many sizes."""
    rng = np.random.default_rng(seed)
    image = np.full((SIZE[1], SIZE[0], 3), 120, np.uint8)
    for _ in range(60):
        left, top = rng.integers(0, SIZE[0]), rng.integers(0, SIZE[1])
        w, h = rng.integers(8, 70, 2)
        cv2.rectangle(
            image, (int(left), int(top)), (int(left + w), int(top + h)), rng.integers(40, 210, 3).tolist(), -1
        )
    return image


HALL = scene(1)
NOISE = np.random.default_rng(0).normal(0.0, 3.0, HALL.shape)


def seen(image: Image, number: int, light: float = 1.0) -> Image:
    """A picture with noise, and with somebody who stands about for long."""
    image = image.copy()
    x = 20 + 40 * (number // 12 % 6)
    cv2.rectangle(image, (x, 80), (x + 25, 190), (250, 250, 250), -1)
    return noisy(light * image, number)


def noisy(image: NDArray[np.float64], number: int) -> Image:
    return np.clip(image + np.resize(np.roll(NOISE, 37 * number, axis=1), image.shape), 0, 255).astype(np.uint8)


def watch(watch_: SceneWatch, image: Image, first: int, count: int, light: float = 1.0) -> str:
    for number in range(first, first + count):
        watch_.take(seen(image, number, light), EVERY * number)
    return watch_.verdict


def test_people_light_and_slow_change_are_nothing_to_tell() -> None:
    watch_ = SceneWatch()
    assert watch(watch_, HALL, 0, 60) == ""
    assert watch(watch_, HALL, 60, 40, light=0.5) == ""
    changed = HALL.copy()
    changed[150:200, 40:140] = 30  # a piece of furniture came
    assert watch(watch_, changed, 100, 60) == ""


@pytest.mark.parametrize(("dx", "dy"), [(24, 0), (-16, 30), (9, -12)])
def test_a_knock_is_told_with_its_size(dx: int, dy: int) -> None:
    watch_ = SceneWatch()
    watch(watch_, HALL, 0, 20)
    moved = cv2.warpAffine(HALL, np.array([[1.0, 0.0, dx], [0.0, 1.0, dy]]), SIZE, borderMode=cv2.BORDER_REFLECT)
    verdict = watch(watch_, np.asarray(moved, np.uint8), 20, 45)
    assert "was the camera knocked" in verdict
    told = int(next(word for word in verdict.split() if word.isdigit()))
    assert abs(told - np.hypot(dx, dy)) < 4
    assert watch(watch_, HALL, 65, 45) == ""  # somebody set it right


@pytest.mark.parametrize(
    ("image", "told"),
    [(np.full_like(HALL, 90), "covered"), (np.zeros_like(HALL), "dark"), (scene(2), "another place")],
)
def test_a_covered_camera_and_one_that_was_turned_are_told(image: Image, told: str) -> None:
    watch_ = SceneWatch()
    watch(watch_, HALL, 0, 20)
    for number in range(20, 65):
        watch_.take(noisy(image.astype(float), number), EVERY * number)
    assert told in watch_.verdict
    watch_.forget()
    assert watch_.verdict == ""


def test_a_hand_before_the_lens_for_a_moment_is_not_told() -> None:
    watch_ = SceneWatch()
    watch(watch_, HALL, 0, 20)
    for number in range(20, 26):
        watch_.take(np.full_like(HALL, 60), EVERY * number)
        assert watch_.verdict == ""
    assert watch(watch_, HALL, 26, 40) == ""


def test_two_pictures_of_one_place_are_told_from_two_of_two() -> None:
    assert same_place(HALL, seen(cv2.resize(HALL, (640, 480)), 3, light=0.7))  # type: ignore[arg-type]
    assert not same_place(HALL, seen(scene(2), 3))
    assert not same_place(HALL, np.full_like(HALL, 128))
    assert not same_place(HALL, HALL[:, :200])
