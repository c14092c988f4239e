"""Which way of telling headings follows the mall's legs best? The one that ships beside the phone's own and others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.mall_reckoning import LEG, Walked, heading_errors, reckon
from benchmarks.mall_traces import NORTH, Trace
from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.dead_reckoning import DeadReckoner
from services.gateway.reckoning.gradient_descent import GradientDescentFilter
from services.gateway.reckoning.hand_heading import pointing
from services.gateway.reckoning.plan_heading import plan_heading

__all__ = ["chosen_headings", "rival_headings"]

Array = NDArray[np.float64]

GRID = [(tau, iron) for tau in (1.0, 5.0, 15.0, 30.0) for iron in (0.0, 3.0, 6.0, 10.0)]
"""Time constants of the compass, s, and sizes of the iron, µT, among which is chosen; the first leaves the iron in."""
REACH = 0.5
"""s on either side of a step over which the phone's own rotation vector is averaged, as the gateway does."""


def chosen_headings(traces: Sequence[Trace]) -> tuple[list[Walked], list[tuple[float, float]]]:
    """Return each trace reckoned with the constants of ``GRID`` that are best on all others, and which those are.

    The best have the least mean error, without sign, of the headings of all legs over ``LEG``: there are more of them
    than of the long ones that are judged, and a mean hops less than a median.
    """
    told = [reckon(traces, _reckoner(ComplementaryFilter(compass_tau=tau), iron, tau)) for tau, iron in GRID]
    errors = [
        [np.abs(heading_errors(*pair, longer=LEG)) for pair in zip(traces, walked, strict=True)] for walked in told
    ]
    sums = np.array([[np.nansum(error) for error in cell] for cell in errors])
    best = np.argmin(sums.sum(axis=1, keepdims=True) - sums, axis=0)
    return [told[cell][trace] for trace, cell in enumerate(best)], [GRID[cell] for cell in best]


def rival_headings(traces: Sequence[Trace]) -> dict[str, list[Walked]]:
    """Return what other ways of telling headings say of the same steps, by name."""
    plain = reckon(traces)
    return {
        "rotation_vector": [_by_rotation_vector(*pair) for pair in zip(traces, plain, strict=True)],
        "with_iron": reckon(traces, _reckoner(ComplementaryFilter(), 0.0)),
        "thesis": reckon(traces, _reckoner(ComplementaryFilter(compass_tau=0.98), 0.0)),
        "mean_compass": reckon(traces, _reckoner(ComplementaryFilter(compass_tau=600.0), 0.0)),
        "gradient_descent": reckon(traces, DeadReckoner(NORTH, attitude=GradientDescentFilter())),
    }


def _reckoner(attitude: Attitude, iron: float, tau: float = 15.0) -> DeadReckoner:
    return DeadReckoner(NORTH, attitude=attitude, calibration=Calibration(iron, tau))


def _by_rotation_vector(trace: Trace, walked: Walked) -> Walked:
    w = np.sqrt(np.maximum(1.0 - np.sum(trace.vector**2, axis=1), 0.0))
    attitude = Rotation.from_quat(np.column_stack([trace.vector, w])).as_matrix()
    ahead = np.concatenate([np.zeros((1, 2)), np.cumsum(pointing(attitude), axis=0)])
    low = np.minimum(np.searchsorted(trace.t, walked.t - REACH), len(trace.t) - 1)
    high = np.maximum(np.searchsorted(trace.t, walked.t + REACH), low + 1)
    east, north = (ahead[high] - ahead[low]).T
    return replace(walked, heading=plan_heading(np.arctan2(east, north), NORTH))
