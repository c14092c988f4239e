"""A server cannot look quick by leaving batches unanswered."""

import numpy as np

from benchmarks.gateway_load import Outcome
from benchmarks.http_askers import percentiles_ms


def test_batches_never_answered_take_for_ever() -> None:
    assert percentiles_ms([0.004] * 100, wanted=100) == (4.0, 4.0)
    p50, p99 = percentiles_ms([0.004] * 98, wanted=100)
    assert p50 == 4.0
    assert np.isinf(p99)


def test_batches_never_answered_are_counted() -> None:
    assert Outcome(10, {"200": 6, "503": 1}, 1.0, 1.0, 1.0, 1).unanswered() == 3
