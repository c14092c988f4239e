"""When chunks close, and what happens to what comes late, twice, from the past or the future."""

from collections.abc import Iterable

import numpy as np
import pytest
from fusion_world import frame
from hypothesis import given, settings
from hypothesis import strategies as st

from services.fusion.chunks import PERIOD, Chunker, Closed
from shared.messages import MotionBatch, RadioScan


def feed(chunker: Chunker, times: Iterable[float], camera: str = "west", start: int = 0) -> list[Closed]:
    closed: list[Closed] = []
    for number, t in enumerate(times, start):
        closed += chunker.add_frame(frame(t, camera=camera, seq=number), f"{camera}-{number}")
    return closed


def scan(t: float, device: str = "a") -> RadioScan:
    return RadioScan(t=t, device=device, seq=0, access_point=["ap-1"], rssi=[-50.0])


@pytest.mark.parametrize("rate", [2.0, 7.0, 10.0, 15.0])
def test_a_lone_camera_closes_its_chunk_at_once(rate: float) -> None:
    chunker = Chunker()
    feed(chunker, [100.0 + n / rate for n in range(5)])
    for number in range(5, 60):
        closed = chunker.add_frame(frame(100.0 + number / rate, seq=number), str(number))
        assert [one.consumed for one in closed] == [(str(number),)]


def test_two_cameras_close_a_chunk_as_soon_as_both_delivered() -> None:
    chunker = Chunker()
    for number in range(60):
        t = 100.0 + number / 15
        first = chunker.add_frame(frame(t + 0.01, camera="west"), f"w{number}")
        second = chunker.add_frame(frame(t + 0.02, camera="east"), f"e{number}")
        if number > 3:
            assert first == []
            assert [one.consumed for one in second] == [(f"w{number}", f"e{number}")]


def test_a_camera_that_fell_silent_holds_the_others_up_by_no_more_than_the_lateness() -> None:
    chunker = Chunker()
    for number in range(15):
        feed(chunker, [100.0 + number / 15], "west", number)
        feed(chunker, [100.0 + number / 15 + 0.01], "east", number)
    latest = 0.0
    for number in range(15, 90):
        t = 100.0 + number / 15
        for one in feed(chunker, [t], "west", number):
            latest = max(latest, t - one.chunk.t_end)
    assert latest <= chunker.settings.lateness + 2 * PERIOD
    # Two seconds on it is not waited for at all.
    closed = feed(chunker, [100.0 + 90 / 15], "west", 90)
    assert closed[-1].chunk.frames[-1].seq == 90


def test_a_late_frame_goes_into_the_next_chunk_and_a_very_late_one_is_counted() -> None:
    chunker = Chunker()
    feed(chunker, [100.0 + n / 10 for n in range(5)], "east")
    closed = feed(chunker, [100.0 + n / 15 for n in range(12)], "west")
    assert closed[-1].chunk.t_end > 100.52
    closed = feed(chunker, [100.51], "east", 5) + feed(chunker, [100.0 + 12 / 15], "west", 12)
    (home,) = [one.chunk for one in closed if "east-5" in one.consumed]
    assert home.t_start > 100.51
    feed(chunker, [100.0 + n / 15 for n in range(13, 40)], "west", 13)
    feed(chunker, [101.0], "east", 6)
    assert chunker.dropped == {"frame too late": 1}


def test_a_camera_whose_frames_all_come_in_a_burst_after_the_others_sets_nobodys_clock() -> None:
    chunker = Chunker()
    feed(chunker, [100.0], "east")
    closed = feed(chunker, [100.0 + n / 10 for n in range(80)], "west")
    closed += feed(chunker, [100.1 + n / 10 for n in range(79)], "east", 1)
    indices = [one.chunk.index for one in closed]
    assert indices == sorted(set(indices))
    assert chunker.dropped["frame too late"] > 60


def test_twice_and_backwards_are_counted_by_reason() -> None:
    chunker = Chunker()
    feed(chunker, [100.0, 100.1, 100.1, 100.05, float("nan")])
    assert chunker.dropped == {"frame twice": 1, "time went backwards": 1, "frame without a time": 1}


def test_one_frame_from_tomorrow_is_dropped_but_a_clock_that_was_set_is_followed() -> None:
    chunker = Chunker()
    feed(chunker, [100.0, 100.1, 86_500.0, 100.2, 100.3])
    assert chunker.dropped == {"frame from the far future": 1}
    closed = feed(chunker, [86_500.0 + n / 10 for n in range(5)])
    assert closed[-1].chunk.frames[-1].t == pytest.approx(86_500.4)
    closed = feed(chunker, [200.0 + n / 10 for n in range(5)])
    assert closed[-1].chunk.frames[-1].t == pytest.approx(200.4)


def test_a_camera_with_a_wrong_clock_does_not_carry_the_others_away() -> None:
    chunker = Chunker()
    closed = []
    for number in range(100):
        t = 100.0 + number / 10
        closed += feed(chunker, [t], "west", number)
        feed(chunker, [t + 86_400.0], "east", number)
    assert len(closed) >= 95
    assert chunker.dropped["frame from the far future"] >= 95


def test_a_camera_whose_clock_is_ahead_takes_over_when_the_other_dies() -> None:
    chunker = Chunker()
    for number in range(300):
        feed(chunker, [100.0 + number / 15], "east", number)
        feed(chunker, [110.0 + number / 15], "west", number)
    closed = feed(chunker, [110.0 + number / 15 for number in range(300, 900)], "west", 300)
    assert len(closed) >= 560


def test_a_straggler_of_a_camera_that_died_in_an_outage_does_not_stall_the_other_for_ever() -> None:
    chunker = Chunker()
    for number in range(150):
        for camera in ("west", "east"):
            feed(chunker, [100.0 + number / 15], camera, number)
    feed(chunker, [113.0], "west", 150)
    feed(chunker, [110.1], "east", 150)
    closed = feed(chunker, [113.0 + number / 15 for number in range(1, 300)], "west", 151)
    assert len(closed) >= 260


@pytest.mark.parametrize("jitter", [0.0, 0.01, 0.15])
@pytest.mark.parametrize("rate", [0.6, 0.5, 0.45, 0.3, 0.1])
def test_a_lone_camera_is_followed_however_slow_it_is(rate: float, jitter: float) -> None:
    rng = np.random.default_rng(1)
    chunker = Chunker()
    closed = feed(chunker, [1000.0 + (n + jitter * rng.uniform(-1, 1)) / rate for n in range(200)])
    assert len(closed) >= 195
    assert sum(chunker.dropped.values()) <= 3
    # Its clock may be set as well.
    for t0 in (1e6, 5000.0):
        assert len(feed(chunker, [t0 + n / rate for n in range(50)])) >= 46


def test_two_slow_cameras_are_followed_and_a_slow_one_is_not_overruled_by_a_wrong_clock() -> None:
    chunker = Chunker()
    closed = []
    for number in range(100):
        closed += feed(chunker, [1000.0 + number / 0.3], "west", number)
        closed += feed(chunker, [1001.0 + number / 0.3], "east", number)
    assert sum(len(one.chunk.frames) for one in closed) >= 190
    chunker = Chunker()
    feed(chunker, [1000.0 + number / 0.4 for number in range(10)], "west")
    for number in range(500):
        t = 1025.0 + number / 10
        if number % 25 == 0:
            feed(chunker, [t], "west", number)
        assert feed(chunker, [t + 86_400.0], "east", number) == []


def test_both_cameras_come_back_after_an_outage() -> None:
    chunker = Chunker()
    closed = []
    for t0 in (100.0, 400.0):
        for number in range(60):
            for camera in ("west", "east"):
                closed += feed(chunker, [t0 + number / 10 + (0.01 if camera == "east" else 0.0)], camera, number)
    assert closed[-1].chunk.t_end > 405.0
    # What is lost is at most the time it takes to believe the jump.
    assert sum(chunker.dropped.values()) <= 50


def test_chunks_without_a_frame_are_not_emitted_and_radio_is_not_waited_for() -> None:
    chunker = Chunker()
    chunker.add_scan(scan(99.9), "s1")
    closed = feed(chunker, [100.0])
    chunker.add_scan(scan(94.0), "s2")
    chunker.add_scan(scan(90.0), "s3")
    chunker.add_scan(scan(2e9), "s4")
    chunker.add_motion(MotionBatch(t=100.0, t_start=99.0, device="a", seq=0, activity="still"), "m1")
    chunker.add_motion(MotionBatch(t=float("nan"), t_start=99.0, device="a", seq=0, activity="still"), "m2")
    closed += feed(chunker, [103.0, 103.5], start=1)
    closed += feed(chunker, [103.6, 103.7], start=3)
    assert all(one.chunk.frames for one in closed)
    assert [name for one in closed for name in one.consumed if name[0] in "sm"] == ["s1", "m1"]
    assert chunker.dropped["radio too old"] == 2
    assert chunker.dropped["radio from the far future"] == 1
    assert chunker.dropped["motion without a time"] == 1


def test_phones_without_cameras_do_not_fill_the_memory() -> None:
    chunker = Chunker()
    for number in range(chunker.settings.capacity + 100):
        chunker.add_scan(scan(100.0), str(number))
    assert chunker.dropped == {"radio waiting for cameras": 100}


def test_a_restored_chunker_does_not_close_a_chunk_twice() -> None:
    chunker = Chunker()
    before = feed(chunker, [100.0 + n / 15 for n in range(10)])
    after = Chunker()
    after.resume_after(before[-1].chunk.index)
    closed = feed(after, [100.0 + n / 15 for n in range(8, 20)])
    assert min(one.chunk.index for one in closed) > before[-1].chunk.index


@settings(deadline=None, max_examples=80)
@given(
    st.lists(
        st.tuples(st.sampled_from(["west", "east", "north"]), st.floats(0.0, 0.4), st.floats(-0.3, 0.3)), max_size=120
    )
)
def test_whatever_comes_chunks_grow_and_every_frame_is_consumed_counted_or_waiting(
    arrivals: list[tuple[str, float, float]],
) -> None:
    chunker, now, closed = Chunker(), 1000.0, []
    for number, (camera, gap, jitter) in enumerate(arrivals):
        now += gap
        closed += chunker.add_frame(frame(now + jitter, camera=camera, seq=number), str(number))
    indices = [one.chunk.index for one in closed]
    assert indices == sorted(set(indices))
    consumed = [name for one in closed for name in one.consumed]
    assert len(consumed) == len(set(consumed))
    assert len(consumed) + sum(chunker.dropped.values()) + chunker.waiting == len(arrivals)
    for one in closed:
        assert all(f.t < one.chunk.t_end + 1e-5 for f in one.chunk.frames)
        assert [f.t for f in one.chunk.frames] == sorted(f.t for f in one.chunk.frames)
