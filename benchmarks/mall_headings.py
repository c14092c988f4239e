"""Which way of telling headings follows the mall's legs best? The one that ships beside the phone's own and others."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from benchmarks.mall_reckoning import Walked, reckon
from benchmarks.mall_traces import NORTH, Trace
from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.dead_reckoning import DeadReckoner
from services.gateway.reckoning.gradient_descent import GradientDescentFilter
from services.gateway.reckoning.hand_heading import pointing
from services.gateway.reckoning.hard_iron import HardIron
from services.gateway.reckoning.plan_heading import plan_heading

__all__ = ["rival_headings"]

Array = NDArray[np.float64]

NEVER = 1e9
REACH = 0.5
"""s on either side of a step over which the phone's own rotation vector is averaged, as the gateway does."""


def rival_headings(traces: Sequence[Trace]) -> dict[str, list[Walked]]:
    """Return what other ways of telling headings say of the same steps, by name."""
    plain = reckon(traces)
    return {
        "rotation_vector": [_by_rotation_vector(*pair) for pair in zip(traces, plain, strict=True)],
        "with_iron": reckon(traces, _reckoner(ComplementaryFilter(), iron=False)),
        "thesis": reckon(traces, _reckoner(ComplementaryFilter(compass_tau=0.98), iron=False)),
        "mean_compass": reckon(traces, _reckoner(ComplementaryFilter(compass_tau=600.0), iron=False)),
        "gradient_descent": reckon(traces, _reckoner(GradientDescentFilter())),
    }


def _reckoner(attitude: Attitude, iron: bool = True) -> DeadReckoner:
    return DeadReckoner(NORTH, attitude=attitude, iron=HardIron() if iron else HardIron(doubt=NEVER))


def _by_rotation_vector(trace: Trace, walked: Walked) -> Walked:
    w = np.sqrt(np.maximum(1.0 - np.sum(trace.vector**2, axis=1), 0.0))
    attitude = Rotation.from_quat(np.column_stack([trace.vector, w])).as_matrix()
    ahead = np.concatenate([np.zeros((1, 2)), np.cumsum(pointing(attitude), axis=0)])
    low = np.minimum(np.searchsorted(trace.t, walked.t - REACH), len(trace.t) - 1)
    high = np.maximum(np.searchsorted(trace.t, walked.t + REACH), low + 1)
    east, north = (ahead[high] - ahead[low]).T
    return replace(walked, heading=plan_heading(np.arctan2(east, north), NORTH))
