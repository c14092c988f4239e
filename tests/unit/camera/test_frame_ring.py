"""The ring of small pictures: bounded in every way, even in time, and still while it is asked."""

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.camera.frame_ring import GAP, LONGEST_STILL, TOUCHED, FrameRing, unpack


def noise(seed: int, size: tuple[int, int] = (96, 72)) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 255, (size[1], size[0], 3), np.uint8)


def fill(ring: FrameRing, begin: float, seconds: float, rate: float = 10.0) -> float:
    for number in range(round(seconds * rate)):
        ring.offer(noise(number), begin + number / rate)
    return begin + seconds


@settings(max_examples=20, deadline=None)
@given(st.floats(0.02, 0.2), st.floats(0.02, 0.3), st.lists(st.floats(0.01, 20.0), max_size=80))
def test_bytes_and_minutes_are_bounded_whatever_comes(megabytes: float, minutes: float, steps: list[float]) -> None:
    ring = FrameRing(megabytes, minutes, 10.0)
    t = 1000.0
    for number, step in enumerate(steps):
        ring.offer(noise(number), t := t + step)
        assert ring.held_bytes <= megabytes * 1e6
    kept = ring.ask()
    assert sum(len(frame.jpeg) for frame in kept) == ring.held_bytes
    if kept:
        assert kept[-1].t - kept[0].t <= 60.0 * minutes
        assert (np.diff([frame.t for frame in kept]) < max(GAP, 0.2)).all()


def test_the_oldest_give_way_and_nothing_is_kept_when_it_is_off() -> None:
    ring = FrameRing(0.1, 60.0, 10.0)
    end = fill(ring, 0.0, 20.0)
    kept = ring.ask()
    assert kept[-1].t == pytest.approx(end - 0.1)
    assert kept[0].t > 10.0
    assert not FrameRing(0.0, 5.0, 4.0).offer(noise(1), 1.0)


def test_pictures_are_kept_at_the_rate_asked_for_and_small() -> None:
    ring = FrameRing(64.0, 5.0, 4.0)
    for number in range(250):  # 25 a second are no multiple of 4
        ring.offer(noise(number % 3), number / 25.0)
    kept = ring.ask()
    assert len(kept) == pytest.approx(40, abs=1)
    ring = FrameRing(64.0, 5.0, 4.0)
    ring.offer(cv2.resize(noise(1), (1200, 900)), 1.0)
    assert unpack(ring.ask()[0]).shape == (360, 480, 3)
    assert ring.size == (1200, 900)


def test_a_gap_a_clock_set_back_or_another_size_begin_anew() -> None:
    for image, t in ((noise(1), 30.0), (noise(1), 3.0), (noise(1, (64, 48)), 10.2)):
        ring = FrameRing(64.0, 5.0, 4.0)
        fill(ring, 0.0, 10.0)
        ring.offer(image, t)
        assert [frame.t for frame in ring.ask()] == [t]


def test_it_stands_still_while_it_is_asked_and_goes_on_afterwards() -> None:
    ring = FrameRing(64.0, 5.0, 4.0)
    fill(ring, 0.0, 10.0)
    asked = ring.ask()
    t = 10.0
    while t < LONGEST_STILL + 10.0:
        assert not ring.offer(noise(1), t)
        assert ring.ask() == asked
        t += 0.5 * TOUCHED
    assert ring.offer(noise(2), LONGEST_STILL + 20.0)
    assert len(ring.ask()) == 1


def test_what_is_cleared_is_gone() -> None:
    ring = FrameRing(64.0, 5.0, 4.0)
    fill(ring, 0.0, 5.0)
    ring.clear()
    assert ring.held_bytes == 0
    assert ring.ask() == ()
