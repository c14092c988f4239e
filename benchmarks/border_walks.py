"""Are borders told right by positions that jitter? Walks across zones, errors of 0.3 m, and what was told of them.

Truth is the walk itself; what is told comes from the positions with errors. Beside it the plain method: whoever's
position lies in the polygon is inside.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.eth_recording import eth_recording
from benchmarks.world_run import TRUTH_EVERY, load, record_world
from services.geofence.borders import Borders
from services.geofence.crossings import Crossings
from services.geofence.evidence import SURE
from services.geofence.settings import GeofenceSettings
from services.geofence.zone_index import ZoneIndex
from services.geofence.zone_plan import MOST_SPREAD

__all__ = ["Course", "Score", "courses_over", "eth_walks", "loiterers", "score_walks", "simulated_walks"]

Array = NDArray[np.float64]
Ints = NDArray[np.int64]

RATE = 15.0
"""Positions per second."""
SIGMA = 0.3
"""Metres, standard deviation of a position along each axis, anew in each."""
CLEAR, CAME = 0.3, 0.6
"""Metres beyond a border from which on somebody has clearly crossed it, and on this side if they clearly came from …"""
STAYED = 1.0
"""… here for so many seconds."""
SLACK = 0.1
"""Metres: whoever is no farther outside than this may be told to be inside."""
LATEST = 2.0
"""Seconds after which an alert is no answer to a crossing any more."""
WALKS_IN = 0.6
"""Seconds in which somebody who walks in, and does not dawdle on the border, is clearly inside."""
AT_ENDS = 3.0 * SIGMA
"""Metres from the ends of lines and gates in which nobody can say whether somebody went through or round."""
MARGIN, MIN_SECONDS, GRACE = (
    float(GeofenceSettings.model_fields[name].default)
    for name in ("geofence_margin", "geofence_min_seconds", "geofence_grace")
)
"""The defaults that ship."""
Events = list[tuple[int, int]]
"""At which samples: 1 entered or crossed, -1 left."""


@dataclass(frozen=True)
class Course:
    """One border: an area's ring, a gate's (an area nobody can stay in), or a line."""

    kind: str
    points: list[tuple[float, float]]


@dataclass
class Score:
    """What was told of some walks.

    Attributes:
        crossings: clear ones, in truth.
        missed: of these, how many nobody was told of.
        duplicates: enters and crossings told beyond those that were.
        delays: (n,) seconds from the border to being told, of those who walked into an area.
    """

    crossings: int = 0
    missed: int = 0
    duplicates: int = 0
    delays: list[float] = field(default_factory=list)

    def add(self, other: Score) -> None:
        """Add another's."""
        self.crossings += other.crossings
        self.missed += other.missed
        self.duplicates += other.duplicates
        self.delays += other.delays


def eth_walks(least: float = 2.0) -> list[Array]:
    """Return the walks of the ETH recording, (n, 2) at ``RATE``."""
    recording = eth_recording()
    return _cut(recording.t, recording.position, least)


def simulated_walks(seconds: float, seed: int, scenario: str = "museum", least: float = 2.0) -> list[Array]:
    """Return the walks of the twin's visitors, (n, 2) at ``RATE``."""
    world, site = load(scenario)
    record = record_world(world, site, seed, seconds=seconds, motion=False)[site.areas[0].id]
    return _cut(record.truth.t, record.truth.position, least, most_gap=2.5 * TRUTH_EVERY)


def loiterers(courses: Sequence[Course], count: int, seconds: float, seed: int) -> list[Array]:
    """Return people who stand about a border, up to ``CLEAR`` inside or outside, and sway."""
    random = np.random.default_rng(seed)
    walks = []
    for _ in range(count):
        course = courses[int(random.integers(len(courses)))]
        ring = (shapely.LineString if course.kind == "line" else shapely.LinearRing)(course.points)
        ends = AT_ENDS if course.kind == "line" else 0.0
        at = float(random.uniform(ends, ring.length - ends))
        here, there = ring.interpolate(at), ring.interpolate((at + 0.01) % ring.length)
        along = np.array([there.x - here.x, there.y - here.y])
        across = np.array([-along[1], along[0]]) / max(float(np.hypot(*along)), 1e-9)
        middle = np.array([here.x, here.y]) + random.uniform(-CLEAR, CLEAR) * across
        t = np.arange(round(seconds * RATE)) / RATE
        sway = 0.03 * np.sin(2.0 * math.pi * (random.uniform(0.2, 0.6) * t + random.uniform()))
        walks.append(middle + sway[:, None] * across)
    return walks


def courses_over(walks: Sequence[Array], seed: int) -> list[Course]:
    """Return areas of three metres, gates of 20 cm and lines all over where people walk, turned at random."""
    random = np.random.default_rng(seed)
    low = np.min([walk.min(axis=0) for walk in walks], axis=0)
    high = np.max([walk.max(axis=0) for walk in walks], axis=0)
    courses = []
    kinds = ("area", "line", "area", "gate")
    number = 0
    for x in np.arange(low[0] + 1.5, high[0], 3.0):
        for y in np.arange(low[1] + 1.5, high[1], 3.0):
            kind = kinds[number % len(kinds)]
            number += 1
            angle = random.uniform(0.0, math.pi)
            along = np.array([math.cos(angle), math.sin(angle)])
            across = np.array([-along[1], along[0]])
            half = {"area": 1.3, "gate": 0.1, "line": 0.0}[kind]
            middle, reach = np.array([x, y]), 1.3 if kind == "area" else 2.0
            if kind == "line":
                corners = [middle - reach * along, middle + reach * along]
            else:
                ends = [(-reach, -half), (reach, -half), (reach, half), (-reach, half)]
                corners = [middle + a * along + b * across for a, b in ends]
            courses.append(Course(kind, [(float(a), float(b)) for a, b in corners]))
    return courses


def score_walks(walks: Sequence[Array], courses: Sequence[Course], seed: int) -> tuple[Score, Score]:
    """Return what was told of the walks by the geofence, and by the plain method."""
    random = np.random.default_rng(seed)
    measured = [walk + random.normal(0.0, SIGMA, walk.shape) for walk in walks]
    index = ZoneIndex(
        [course.points for course in courses],
        ["floor"] * len(courses),
        MARGIN + SURE * MOST_SPREAD,
        [course.kind == "line" for course in courses],
    )
    told = _told(index, measured)
    plain = _told_plainly(courses, measured)
    ours, naive = Score(), Score()
    for number, walk in enumerate(walks):
        for border, course in enumerate(courses):
            depth = index.depth(np.full(len(walk), border), walk[:, 0], walk[:, 1])
            clear, allowed = _truth(course, depth, walk)
            _judge(ours, told[number, border], clear, allowed)
            _judge(naive, plain[number, border], clear, allowed)
    return ours, naive


def _told(index: ZoneIndex, measured: Sequence[Array]) -> dict[tuple[int, int], Events]:
    """Return what was told by the geofence, by walk and border."""
    crossings = Crossings(Borders(index, MARGIN, MIN_SECONDS), GRACE)
    told: dict[tuple[int, int], Events] = defaultdict(list)
    covariance = np.array([SIGMA**2, 0.0, SIGMA**2])
    for sample in range(max(len(walk) for walk in measured)):
        there = np.array([number for number, walk in enumerate(measured) if sample < len(walk)], np.int64)
        place = np.array([measured[number][sample] for number in there])
        count = len(there)
        happened = crossings.step(
            sample / RATE,
            there,
            np.zeros(count, np.int64),
            place[:, 0],
            place[:, 1],
            covariance=np.tile(covariance, (count, 1)),
        )
        for one in happened:
            told[one.track, one.border].append((sample, -1 if one.kind == "exit" else 1))
    return told


def _told_plainly(courses: Sequence[Course], measured: Sequence[Array]) -> dict[tuple[int, int], Events]:
    """Return the same by asking each position alone if it lies in the polygon, and each step if it cuts the line."""
    told: dict[tuple[int, int], Events] = defaultdict(list)
    for border, course in enumerate(courses):
        shape = shapely.LineString(course.points) if course.kind == "line" else shapely.Polygon(course.points)
        shapely.prepare(shape)
        for number, walk in enumerate(measured):
            if course.kind == "line":
                steps = shapely.linestrings(np.stack([walk[:-1], walk[1:]], axis=1))
                told[number, border] = [
                    (one, 1) for one in (np.flatnonzero(shapely.intersects(shape, steps)) + 1).tolist()
                ]
                continue
            inside = np.concatenate([[False], shapely.contains_xy(shape, walk[:, 0], walk[:, 1])]).astype(int)
            change = np.diff(inside)
            told[number, border] = [(int(one), int(change[one])) for one in np.flatnonzero(change)]
    return told


@dataclass(frozen=True, slots=True)
class _Clear:
    """One crossing nobody can doubt: clearly on this side until ``earliest``, of the border at ``crossed``, and beyond
    it by ``CLEAR`` from ``clear`` on.
    """

    earliest: int
    crossed: int
    clear: int
    walked_in: bool


def _truth(course: Course, depth: Array, walk: Array) -> tuple[list[_Clear], int]:
    """Return the clear crossings of a border, and how many there may have been at most."""
    if course.kind != "area":
        return _through(course, depth, walk)
    clear: list[_Clear] = []
    since = 0
    stayed = round(STAYED * RATE)
    for start in _runs(depth >= CLEAR, stayed):
        before = depth[since:start]
        came = bool(_runs(before <= -CAME, stayed))
        if clear and not came:
            continue
        outside, beyond = np.flatnonzero(before <= -CAME), np.flatnonzero(before < 0.0)
        earliest = since + int(outside[-1]) if len(outside) else 0
        crossed = since + int(beyond[-1]) + 1 if len(beyond) else start
        clear.append(_Clear(earliest, crossed, start, came and start - crossed <= WALKS_IN * RATE))
        since = start
    return clear, len(_runs(depth > -SLACK, 1))


def _through(course: Course, depth: Array, walk: Array) -> tuple[list[_Clear], int]:
    first, last = np.array(course.points[0]), np.array(course.points[1])
    if course.kind == "gate":
        # The middle between its two long sides.
        first, last = (first + course.points[3]) / 2.0, (last + course.points[2]) / 2.0
    length = float(np.hypot(*(last - first)))
    along = (last - first) / length
    offset = walk - first
    side, place = along[0] * offset[:, 1] - along[1] * offset[:, 0], offset @ along
    changes = np.flatnonzero((side[1:] >= 0.0) != (side[:-1] >= 0.0)) + 1
    stayed = round(STAYED * RATE)
    far = CAME if course.kind == "line" else 2.5 * SIGMA + MARGIN
    clear = []
    for change in changes.tolist():
        before, after = side[max(change - 3 * stayed, 0) : change], side[change : change + 3 * stayed]
        sign = 1.0 if side[change] >= 0.0 else -1.0
        came, goes = _runs(-sign * before >= far, stayed), _runs(sign * after >= far, stayed)
        straight = (sign * after >= 0.0).all() and (sign * before <= 0.0).all()
        if came and goes and straight and AT_ENDS <= place[change] <= length - AT_ENDS:
            clear.append(_Clear(change - round(RATE), change, change + goes[0], False))
    near_ends = (place[changes] >= -AT_ENDS) & (place[changes] <= length + AT_ENDS)
    passes = int(near_ends.sum())
    return clear, passes if course.kind == "line" else max(passes, len(_runs(depth > -AT_ENDS, 1)))


def _judge(score: Score, told: Events, clear: Sequence[_Clear], allowed: int) -> None:
    score.crossings += len(clear)
    score.duplicates += max(0, sum(change > 0 for _, change in told) - allowed)
    left = [sample for sample, change in told if change > 0]
    for one in clear:
        latest = one.clear + LATEST * RATE
        answer = next((sample for sample in left if one.earliest <= sample <= latest), None)
        if answer is None:
            score.missed += 1
            continue
        left.remove(answer)
        if one.walked_in:
            score.delays.append(max(answer - one.crossed, 0) / RATE)


def _runs(mask: NDArray[np.bool_], least: int) -> list[int]:
    """Return where runs of at least so many true samples begin."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], mask, [False]]).astype(np.int8)))
    return [int(start) for start, end in zip(edges[::2], edges[1::2], strict=True) if end - start >= least]


def _cut(t: Array, position: Array, least: float, most_gap: float = 0.5) -> list[Array]:
    """Return each stretch of each of (n, p, 2) walks without gaps, at ``RATE``."""
    walks = []
    for person in range(position.shape[1]):
        there = np.flatnonzero(np.isfinite(position[:, person, 0]))
        for stretch in np.split(there, np.flatnonzero(np.diff(t[there]) > most_gap) + 1):
            if len(stretch) < 2 or t[stretch[-1]] - t[stretch[0]] < least:
                continue
            when = np.arange(t[stretch[0]], t[stretch[-1]], 1.0 / RATE)
            walks.append(
                np.column_stack([np.interp(when, t[stretch], position[stretch, person, axis]) for axis in (0, 1)])
            )
    return walks
