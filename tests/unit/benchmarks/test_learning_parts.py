"""Parts of a run teach and judge apart; the same people are seen with other detectors; lessons come from stretches."""

from __future__ import annotations

from dataclasses import replace

import msgspec
import numpy as np
import pytest
from track_frames import frame

from benchmarks.fusion_run import FusionRun
from benchmarks.learning_adapter import chosen_rate
from benchmarks.learning_checks import radio_residual, stretch_rmse, stride_errors, true_run
from benchmarks.learning_detections import configured_rate, seen_again, with_detections
from benchmarks.learning_splits import part_of, splits
from benchmarks.learning_stretches import stretches_of
from benchmarks.learning_strides import with_strides
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import EPOCH, load, record_world
from services.fusion.area_view import AreaView
from shared.messages import DetectionFrame, MotionBatch, RadioScan
from shared.walking.stride import StrideLine

SCENARIO, SITE = load("construction-1")
SEED = SCENARIO.seeds.train
SECONDS = 30.0


@pytest.fixture(scope="module")
def record() -> WorldRecord:
    return record_world(SCENARIO, SITE, SEED, seconds=SECONDS)["west"]


def test_splits_of_the_study_fill_a_run_and_no_test_lies_in_its_own_training() -> None:
    made = splits(2700.0)
    assert [split.start for split in made] == [0.0, 225.0, 450.0, 675.0, 900.0]
    assert {(split.turn - split.start, split.end - split.turn) for split in made} == {(1200.0, 600.0)}
    assert made[-1].end == 2700.0


def test_a_run_shorter_than_a_split_is_refused() -> None:
    with pytest.raises(ValueError, match="seconds: 1700; allowed: at least 1800"):
        splits(1700.0)


def test_two_parts_share_nothing_and_together_lack_only_what_came_late(record: WorldRecord) -> None:
    first, second = part_of(record, 0.0, 15.0), part_of(record, 15.0, SECONDS)
    assert not {id(m) for _, m in first.arrivals} & {id(m) for _, m in second.arrivals}
    assert all(message.t >= EPOCH + 15.0 for _, message in second.arrivals)
    assert first.frames[-1].t < EPOCH + 15.0 <= second.frames[0].t
    assert len(first.frames) + len(second.frames) == len(record.frames)
    assert len(first.truth.t) + len(second.truth.t) == len(record.truth.t)


def test_the_same_rate_sees_the_same_and_another_one_changes_nothing_but_detections(record: WorldRecord) -> None:
    rate = configured_rate(SCENARIO)
    same, slow = seen_again(SCENARIO, SITE, SEED, "west", [rate, 0.002], SECONDS)
    assert with_detections(record, same).arrivals == record.arrivals
    other = with_detections(record, slow)

    def phones(one: WorldRecord) -> list[tuple[float, RadioScan | MotionBatch]]:
        return [(t, said) for t, said in one.arrivals if not isinstance(said, DetectionFrame)]

    assert phones(other) == phones(record)
    assert [frame.t for frame in other.frames] == [frame.t for frame in record.frames]
    # Who stands still stays in sight of a background that learns slowly.
    assert sum(len(frame.x) for frame in other.frames) > sum(len(frame.x) for frame in record.frames)
    assert [t for t, _ in other.arrivals] == sorted(t for t, _ in other.arrivals)


def test_a_line_of_the_truth_is_right_and_changes_nothing_but_its_device_s_lengths(record: WorldRecord) -> None:
    walker = max(record.motions, key=lambda device: sum(len(batch.step_t) for batch in record.motions[device]))
    # The twin's law of strides in the mean, over the cadence of a slow walk.
    line = StrideLine(np.array(0.344), np.array(0.05), np.array(0.01))
    [[walking, anyhow]] = stride_errors(record, {walker: line}, fewest=3)
    assert walking < 0.1
    assert anyhow < 0.2
    paced = with_strides(record, {walker: line})
    for (t, before), (again, after) in zip(record.arrivals, paced.arrivals, strict=True):
        assert t == again
        if isinstance(before, MotionBatch) and isinstance(after, MotionBatch) and before.device == walker:
            assert (before.step_t, before.heading, before.seq) == (after.step_t, after.heading, after.seq)
            assert after.length_scale_variance == 0.01
        else:
            assert before is after


def test_perfect_tracks_may_teach_and_nobody_on_a_track_teaches_nothing(record: WorldRecord) -> None:
    view = AreaView.of(record.site, record.area)
    # Names end after a while, so that what they did is settled when the run is over.
    frames = [
        one if one.t < EPOCH + 16.0 else msgspec.structs.replace(one, device=[None] * len(one.track))
        for one in true_run(record).frames
    ]
    judged = list(stretches_of(record, FusionRun(frames, [], []), view))
    assert judged
    assert max(stretch_rmse(stretch, record.truth) for stretch, _ in judged) < 0.05
    nameless = FusionRun([frame(EPOCH + t, {1: (5.0, 5.0)}) for t in np.arange(0.5, 29.0, 0.5)], [], [])
    assert list(stretches_of(record, nameless, view)) == []


def test_the_rate_is_taken_from_the_score_s_top_and_stays_where_the_top_is_chance() -> None:
    rates = (0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
    assert rates[chosen_rate(rates, (1355.0, 1363.0, 1347.0, 1258.0, 877.0, 493.0, 286.0), 0.05)] < 0.02
    assert rates[chosen_rate(rates, (500.0, 501.0, 499.0, 502.0, 500.0, 498.0, 500.0), 0.05)] == 0.05


def test_a_radio_that_is_louder_everywhere_is_no_worse_and_one_that_is_wrong_in_places_is(record: WorldRecord) -> None:
    view = AreaView.of(record.site, record.area)
    rms = [float(np.sqrt(np.mean(radio_residual(record, one) ** 2))) for one in (view, louder(view, 5.0), bent(view))]
    assert rms[1] == pytest.approx(rms[0])
    assert rms[2] > rms[0] + 0.5


def louder(view: AreaView, by: float) -> AreaView:
    return replace(view, radio=replace(view.radio, power_1m=view.radio.power_1m + by))


def bent(view: AreaView) -> AreaView:
    return replace(view, radio=replace(view.radio, exponent=view.radio.exponent + 2.0))
