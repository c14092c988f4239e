"""Bursts of phones' messages, spread over steps."""

import numpy as np
import pytest

from services.fusion.evidence.workload import due_now
from shared.messages import RadioScan


def scan(t: float, device: str = "a") -> RadioScan:
    return RadioScan(t=t, device=device, seq=0, access_point=["ap"], rssi=[-60.0])


def drained(waiting: list[RadioScan], most: int) -> list[list[RadioScan]]:
    steps = []
    while waiting:
        now, waiting = due_now(waiting, 10.0, most, 5_000)
        steps.append(now)
    return steps


def test_a_burst_is_spread_oldest_first_and_nothing_is_lost() -> None:
    burst = [scan(t, f"phone-{t}") for t in np.linspace(9.0, 10.0, 45).tolist()]
    steps = drained(burst[::-1], most=12)
    assert [len(step) for step in steps] == [12, 12, 12, 9]
    assert [one for step in steps for one in step] == burst


def test_a_flood_is_worked_off_all_the_same() -> None:
    """A quarter at a time: thousands that waited behind a stalled camera are done within seconds."""
    steps = drained([scan(float(t), "b") for t in np.linspace(0.0, 10.0, 5_000)], most=12)
    assert len(steps) < 30
    assert len(steps[0]) == 1_250


@pytest.mark.parametrize("order", [[0, 1, 2, 3], [3, 1, 0, 2]])
def test_the_order_of_arrival_means_nothing(order: list[int]) -> None:
    told = [scan(1.0, "b"), scan(1.0, "a"), scan(0.5, "c"), scan(99.0, "d")]
    now, later = due_now([told[one] for one in order], 10.0, 2, 5_000)
    assert [one.device for one in now] == ["c", "a"]
    assert [one.device for one in later] == ["b", "d"]


def test_what_waits_is_bounded() -> None:
    now, later = due_now([scan(20.0 + one) for one in range(50)], 10.0, 12, 20)
    assert now == []
    assert [one.t for one in later] == [50.0 + one for one in range(20)]
