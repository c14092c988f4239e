"""What phones said is kept for a while, whatever their clocks say and whether fusion works or not."""

from __future__ import annotations

from services.learning.tracks.phones import Phones
from shared.messages import MotionBatch, RadioScan

T0 = 1000.0


def _scan(t: float, device: str = "phone") -> RadioScan:
    return RadioScan(t=T0 + t, device=device, seq=1, access_point=["a"], rssi=[-50.0])


def _step(t: float, at: float) -> MotionBatch:
    return MotionBatch(
        t=T0 + t, device="phone", seq=1, t_start=T0 + t - 1.0, activity="walking", step_t=[T0 + at], length=[0.7],
        length_variance=[0.01], heading=[0.1], heading_variance=[0.2],
    )  # fmt: skip


def _still(t: float) -> MotionBatch:
    return MotionBatch(t=T0 + t, device="phone", seq=1, t_start=T0 + t - 1.0, activity="still")


def test_a_phone_is_bounded_by_its_own_time() -> None:
    phones = Phones(["a"], 60.0)
    for second in range(5000):
        phones.take_scan(_scan(second))
        phones.take_motion(_still(second) if second % 2 else _step(second, second))
    rows = phones["phone"]
    assert 60 <= len(rows.readings) <= 75
    assert len(rows.steps) + len(rows.still) <= 75


def test_who_has_been_silent_for_long_is_forgotten_without_any_frame() -> None:
    phones = Phones(["a"], 60.0)
    for second in range(1000):
        phones.take_scan(_scan(second, f"phone-{second // 10}"))
    assert len(phones) < 10


def test_times_far_ahead_of_everybody_are_left_out() -> None:
    phones = Phones(["a"], 60.0)
    phones.take_time(T0)
    for second in range(500):
        phones.take_scan(_scan(1e9 + second, f"phone-{second}"))
        phones.take_motion(_step(10.0, 1e9))
    assert not phones
    phones.take_scan(_scan(10.0))
    assert list(phones) == ["phone"]


def test_a_wrong_clock_that_spoke_first_is_forgotten_once_the_area_tells_its_time() -> None:
    phones = Phones(["a"], 60.0)
    phones.take_scan(_scan(1e9, "ahead"))
    phones.take_time(T0)
    phones.take_scan(_scan(1.0))
    assert list(phones) == ["phone"]
    assert len(phones["phone"].readings) == 1
