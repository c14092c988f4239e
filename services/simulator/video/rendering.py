"""What does the camera see now? People drawn into the prepared scenery, under slowly changing light and sensor noise.

Only what people cover is drawn anew; the rest are three passes over whole pictures in 8 bits. Nothing here depends on
the order or number of calls: a frame is a function of its number, its time and the people in it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from services.simulator.people import Snapshot
from services.simulator.seeds import generator
from services.simulator.video.figures import Clothes, draw_figure, draw_shadow, figure_box, pose_figure, project_figure
from services.simulator.video.scenery import paint_scenery
from services.simulator.video.video_light import Light, VideoParameters
from shared.site import CameraGeometry, Floor

__all__ = ["HallRenderer", "VideoParameters"]

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

_NOISE_PICTURES = 3


class HallRenderer:
    """One camera's view of one floor.

    Args:
        floor: what is seen.
        camera: from where; its ``image_size`` is the size of the pictures.
        persons: everybody who may appear, in the order of ``Snapshot.index``.
        seed: decides textures, clothes and noise.
        holds_phone: whose hand holds a phone.
        video: light, shadows and noise.
    """

    def __init__(
        self,
        floor: Floor,
        camera: CameraGeometry,
        persons: Sequence[str],
        seed: int,
        holds_phone: Callable[[str], bool] = lambda person: False,
        video: VideoParameters | None = None,
    ) -> None:
        self.video = video or VideoParameters()
        self.camera = camera
        self._scenery = paint_scenery(floor, camera, generator(seed, "scenery", floor.id))
        self._clothes = [
            Clothes.draw(generator(seed, "clothes", person), number, holds_phone(person))
            for number, person in enumerate(persons)
        ]
        self._light = Light(self.video, generator(seed, "light"))
        rng = generator(seed, "sensor noise")
        width, height = camera.image_size
        # One picture of noise is shifted to another place each frame: cheap, and new to every pixel.
        self._noise = [
            np.rint(self.video.noise * rng.standard_normal((height + 64, width + 64, 3), np.float32)).astype(np.int16)
            for _ in range(_NOISE_PICTURES if self.video.noise > 0.0 else 0)
        ]
        self._shifts = rng.integers(0, 64, (251, 2))
        for exhibit in self._scenery.exhibits:
            shapely.prepare(exhibit.footprint)

    @property
    def empty(self) -> Image:
        """The scenery alone, (height, width, 3) BGR."""
        return self._scenery.picture

    def height_of(self, index: int) -> float:
        """Return how tall a person is, metres."""
        return self._clothes[index].height

    def frame(self, people: Snapshot, t: float, number: int) -> Image:
        """Return the picture (height, width, 3), BGR.

        Args:
            people: who is there.
            t: time in seconds; decides the light.
            number: of the frame; decides the noise.
        """
        picture = self._scenery.picture.copy()
        if self.video.shadows > 0.0:
            for place in people.position:
                draw_shadow(picture, self.camera, place, self.video.shadows)
            self._cover_shadows(picture)
        eye = self.camera.position[:2]
        for k in np.argsort(-np.hypot(*(people.position - eye).T)).tolist():
            self._draw(picture, people, k)
        cv2.convertScaleAbs(picture, picture, self._light.at(t))
        if self._noise:
            dx, dy = self._shifts[number % len(self._shifts)]
            height, width = picture.shape[:2]
            noise = self._noise[number % len(self._noise)][dy : dy + height, dx : dx + width]
            cv2.add(picture, noise, picture, dtype=cv2.CV_8U)
        return picture

    def _cover_shadows(self, picture: Image) -> None:
        """Shadows lie on the floor: put the exhibits back that they were drawn over."""
        for exhibit in self._scenery.exhibits:
            h, w = exhibit.mask.shape
            rows, columns = slice(exhibit.top, exhibit.top + h), slice(exhibit.left, exhibit.left + w)
            cv2.copyTo(self._scenery.picture[rows, columns], exhibit.mask, picture[rows, columns])

    def _draw(self, picture: Image, people: Snapshot, k: int) -> None:
        clothes = self._clothes[int(people.index[k])]
        joints = pose_figure(
            clothes, people.position[k], float(people.heading[k]), float(people.speed[k]), float(people.walked[k])
        )
        figure = project_figure(joints, self.camera)
        box = None if figure is None else figure_box(figure, self.camera.image_size)
        if figure is None or box is None:
            return
        draw_figure(picture, clothes, figure)
        left, top, right, bottom = box
        line_of_sight = shapely.LineString([self.camera.position[:2], people.position[k]])
        for exhibit in self._scenery.exhibits:
            h, w = exhibit.mask.shape
            x0, y0 = max(left, exhibit.left), max(top, exhibit.top)
            x1, y1 = min(right, exhibit.left + w), min(bottom, exhibit.top + h)
            if x0 < x1 and y0 < y1 and shapely.intersects(exhibit.footprint, line_of_sight):
                cut = exhibit.mask[y0 - exhibit.top : y1 - exhibit.top, x0 - exhibit.left : x1 - exhibit.left]
                cv2.copyTo(self._scenery.picture[y0:y1, x0:x1], cut, picture[y0:y1, x0:x1])
