"""What is said of many tracks and borders at once is what is said of each alone, slowly."""

import numpy as np
import pytest
from geofence_oracle import SlowArea, depth_of
from hypothesis import given, settings
from hypothesis import strategies as st

from services.geofence.borders import Borders
from services.geofence.crossings import Crossings
from services.geofence.zone_index import ZoneIndex

# Wide enough not to be walked through in one breath: of passes the oracle knows nothing.
RINGS = [
    [(0.0, 0.0), (5.0, 0.0), (5.0, 5.0), (0.0, 5.0)],
    [(3.0, 2.0), (9.0, 2.0), (9.0, 8.0), (6.0, 8.0), (6.0, 5.0), (3.0, 5.0)],
    [(-6.0, -6.0), (-1.0, -4.0), (-3.0, 3.0)],
]
LINE = [(-8.0, -1.0), (8.0, 1.5)]
CONFIDENCE = [0.5, 0.9, 0.6]
MARGIN, LEAST, RATE = 0.25, 0.2, 10.0
# Errors are small enough for depths beyond the index's reach, which it does not measure, to count at once.


def strolls(generator: np.random.Generator, people: int, frames: int) -> np.ndarray:
    """People who stroll, (frames, people, 2): turning now and then, standing at times."""
    place, heading = generator.uniform(-8, 10, (people, 2)), generator.uniform(0, 6.3, people)
    speed = generator.uniform(0.0, 1.6, people)
    way = []
    for _ in range(frames):
        heading += generator.normal(0.0, 0.15, people)
        place = place + (speed / RATE)[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
        outside = np.abs(place) > 10.0
        heading = np.where(outside.any(axis=1), np.arctan2(-place[:, 1], -place[:, 0]), heading)
        way.append(place)
    return np.array(way)


@given(seed=st.integers(0, 2**32 - 1), sigma=st.floats(0.05, 0.19), missing=st.floats(0.0, 0.2))
@settings(max_examples=8, deadline=None)
def test_enters_and_exits_are_those_of_each_track_alone(seed: int, sigma: float, missing: float) -> None:
    generator = np.random.default_rng(seed)
    people, frames = 8, 120
    way = strolls(generator, people, frames)
    measured = way + generator.normal(0.0, sigma, way.shape)
    index = ZoneIndex(RINGS, ["floor"] * 3, MARGIN + 2.0 * 0.5)
    crossings = Crossings(Borders(index, MARGIN, LEAST, np.array(CONFIDENCE)), grace=60.0)
    slow = [
        [SlowArea(ring, MARGIN, LEAST, c) for ring, c in zip(RINGS, CONFIDENCE, strict=True)] for _ in range(people)
    ]
    told, expected, passes = [], [], set()
    for number in range(frames):
        t = number / RATE
        there = np.flatnonzero(generator.random(people) >= missing)
        x, y = measured[number, there, 0].copy(), measured[number, there, 1].copy()
        covariance = np.tile([sigma**2, 0.0, sigma**2], (len(there), 1))
        happened = crossings.step(t, there, np.zeros(len(there), np.int64), x, y, covariance=covariance)
        both = {(c.track, c.border) for c in happened if c.kind == "enter"} & {
            (c.track, c.border) for c in happened if c.kind == "exit"
        }
        passes |= both
        told += [(number, c.track, c.border, c.kind) for c in happened if (c.track, c.border) not in both]
        for track, place in zip(there.tolist(), zip(x.tolist(), y.tolist(), strict=True), strict=True):
            for border, machine in enumerate(slow[track]):
                kind = machine.step(t, place, sigma)
                if kind is not None:
                    expected.append((number, track, border, kind))
    assert sorted(told) == sorted(expected)
    inside = [sum(slow[track][border].inside for track in range(people)) for border in range(3)]
    assert crossings.occupancy.tolist() == inside


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_a_line_is_crossed_as_often_as_a_straight_walk_crosses_it(seed: int) -> None:
    """Exactly known places, straight walks of many tracks at once: the segment's own geometry is the oracle."""
    generator = np.random.default_rng(seed)
    people, frames = 30, 60
    start, end = generator.uniform(-9, 9, (2, people, 2))
    crossings = Crossings(Borders(ZoneIndex([LINE], ["floor"], 1.25, [True]), MARGIN, LEAST), grace=60.0)
    told: list[tuple[int, str | None]] = []
    for number in range(frames):
        place = start + (end - start) * number / (frames - 1)
        track, floor = np.arange(people), np.zeros(people, np.int64)
        happened = crossings.step(number / RATE, track, floor, place[:, 0].copy(), place[:, 1].copy())
        told += [(c.track, c.direction) for c in happened]
    (ax, ay), (bx, by) = LINE
    for person in range(people):
        (x0, y0), (x1, y1) = start[person], end[person]
        before = (bx - ax) * (y0 - ay) - (by - ay) * (x0 - ax)
        after = (bx - ax) * (y1 - ay) - (by - ay) * (x1 - ax)
        low = (x1 - x0) * (ay - y0) - (y1 - y0) * (ax - x0)
        high = (x1 - x0) * (by - y0) - (y1 - y0) * (bx - x0)
        depths = [depth_of(LINE, True, (x0, y0)), depth_of(LINE, True, (x1, y1))]
        if min(abs(depth) for depth in depths) < MARGIN or min(abs(low), abs(high)) < 1e-6:
            continue
        through = before * after < 0 and low * high < 0
        mine = [direction for track, direction in told if track == person]
        assert mine == ([("forward" if before > 0 else "backward")] if through else [])


@pytest.mark.parametrize("border", range(3))
def test_depths_are_the_oracles(border: int) -> None:
    index = ZoneIndex(RINGS, ["floor"] * 3, 1.0)
    points = np.random.default_rng(border).uniform(-10, 10, (200, 2))
    depth = index.depth(np.full(200, border), points[:, 0], points[:, 1])
    assert depth == pytest.approx([depth_of(RINGS[border], False, (x, y)) for x, y in points.tolist()], abs=1e-9)
