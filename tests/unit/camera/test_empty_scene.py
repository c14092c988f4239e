"""The scene without people, learned in spite of them."""

import numpy as np
from numpy.typing import NDArray

from services.camera.empty_scene import EmptyScene

Image = NDArray[np.uint8]
EMPTY = np.random.default_rng(1).integers(60, 160, (60, 80, 3), np.uint8)
NOBODY = np.zeros((0, 4))


def picture(number: int, left: int | None) -> Image:
    image = EMPTY.astype(float)
    if left is not None:
        image[20:50, left : left + 10] = 250.0
    return np.clip(image + np.random.default_rng(number).normal(0.0, 2.0, EMPTY.shape), 0, 255).astype(np.uint8)


def off(scene: EmptyScene) -> float:
    learned = scene.picture
    assert learned is not None
    return float(np.abs(learned.astype(float) - EMPTY).max(axis=2).max())


def test_it_is_not_known_before_all_of_it_was_quiet() -> None:
    scene = EmptyScene()
    for number in range(30):
        scene.take(picture(number, 30), np.array([[30.0, 20.0, 10.0, 30.0]]), float(number))
    assert scene.picture is None
    for number in range(30, 60):
        scene.take(picture(number, None), NOBODY, float(number))
    assert off(scene) < 6.0


def test_people_who_are_detected_leave_no_trace_and_others_little() -> None:
    scene = EmptyScene()
    for number in range(60):
        scene.take(picture(number, None), NOBODY, float(number))
    for number in range(60, 200):
        left = number % 60
        scene.take(picture(number, left), np.array([[left, 20.0, 10.0, 30.0]], float), float(number))
    assert off(scene) < 6.0
    for number in range(200, 230):  # stands where no detector finds anybody, 100 grey levels and more off
        scene.take(picture(number, 40), NOBODY, float(number))
    assert off(scene) < 16.0


def test_looks_are_a_second_apart_and_another_size_begins_anew() -> None:
    scene = EmptyScene()
    assert scene.take(EMPTY, NOBODY, 10.0)
    assert not scene.take(EMPTY, NOBODY, 10.5)
    assert scene.take(EMPTY, NOBODY, 3.0)  # a clock set back
    for number in range(20):
        scene.take(EMPTY, NOBODY, 20.0 + number)
    assert scene.picture is not None
    scene.take(EMPTY[:40], NOBODY, 60.0)
    assert scene.picture is None
    for number in range(20):
        scene.take(EMPTY, NOBODY, 80.0 + number)
    scene.forget()
    assert scene.picture is None
