"""Real walks through all of dead reckoning: the step counter recordings (CC BY 4.0) and shopping-mall traces (MIT)."""

from pathlib import Path

import numpy as np
import pytest

from benchmarks.mall_reckoning import heading_errors, reckon
from benchmarks.mall_traces import Trace, load_traces
from benchmarks.step_recordings import best_lag, matched_steps, read_recordings
from services.gateway.reckoning.dead_reckoning import Carrying, DeadReckoner, InertialSamples, Walk
from services.gateway.reckoning.hops import RATE


@pytest.fixture(scope="module")
def traces(data_folder: Path) -> list[Trace]:
    return load_traces(data_folder)[::2]


@pytest.mark.parametrize(
    ("carrying", "names"),
    [
        ("hand", ["Pixel_Jamie_Hard_InHand_1", "Samsung_Carmelo_Hard_InHand_1", "Samsung_Dario_Hard_InHand_1"]),
        ("pocket", ["Samsung_Carmelo_Hard_BackPocket_2", "Pixel_Jamie_Hard_FrontPocket_1"]),
        ("bag", ["Samsung_Carmelo_Hard_Purse_1", "Pixel_Jamie_Hard_Purse_1"]),
    ],
)
def test_steps_of_real_walks_are_told_once_each(data_folder: Path, carrying: Carrying, names: list[str]) -> None:
    recordings = read_recordings(data_folder, names)
    phones, reckoner = [Walk(carrying) for _ in recordings], DeadReckoner(0.0)
    samples = [
        InertialSamples(1e9 + r.t + np.arange(len(r.acceleration)) / RATE, r.acceleration, None, None)
        for r in recordings
    ]
    told = [a + b for a, b in zip(reckoner.advance(phones, samples), reckoner.finish(phones), strict=True)]
    for recording, motions in zip(recordings, told, strict=True):
        found = np.concatenate([m.step_t for m in motions]) - 1e9
        matched = matched_steps(found + best_lag(found, recording.steps), recording.steps)
        assert abs(len(found) / len(recording.steps) - 1.0) < 0.06, recording.name
        assert 2.0 * matched / (len(found) + len(recording.steps)) > 0.95, recording.name


def test_real_walks_head_the_way_their_legs_do(traces: list[Trace]) -> None:
    errors = np.concatenate([heading_errors(*pair) for pair in zip(traces, reckon(traces), strict=True)])
    errors = np.abs(errors[np.isfinite(errors)])
    assert len(errors) >= 40
    assert np.degrees(np.median(errors)) < 9.0


def test_real_hands_are_not_taken_for_pockets(traces: list[Trace]) -> None:
    """What nobody has told of a phone changes no heading of a surveyor who holds it flat."""
    few, reckoner = traces[::4], DeadReckoner(0.0)
    samples = [InertialSamples(one.t + 1e9, one.acceleration, one.rotation, one.field) for one in few]
    known, found = ([Walk(c) for _ in few] for c in ("hand", "unknown"))
    for one, other in zip(reckoner.advance(known, samples), reckoner.advance(found, samples), strict=True):
        for a, b in zip(one, other, strict=True):
            np.testing.assert_array_equal(a.heading, b.heading)


def test_real_corners_are_told_with_their_side(traces: list[Trace]) -> None:
    """Legs that differ by 60 to 120 degrees: four in five turns are told to that side within 5 s of the way-point."""
    corners, told = 0, 0
    for trace in traces:
        phone = Walk("hand")
        (motions,) = DeadReckoner(0.0).advance(
            [phone], [InertialSamples(trace.t + 1e9, trace.acceleration, trace.rotation, trace.field)]
        )
        t = np.concatenate([m.turn_t for m in motions]) - 1e9
        angle = np.concatenate([m.turn for m in motions])
        legs = trace.legs()
        for k in range(1, len(legs.heading)):
            turn = np.angle(np.exp(1j * (legs.heading[k] - legs.heading[k - 1])))
            if np.radians(60) < abs(turn) < np.radians(120) and min(legs.length[k - 1 : k + 1]) > 4.0:
                corners += 1
                near = np.abs(t - legs.begin[k]) < 5.0
                told += bool(np.any(near & (np.abs(angle - turn) < np.radians(35))))
    assert corners >= 15
    assert told / corners > 0.8
