"""The scene without people, learned in spite of them."""

from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.empty_scene import EVERY, WIDTH, EmptyScene
from services.camera.scene_file import SceneFile

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
        scene.take(picture(number, 30), np.array([[30.0, 20.0, 10.0, 30.0]]), EVERY * number)
    assert scene.picture is None
    for number in range(30, 60):
        scene.take(picture(number, None), NOBODY, EVERY * number)
    assert off(scene) < 6.0


def test_people_who_are_detected_leave_no_trace_and_others_little() -> None:
    scene = EmptyScene()
    for number in range(60):
        scene.take(picture(number, None), NOBODY, EVERY * number)
    for number in range(60, 200):
        left = number % 60
        scene.take(picture(number, left), np.array([[left, 20.0, 10.0, 30.0]], float), EVERY * number)
    assert off(scene) < 6.0
    for number in range(200, 230):  # stands where no detector finds anybody, 100 grey levels and more off
        scene.take(picture(number, 40), NOBODY, EVERY * number)
    assert off(scene) < 16.0


def test_looks_are_some_seconds_apart_and_another_size_begins_anew() -> None:
    scene = EmptyScene()
    assert scene.take(EMPTY, NOBODY, 10.0)
    assert not scene.take(EMPTY, NOBODY, 10.5)
    assert scene.take(EMPTY, NOBODY, 3.0)  # a clock set back
    for number in range(20):
        scene.take(EMPTY, NOBODY, 20.0 + EVERY * number)
    assert scene.picture is not None
    scene.take(EMPTY[:40], NOBODY, 80.0)
    assert scene.picture is None
    for number in range(20):
        scene.take(EMPTY, NOBODY, 90.0 + EVERY * number)
    scene.forget()
    assert scene.picture is None


def test_a_wide_picture_is_shrunk_with_its_boxes() -> None:
    wide = cv2.resize(EMPTY, (2 * WIDTH, 1440), interpolation=cv2.INTER_NEAREST)
    dirty = wide.copy()
    dirty[400:800, 600:900] = 255
    scene = EmptyScene()
    for number in range(12):
        scene.take(wide, NOBODY, EVERY * number)
    scene.take(dirty, np.array([[600.0, 400.0, 300.0, 400.0]]), EVERY * 12)
    assert scene.picture is not None
    assert scene.picture.shape == (720, WIDTH, 3)
    assert np.array_equal(scene.picture, cv2.resize(wide, (WIDTH, 720), interpolation=cv2.INTER_AREA))


def test_a_scene_outlives_a_restart_in_a_file_and_a_broken_file_is_none(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "scene.png"
    scene, file = EmptyScene(), SceneFile(path)
    file.save(scene, 1000.0)
    assert file.load() is None
    for number in range(12):
        scene.take(EMPTY, NOBODY, EVERY * number)
    file.save(scene, 1000.0)
    loaded = SceneFile(path).load()
    assert loaded is not None
    again = EmptyScene()
    again.begin(loaded)
    assert np.array_equal(again.picture, EMPTY)  # type: ignore[arg-type]
    path.write_bytes(b"no picture")
    assert SceneFile(path).load() is None
    assert SceneFile(None).load() is None
    SceneFile(tmp_path).save(scene, 1000.0)  # a folder cannot be written: told in the log
