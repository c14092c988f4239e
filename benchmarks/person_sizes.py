"""Does a camera learn how tall people look, and are they found better for it? On drawn video, where both are known.

A camera 4 m up in the museum's hall is drawn as the twin's people walk by. Its detector expects people who are as tall
as they are, or 15 % smaller or taller. For three minutes it measures them; in the next two it is scored by the truth
beside another one that has seen the same and then adopts what was measured, as a camera does whose sizes go live.
"""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray
from rich.progress import Progress
from scipy.optimize import linear_sum_assignment

from benchmarks.experiment import Experiment, Figures, Options
from benchmarks.world_run import load
from services.camera.detector import Detections, Image
from services.camera.foreground import ForegroundDetector, ForegroundOptions
from services.simulator.people import snapshot
from services.simulator.video.rendering import HallRenderer
from services.simulator.world import people_of
from shared.site import CameraGeometry

__all__ = ["CAMERA", "Bout", "Tally", "measure"]

Array = NDArray[np.float64]

SIZE = (480, 360)
"""Pixels of the pictures: of the detector's mask."""
RATE = 4.0
"""Pictures per second."""
TAUGHT, SCORED = 180.0, 120.0
"""Seconds."""
GATE = 1.0
"""Metres within which a detection is of a person."""
OFF = {"small": 0.85, "right": 1.0, "tall": 1.15}
"""Height that people are expected to have over what they have, in the mean."""
CAMERA = CameraGeometry.from_pose(SIZE, (6.5, 0.3, 4.0), (6.5, 9.3, 0.0), math.radians(75.0))
"""On a wall, looking down across the hall."""


@dataclass
class Tally:
    """Counts of detections held against the truth.

    Attributes:
        hits: people who were found.
        misses: those who were not.
        false: detections of nobody.
        squared: sum over those found of squared distances, m².
    """

    hits: int = 0
    misses: int = 0
    false: int = 0
    squared: float = 0.0

    def count(self, found: Detections, places: Array) -> None:
        """Hold the people ``found`` in a picture against the ``places`` (n, 2), metres, of those with feet in view."""
        inside = (found.feet >= 0.0).all(axis=1) & (found.feet < SIZE).all(axis=1)
        distance = np.linalg.norm(CAMERA.to_ground(found.feet[inside])[:, None] - places, axis=2)
        rows, columns = linear_sum_assignment(np.where(distance < GATE, distance, 1e3))
        near = distance[rows, columns]
        near = near[near < GATE]
        self.hits += len(near)
        self.misses += len(places) - len(near)
        self.false += int(inside.sum()) - len(near)
        self.squared += float((near**2).sum())

    def figures(self, ending: str) -> dict[str, float | None]:
        """Return recall, precision and the root mean square of distances; None where there is nothing to tell."""
        return {
            f"recall_{ending}": self.hits / (self.hits + self.misses) if self.hits + self.misses else None,
            f"precision_{ending}": self.hits / (self.hits + self.false) if self.hits + self.false else None,
            f"rmse_m_{ending}": math.sqrt(self.squared / self.hits) if self.hits else None,
        }


class Bout:
    """Two detectors of one configuration: the second adopts what the first has measured.

    Args:
        height: metres that people are configured to be tall.
    """

    def __init__(self, height: float) -> None:
        self._options = ForegroundOptions(person_height=height)
        self._detectors = [ForegroundDetector(CAMERA, self._options) for _ in range(2)]
        self._tallies = [Tally(), Tally()]
        self._sizes: dict[str, float] = {}

    def learn(self, picture: Image, t: float) -> None:
        """Look at a picture that teaches."""
        for detector in self._detectors:
            detector.detect(picture, t)

    def adopt(self) -> None:
        """Let the second detector go on with what was measured so far."""
        self._sizes = self._detectors[0].learned_sizes
        self._detectors[1].adopt(self._options.model_copy(update=self._sizes))

    def score(self, picture: Image, t: float, places: Array) -> None:
        """Hold what both find in a picture against where people are: (n, 2) metres."""
        for detector, tally in zip(self._detectors, self._tallies, strict=True):
            tally.count(detector.detect(picture, t), places)

    def figures(self, name: str) -> dict[str, float | None]:
        """Return what came of it, with a name for each figure that ends with ``name``."""
        before, after = (
            tally.figures(f"{stage}_{name}")
            for stage, tally in zip(("configured", "learned"), self._tallies, strict=True)
        )
        height = self._options.person_height * self._sizes.get("height_scale", 1.0)
        learned = {f"height_m_learned_{name}": height, f"width_scale_{name}": self._sizes.get("width_scale")}
        return before | after | learned


def measure(
    scenario: str, seed: int, progress: Progress, taught: float = TAUGHT, scored: float = SCORED
) -> dict[str, float | None]:
    """Return the figures of a world of the twin, from its beginning.

    Args:
        scenario: of the world, on whose first floor the camera hangs.
        seed: of it.
        progress: gets a step per picture.
        taught: seconds in which sizes are measured.
        scored: seconds after these, in which detections are held against the truth.
    """
    cv2.setNumThreads(1)
    world, site = load(scenario)
    people = people_of(world, site, seed)
    floor = site.floors[0]
    view = HallRenderer(floor, CAMERA, people.persons, seed)
    tall = float(np.mean([view.height_of(index) for index in range(len(people.persons))]))
    bouts = {name: Bout(tall * off) for name, off in OFF.items()}
    inside = shapely.box(0.0, 0.0, SIZE[0], SIZE[1] - 1.0)
    first, number = round(taught * RATE), round((taught + scored) * RATE)
    for picture in progress.track(range(number), description="pictures"):
        t = picture / RATE
        shown = snapshot(people, t, floor.id)
        image = view.frame(shown, t, picture)
        feet = CAMERA.to_image(np.column_stack([shown.position, np.zeros(len(shown.position))]))
        places = shown.position[shapely.contains_xy(inside, feet)]
        for bout in bouts.values():
            if picture == first:
                bout.adopt()
            if picture < first:
                bout.learn(image, t)
            else:
                bout.score(image, t, places)
    figures: dict[str, float | None] = {"height_m": tall}
    for name, bout in bouts.items():
        figures |= bout.figures(name)
    return figures


def run(options: Options, progress: Progress) -> Figures:
    """Measure one world."""
    return measure(options.scenario, options.seed, progress)


EXPERIMENT = Experiment(
    name="person-sizes",
    question="Does a camera learn how tall people look, and are they found better for it?",
    kind="twin",
    scenario="museum",
    run=run,
    made="""Drawn video (480 x 360, four pictures a second) of a camera 4 m up in the museum's hall. The detector is
configured for people 15 % smaller than the drawn ones, as tall, or 15 % taller (`_small`, `_right`, `_tall`); it
measures them for three minutes, and the next two are scored by the truth: `_configured` goes on, `_learned` adopts what
was measured. A detection within 1 m of somebody is of them; recall counts everybody whose feet lie in the picture,
hidden or not. `height_m` is the drawn people's mean, `height_m_learned` what they are taken for in the middle of the
picture, `width_scale` their width over the configured one. Whether the measured sizes would go live is not asked here:
that is for fusion's score to say.""",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
