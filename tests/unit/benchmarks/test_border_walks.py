"""The scoring of borders: what was clearly crossed must be told, and what is told beyond it is a duplicate."""

import numpy as np

from benchmarks.border_walks import RATE, Course, loiterers, score_walks

SQUARE = Course("area", [(-2.0, -2.0), (2.0, -2.0), (2.0, 2.0), (-2.0, 2.0)])
LINE = Course("line", [(0.0, -4.0), (0.0, 4.0)])


def straight(start: tuple[float, float], end: tuple[float, float], speed: float = 1.3) -> np.ndarray:
    seconds = float(np.hypot(end[0] - start[0], end[1] - start[1])) / speed
    return np.linspace(start, end, round(seconds * RATE))


def test_walks_through_are_counted_and_told_by_both_but_once_by_one() -> None:
    walks = [straight((-6.0, y), (6.0, y)) for y in np.linspace(-1.0, 1.0, 10)]
    ours, naive = score_walks(walks, [SQUARE, LINE], seed=1)
    assert ours.crossings == naive.crossings == 20
    assert (ours.missed, ours.duplicates) == (0, 0)
    assert naive.missed == 0
    assert naive.duplicates > 10
    assert len(ours.delays) == 10
    assert max(ours.delays) <= 1.0


def test_who_passes_by_crosses_nothing() -> None:
    ours, _ = score_walks([straight((-6.0, 4.5), (6.0, 4.5))], [SQUARE, LINE], seed=2)
    assert (ours.crossings, ours.missed, ours.duplicates) == (0, 0, 0)


def test_who_stands_on_a_border_is_told_once_at_most() -> None:
    ours, naive = score_walks(loiterers([SQUARE], 5, 60.0, seed=3), [SQUARE], seed=3)
    assert ours.duplicates == 0
    assert naive.duplicates > 100
