"""How tall people look is measured only while the camera looks where it looked, and forgotten whenever that changes."""

from unittest.mock import MagicMock

import numpy as np
import pytest
from numpy.typing import NDArray

from services.camera.frames import Frame
from services.camera.pipeline import Pipeline
from services.camera.scene_watch import EVERY
from services.camera.service import CameraService
from services.camera.settings import CameraSettings
from shared.runner import Health
from shared.site import Site

Image = NDArray[np.uint8]
SIZE = (320, 240)
SITE = Site.model_validate(
    {
        "format": "atrium-site/1",
        "site": "test",
        "floors": [{"id": "ground", "outline": [[-20, -5], [20, -5], [20, 40], [-20, 40]]}],
        "areas": [{"id": "hall", "floor": "ground"}],
        "cameras": [
            {
                "id": "door",
                "area": "hall",
                "source": {"url": "rtsp://192.0.2.1/live"},
                "geometry": {
                    "kind": "pose",
                    "image_size": SIZE,
                    "position": [0, 0, 5],
                    "look_at": [0, 12, 0],
                    "horizontal_fov": 60,
                },
            }
        ],
    }
)
CAMERA = SITE.camera("door").geometry.build()


def scene() -> Image:
    rng = np.random.default_rng(1)
    image = np.full((SIZE[1], SIZE[0], 3), 120, np.uint8)
    for _ in range(60):
        left, top, w, h = rng.integers((0, 0, 8, 8), (*SIZE, 70, 70))
        image[top : top + h, left : left + w] = rng.integers(40, 140, 3)
    return image


HALL = scene()


class Film:
    """A camera service, and somebody else who walks through its view at each look of its watch."""

    def __init__(self) -> None:
        settings = CameraSettings(camera="door", site_file="site.yaml")
        self.camera = CameraService(settings, SITE, MagicMock(), Health())
        self.pipeline: Pipeline = self.camera._pipeline
        self.number = 0
        self.rng = np.random.default_rng(3)

    def show(self, view: Image, looks: int) -> dict[str, float]:
        """Return what is learned of people's sizes after so many looks."""
        for _ in range(looks):
            x, y = self.rng.uniform(-3.5, 3.5), self.rng.uniform(10.0, 15.0)
            edges = CAMERA.to_image(np.array([[x - 0.2, y, 0.9], [x + 0.2, y, 0.9], [x, y, 0.0], [x, y, 1.75]]))
            (left, _), (right, _), (_, foot), (_, head) = np.round(edges).astype(int).tolist()
            image = view.copy()
            image[head:foot, left:right] = 250
            t = 1000.0 + EVERY * self.number
            self.camera._take(Frame(image, t, self.number, 1000.0, t))
            self.number += 1
        return self.pipeline.learned_sizes

    @property
    def verdict(self) -> str:
        return self.camera._watch.verdict


def test_sizes_are_measured_only_while_the_view_is_as_known_and_forgotten_when_it_changes() -> None:
    film = Film()
    learned = film.show(HALL, 110)
    assert learned["height_scale"] == pytest.approx(1.0, abs=0.06)
    knocked = np.roll(HALL, (24, 30), axis=(0, 1))
    looks = 0
    while not film.verdict and looks < 80:
        learned = film.show(knocked, 1)
        looks += 1
    assert "shifted" in film.verdict
    assert learned == {}, "what was measured until it was told is of the other view, too"
    assert film.show(knocked, 110) == {}
    film.pipeline.adopt({"person_height": 1.7})  # whoever is built anew meanwhile measures nothing either
    assert film.show(knocked, 110) == {}
    while film.verdict and looks < 160:
        learned = film.show(HALL, 1)
        looks += 1
    assert film.verdict == ""
    assert learned == {}
    assert film.show(HALL, 110)["height_scale"] == pytest.approx(1.75 / 1.7, abs=0.06)


def test_a_view_that_is_taken_for_the_right_one_begins_anew() -> None:
    film = Film()
    film.show(HALL, 60)
    film.show(np.roll(HALL, (24, 30), axis=(0, 1)), 60)
    assert film.verdict
    film.camera._watch.forget()  # as when the camera is aligned to what it shows now
    assert film.show(np.roll(HALL, (24, 30), axis=(0, 1)), 110)["height_scale"] == pytest.approx(1.0, abs=0.06)
