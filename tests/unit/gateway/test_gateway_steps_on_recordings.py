"""Real walks: the Oxford step counter recordings (CC BY 4.0) and shopping-mall traces (MIT)."""

import gzip
import itertools
import math
from pathlib import Path

import numpy as np
import pytest

from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples
from services.gateway.reckoning.resampling import Resampler
from services.gateway.steps.gated_peaks import GatedPeaks


def table(path: Path) -> np.ndarray:
    with gzip.open(path, "rt") as lines:
        return np.loadtxt(lines, delimiter=",")


def count_error(folder: Path) -> float:
    """Detected over true steps, less one; true steps are the rising edges of both foot switches."""
    samples, feet = table(folder / "accelerometer.csv.gz"), table(folder / "stepcounter.csv.gz")
    truth = sum(int(np.sum(np.diff(feet[:, column]) > 0)) for column in (1, 2))
    resampler, detector, found = Resampler(), GatedPeaks(), 0
    for part in np.array_split(samples, 100):
        for segment in resampler.push((part[:, 0] - samples[0, 0]) * 1e-9, part[:, 2:5]):
            if segment.restarts:
                detector.reset()
            found += len(detector.push(segment.t, np.linalg.norm(segment.values, axis=1)))
    return found / truth - 1.0


@pytest.mark.parametrize(
    ("position", "recordings"),
    [
        ("hand", ["Pixel_Jamie_Hard_InHand_1", "Samsung_Carmelo_Hard_InHand_1", "Samsung_Dario_Hard_InHand_1"]),
        ("pocket", ["Samsung_Carmelo_Hard_BackPocket_2", "Pixel_Jamie_Hard_FrontPocket_1"]),
        ("purse", ["Samsung_Carmelo_Hard_Purse_1", "Pixel_Jamie_Hard_Purse_1"]),
    ],
)
def test_steps_of_real_walks_are_counted_to_a_few_percent(
    data_folder: Path, position: str, recordings: list[str]
) -> None:
    folder = data_folder / "step-counter" / "optimisation" / "data"
    errors = [abs(count_error(folder / name)) for name in recordings]
    assert np.median(errors) < 0.025, f"{position}: {dict(zip(recordings, errors, strict=True))}"
    assert max(errors) < 0.06


def mall_trace(path: Path) -> tuple[InertialSamples, np.ndarray]:
    columns = {"TYPE_ACCELEROMETER": 0, "TYPE_GYROSCOPE": 3, "TYPE_MAGNETIC_FIELD": 6}
    rows: dict[int, list[float]] = {}
    way = []
    with gzip.open(path, "rt", errors="replace") as lines:
        for line in lines:
            parts = line.split("\t")
            if len(parts) > 4 and parts[1] in columns:
                begin = columns[parts[1]]
                rows.setdefault(int(parts[0]), [math.nan] * 9)[begin : begin + 3] = map(float, parts[2:5])
            elif len(parts) > 3 and parts[1] == "TYPE_WAYPOINT":
                way.append([int(parts[0]) / 1e3, float(parts[2]), float(parts[3])])
    table = np.array([[stamp / 1e3, *values] for stamp, values in sorted(rows.items())])
    table = table[np.isfinite(table).all(axis=1)]
    return InertialSamples(table[:, 0], table[:, 1:4], table[:, 4:7], table[:, 7:10]), np.array(way)


def test_real_walks_head_the_way_their_legs_do(data_folder: Path) -> None:
    errors = []
    paths = sorted((data_folder / "indoor-location" / "site1" / "F1" / "path_data_files").glob("*.txt.gz"))
    for path in paths:
        samples, way = mall_trace(path)
        motions = DeadReckoner(north=math.pi / 2).push(samples)
        if not motions or not any(len(m.step_t) for m in motions):
            continue
        step_t = np.concatenate([m.step_t for m in motions])
        heading = np.concatenate([m.heading for m in motions])
        for begin, end in itertools.pairwise(way):
            dx, dy = end[1:] - begin[1:]
            on_leg = (step_t > begin[0] + 1.2) & (step_t < end[0])  # people turn a second after the stamp
            if math.hypot(dx, dy) > 10.0 and on_leg.any():
                mean = math.atan2(np.sin(heading[on_leg]).sum(), np.cos(heading[on_leg]).sum())
                errors.append(abs(math.remainder(mean - math.atan2(dy, dx), 2 * math.pi)))
    assert len(errors) >= 90
    assert np.median(errors) < math.radians(9.0)
