"""How fast does the real detector forget people who stand still, and how long does it see those who left?

Rendered people walk in, stand (and fidget) for up to minutes, and leave, before the camera service's own foreground
detector at five learning rates and in two views. What it finds against time is the truth to which the law of
``services.simulator.cameras.fading`` is fitted. Run it with ``atrium bench fading-fit``; it draws into docs/pictures.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.progress import Progress
from scipy.optimize import least_squares
from scipy.signal import lfilter
from scipy.special import expit

from benchmarks.experiment import Experiment, Options, in_parallel
from services.camera.foreground import ForegroundDetector, ForegroundOptions
from services.simulator.cameras.fading import FadingLaw, imprint_after
from services.simulator.people import Snapshot
from services.simulator.seeds import generator
from services.simulator.video.rendering import HallRenderer
from shared.site import CameraGeometry, Floor

__all__ = ["EXPERIMENT", "RATES", "VIEWS", "Clip", "fit_law", "half_time", "main", "measure", "observe", "run"]

Array = NDArray[np.float64]

RATES = (0.003, 0.01, 0.03, 0.1, 0.3)
"""Learning rates per second."""
STAYS = (0.7, 1.1, 1.5, 2.0, 2.6, 3.2)
"""How long people stand, in units of 1 / learning rate."""
AFTER = 0.9
"""How long left places are watched, same unit."""
CLIPS = 2
"""Of each rate and view."""
WALK = 1.2  # m/s
NEAR = 0.9
"""Metres within which a detection belongs to a person or to the place they left."""
SIZE = (320, 240)
VIEWS = {
    "oblique": CameraGeometry.from_pose(SIZE, (5.0, -3.0, 5.5), (5.0, 4.0, 0.0), math.radians(75)),
    "steep": CameraGeometry.from_pose(SIZE, (5.0, 2.5, 9.0), (5.0, 4.2, 0.0), math.radians(62)),
}
HALL = Floor(id="hall", outline=[(-30, -30), (40, -30), (40, 40), (-30, 40)])
PLACES = np.array([[2.6, 2.4], [5.0, 2.0], [7.4, 2.4], [2.8, 5.4], [5.0, 5.8], [7.2, 5.4]])
CENTRE = np.array([5.0, 3.9])


@dataclass(frozen=True, slots=True)
class Clip:
    """What the detector made of one clip.

    Attributes:
        rate: its learning rate, per second.
        stay: how long each of p people stood, seconds.
        standing: (n, p) seconds since each stood still; negative while they walk in, NaN once they go.
        left: (n, p) seconds since each left (1.5 s of walking later); NaN before.
        found: (n, p) whether there was a detection at the person's place.
    """

    rate: float
    stay: Array
    standing: Array
    left: Array
    found: NDArray[np.bool_]


def observe(rate: float, view_name: str, seed: int) -> Clip:
    """Render six people who stand for their different whiles, and return what the detector saw of them."""
    view = VIEWS[view_name]
    frames_per_s = float(np.clip(40.0 * rate, 2.0, 10.0))
    stay = generator(seed, "stays").permutation(STAYS) / rate
    empty = 6.0 + 0.6 / rate  # a young background learns faster than it is told to
    arrive = empty + 8.0
    t = np.arange(0.0, arrive + stay.max() + AFTER / rate + 3.0, 1.0 / frames_per_s)
    standing = np.repeat(t[:, None] - arrive, len(PLACES), axis=1)
    gone = standing - stay
    outward = (PLACES - CENTRE) / np.linalg.norm(PLACES - CENTRE, axis=1, keepdims=True)
    travelled = np.maximum(0.0, -standing) + np.maximum(0.0, gone)
    fidget, turn = _fidget(len(t), len(PLACES), 1.0 / frames_per_s, generator(seed, "fidget"))
    position = PLACES + WALK * travelled[..., None] * outward + fidget
    out = np.arctan2(outward[:, 1], outward[:, 0])
    walking = travelled > 0.0
    heading = np.where(standing < 0.0, out + math.pi, np.where(gone > 0.0, out, 0.7 + turn))
    renderer = HallRenderer(HALL, view, [f"person-{k}" for k in range(len(PLACES))], seed)
    detector = ForegroundDetector(view, ForegroundOptions(learning_rate=rate))
    found = np.zeros(standing.shape, bool)
    for k, now in enumerate(t.tolist()):
        index = np.flatnonzero((np.abs(position[k] - CENTRE) < 9.0).all(axis=1) & (now > empty))
        people = Snapshot(
            [f"person-{i}" for i in index],
            index,
            position[k, index],
            heading[k, index],
            np.where(walking[k, index], WALK, 0.0),
            WALK * travelled[k, index],
        )
        seen = view.to_ground(detector.detect(renderer.frame(people, now, k), now).feet)
        distance = np.linalg.norm(seen[:, None] - PLACES, axis=2)
        found[k] = (distance < NEAR).any(axis=0)
    return Clip(rate, stay, np.where(gone <= 0.0, standing, np.nan), np.where(gone > 1.5, gone, np.nan), found)


def _fidget(n: int, p: int, dt: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Return how still people sway (n, p, 2), metres, and turn (n, p), radians: shifted weight and small motions."""

    def wander(sigma: float, seconds: float, shape: tuple[int, ...]) -> Array:
        keep = math.exp(-dt / seconds)
        noise = sigma * math.sqrt(1.0 - keep * keep) * rng.standard_normal(shape)
        noise[0] /= math.sqrt(1.0 - keep * keep)
        path: Array = lfilter([1.0], [1.0, -keep], noise, axis=0)
        return path

    return wander(0.05, 15.0, (n, p, 2)) + wander(0.015, 1.5, (n, p, 2)), wander(0.25, 12.0, (n, p))


def fit_law(clips: Sequence[Clip]) -> FadingLaw:
    """Return the law that fits the clips best; every clip weighs the same, however many pictures it has."""
    imprint, found, weight, rate = _pooled(clips, "standing")

    def fade_residual(x: Array) -> Array:
        slowness = 1.0 / (1.0 + rate * x[4])
        half, left = x[0] + x[1] * slowness, x[3] * slowness
        seen = expit((half - imprint) / x[2]) / expit(half / x[2])
        return np.asarray(np.sqrt(weight) * (left + (1.0 - left) * seen - found))

    limits = ([0.1, 0.0, 0.005, 0.0, 1.0], [0.95, 0.6, 0.4, 0.5, 300.0])
    fade = least_squares(
        fade_residual, [0.4, 0.1, 0.05, 0.1, 30.0], bounds=limits, x_scale=[0.1, 0.1, 0.02, 0.1, 20.0]
    ).x
    left_imprint, taken, left_weight, _ = _pooled(clips, "left")

    def ghost_residual(x: Array) -> Array:
        return np.asarray(np.sqrt(left_weight) * (expit((left_imprint - x[0]) / x[1]) - taken))

    ghost = least_squares(ghost_residual, [0.6, 0.05], bounds=([0.1, 0.005], [0.95, 0.4])).x
    return FadingLaw(*(float(value) for value in (*fade, *ghost)))


def _pooled(clips: Sequence[Clip], phase: str) -> tuple[Array, Array, Array, Array]:
    """Return imprint, found, weight and rate (n,) of all pictures of one phase."""
    imprints, found, weights, rates = [], [], [], []
    for clip in clips:
        imprint, use = _imprint(clip, phase)
        imprints.append(imprint[use])
        found.append(clip.found[use].astype(float))
        weights.append(np.full(int(use.sum()), 1.0 / max(int(use.sum()), 1)))
        rates.append(np.full(int(use.sum()), clip.rate))
    return np.concatenate(imprints), np.concatenate(found), np.concatenate(weights), np.concatenate(rates)


def _imprint(clip: Clip, phase: str) -> tuple[Array, NDArray[np.bool_]]:
    """Return the imprint (n, p) by theory, and where the phase is on."""
    seconds: Array = getattr(clip, phase)
    use = seconds >= 0.0
    seconds = np.where(use, seconds, 0.0)
    if phase == "standing":
        return imprint_after(clip.rate, seconds), use
    return imprint_after(clip.rate, clip.stay) * np.exp(-clip.rate * seconds), use


def half_time(clips: Sequence[Clip], rate: float) -> float:
    """Return after how many seconds of standing half the people are no longer found, at one learning rate."""
    seconds = np.concatenate([clip.standing[clip.standing >= 0.0] for clip in clips if clip.rate == rate])
    found = np.concatenate([clip.found[clip.standing >= 0.0] for clip in clips if clip.rate == rate])
    edges = np.linspace(0.0, 1.6 / rate, 33)
    middle = 0.5 * (edges[1:] + edges[:-1])
    share = _binned(seconds, found, edges)
    below = int(np.flatnonzero(share < 0.5)[0])
    if below == 0:
        return float(middle[0])
    return float(np.interp(0.5, [share[below], share[below - 1]], [middle[below], middle[below - 1]]))


def _binned(x: Array, found: NDArray[np.bool_], edges: Array) -> Array:
    count, _ = np.histogram(x, edges)
    hits, _ = np.histogram(x[found], edges)
    with np.errstate(invalid="ignore"):
        return np.asarray(hits / np.where(count, count, np.nan))


def measure(clips: Sequence[Clip]) -> tuple[dict[str, float], FadingLaw]:
    """Return the figures by name, and the law fitted to these clips."""
    law = fit_law(clips)
    figures = {name: getattr(law, name) for name in FadingLaw.__slots__}
    for phase, name in (("standing", "fade_error"), ("left", "ghost_error")):
        errors = []
        for clip in clips:
            imprint, use = _imprint(clip, phase)
            curve = law.visible(_MIDDLES, clip.rate) if phase == "standing" else law.ghostly(_MIDDLES)
            difference = _binned(imprint[use], clip.found[use], _EDGES) - curve
            errors.append(difference[np.isfinite(difference)])
        figures[name] = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    grid = np.linspace(0.0, 0.99, 2000)
    for rate in sorted({clip.rate for clip in clips}):
        half = float(grid[np.argmax(law.visible(grid, rate) < 0.5)])
        figures[f"half_time_s_{rate:g}"] = half_time(clips, rate)
        figures[f"law_half_time_s_{rate:g}"] = -math.log(1.0 - half) / rate
    return figures, law


def draw(clips: Sequence[Clip], law: FadingLaw, path: Path) -> None:
    """Draw what was measured (points) against the law (lines), by time and by imprint."""
    figure = Figure(figsize=(11.0, 4.4), layout="constrained")
    still, left = figure.subplots(1, 2)
    for number, rate in enumerate(sorted({clip.rate for clip in clips})):
        colour = f"C{number}"
        mine = [clip for clip in clips if clip.rate == rate]
        seconds = np.concatenate([clip.standing[clip.standing >= 0.0] for clip in mine])
        found = np.concatenate([clip.found[clip.standing >= 0.0] for clip in mine])
        edges = np.linspace(0.0, 2.0 / rate, 30)
        middle = 0.5 * (edges[1:] + edges[:-1])
        still.semilogx(middle, _binned(seconds, found, edges), "o", ms=4, color=colour, label=f"{rate:g} per second")
        fine = np.geomspace(0.03 / rate, 2.0 / rate, 300)
        still.semilogx(fine, law.visible(imprint_after(rate, fine), rate), "-", color=colour)
        pairs = [(*_imprint(clip, "left"), clip.found) for clip in mine]
        imprint = np.concatenate([values[use] for values, use, _ in pairs])
        ghost = np.concatenate([found[use] for _, use, found in pairs])
        left.plot(_MIDDLES, _binned(imprint, ghost, _EDGES), "o", ms=4, color=colour)
    left.plot(np.linspace(0, 1, 300), law.ghostly(np.linspace(0, 1, 300)), "k-", label="law")
    still.set(xlabel="seconds since standing still", ylabel="share found", title="People fade", ylim=(-0.03, 1.05))
    still.legend(title="learning rate\n(points: MOG2, lines: law)", fontsize=8, title_fontsize=8, loc="lower left")
    left.set(
        xlabel="imprint left behind, decaying by exp(−rate · seconds)",
        ylabel="share in which the empty place is taken for a person",
        title="Ghosts remain",
    )
    left.legend()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=110)


def run(options: Options, progress: Progress) -> dict[str, float]:
    """Render, detect, fit and draw."""
    cells = [(rate, view, options.seed + k) for rate in RATES for view in VIEWS for k in range(CLIPS)]
    clips = in_parallel(observe, cells, options.jobs, progress, "clips")
    figures, law = measure(clips)
    draw(clips, law, options.picture)
    return figures


EXPERIMENT = Experiment(
    name="fading-fit",
    question="How fast does the detector forget people who stand still, and how long does it see those who left?",
    kind="model",
    scenario="rendered people",
    seed=1,
    run=run,
    made=(
        "Six rendered people at a time walk in, stand and fidget for 0.7 to 3.2 times 1 / rate, and leave; 320 x 240 "
        "pixels, an oblique view from 5.5 m and a steep one from 9 m, two seeds each, five learning rates. The camera "
        "service's own foreground detector looks at them; somebody counts as found while a detection lies within 0.9 m "
        "of their place. The simulator's detections (`services/simulator/cameras/fading.py`) use the fitted constants. "
        "`half_time_s_R`: when half the people are no longer found at R per second, `law_…` by the fitted law; "
        "`fade_error`, `ghost_error`: root mean square difference between the shares measured and the law's, over "
        "twentieths of imprint."
    ),
    at_most={"fade_error": 0.2, "ghost_error": 0.2},
    picture="Shares found by MOG2 on rendered clips (points) and the law of the simulated detections (lines)",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


_EDGES = np.linspace(0.0, 1.0, 21)
_MIDDLES = 0.5 * (_EDGES[1:] + _EDGES[:-1])

if __name__ == "__main__":
    sys.exit(main())
