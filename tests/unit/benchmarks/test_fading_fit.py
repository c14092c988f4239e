"""The law by which simulated people fade is the one that was measured, and the measurement can be repeated."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.fading_fit import observe
from benchmarks.result import read_figures
from services.simulator.cameras.fading import FITTED, FadingLaw


def test_the_constants_of_the_simulator_are_the_stored_ones() -> None:
    figures = read_figures("fading-fit")
    for name in FadingLaw.__slots__:
        assert getattr(FITTED, name) == pytest.approx(figures[name], rel=0.02, abs=0.003), name


def test_the_law_agrees_with_what_was_measured_at_every_rate() -> None:
    figures = read_figures("fading-fit")
    for rate in (0.003, 0.01, 0.03, 0.1, 0.3):
        assert figures[f"law_half_time_s_{rate:g}"] == pytest.approx(figures[f"half_time_s_{rate:g}"], rel=0.2)


def test_a_rendered_clip_at_a_fast_rate_fades_as_the_law_says() -> None:
    clip = observe(0.3, "steep", 7)
    half = FITTED.fade_at + FITTED.fade_delay / (1.0 + 0.3 * FITTED.fidget_time)
    half_time = -np.log(1.0 - half) / 0.3
    standing = clip.standing >= 0.0
    assert clip.found[standing & (clip.standing < 0.6 * half_time)].mean() > 0.85
    assert clip.found[standing & (clip.standing > 2.0 * half_time)].mean() < 0.2
    # Who stood long leaves a ghost for a moment, who stood briefly none.
    longest, shortest = int(np.argmax(clip.stay)), int(np.argmin(clip.stay))
    assert clip.found[clip.left[:, longest] < 1.8, longest].any()
    assert not clip.found[clip.left[:, longest] > 3.0, longest].any()
    assert not clip.found[clip.left[:, shortest] > 1.5, shortest].any()
