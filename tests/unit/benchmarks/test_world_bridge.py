"""From the twin to the tracker nothing may be gained or lost: chunks, late phones, access points, surveys, scores."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import twin_scores
from benchmarks.fusion_run import chunks_of
from benchmarks.identity_metrics import IdentityScore
from benchmarks.twin_scores import TwinScores, figures_of, score_twin
from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import EPOCH, load, record_world, with_access_points
from benchmarks.world_survey import survey_world
from services.fusion.area_view import AreaView
from services.simulator.phones.fleet import Flushes
from services.simulator.radio.radio_changes import PowerChange
from shared.messages import DetectionFrame, RadioScan
from shared.radio import RadioLearner, RadioModel

SCENARIO, SITE = load("museum")
NOBODY = Truth(np.array([EPOCH]), [], [], np.zeros((1, 0, 2)), np.zeros((1, 0), bool))


def record_of(arrivals: list[tuple[float, DetectionFrame | RadioScan]]) -> WorldRecord:
    frames = [message for _, message in arrivals if isinstance(message, DetectionFrame)]
    return WorldRecord(SITE, "hall", arrivals, frames, {}, {}, NOBODY, np.zeros((3, 2)))


def frame(t: float, number: int) -> DetectionFrame:
    return DetectionFrame(t=EPOCH + t, camera="gallery", floor="ground", seq=number)


@pytest.mark.parametrize("rate", [2.0, 7.0, 10.0, 15.0, 25.0, 30.0])
def test_every_frame_is_in_one_chunk_whatever_the_rate(rate: float) -> None:
    frames = [frame(number / rate, number) for number in range(200)]
    chunks = list(chunks_of(record_of([(one.t, one) for one in frames])))
    held = [one.seq for chunk in chunks for one in chunk.frames]
    # The last frames wait for one that never comes.
    assert held == list(range(len(held)))
    assert len(held) >= 200 - max(1, round(rate / 15.0)) - 1
    assert [chunk.index for chunk in chunks] == sorted({chunk.index for chunk in chunks})


def test_what_a_phone_tells_late_enters_late_and_after_five_seconds_not_at_all() -> None:
    scans = [
        (10.0, RadioScan(t=EPOCH + 9.5, device="prompt", seq=0, access_point=["ap-1"], rssi=[-50.0])),
        (10.0, RadioScan(t=EPOCH + 8.0, device="slow", seq=0, access_point=["ap-1"], rssi=[-50.0])),
        (10.0, RadioScan(t=EPOCH + 2.0, device="flush", seq=0, access_point=["ap-1"], rssi=[-50.0])),
    ]
    arrivals = sorted(
        [(EPOCH + 0.1 * number, frame(0.1 * number, number)) for number in range(150)]
        + [(EPOCH + t, scan) for t, scan in scans],
        key=lambda arrival: arrival[0],
    )
    entered = {scan.device: chunk.t_end for chunk in chunks_of(record_of(arrivals)) for scan in chunk.scans}
    assert set(entered) == {"prompt", "slow"}
    assert min(entered.values()) > EPOCH + 9.9


def test_a_world_with_late_phones_reaches_the_tracker_late() -> None:
    fleet = SCENARIO.phones[0].model_copy(update={"upload": Flushes(every=30.0), "batch_seconds": 5.0})
    late = SCENARIO.model_copy(update={"phones": [fleet]})
    record = record_world(late, SITE, SCENARIO.seeds.train, seconds=60.0, motion=False)["hall"]
    delays = [t - message.t for t, message in record.arrivals if isinstance(message, RadioScan)]
    assert max(delays) > 15.0
    heard = sum(len(chunk.scans) for chunk in chunks_of(record))
    assert 0 < heard < 0.5 * len(delays)
    assert [t for t, _ in record.arrivals] == sorted(t for t, _ in record.arrivals)


def test_fewer_access_points_are_fewer_everywhere() -> None:
    record = record_world(SCENARIO, SITE, SCENARIO.seeds.train, seconds=10.0, motion=False)["hall"]
    fewer = with_access_points(record, ["ap-1", "ap-3"])
    assert [point.id for point in fewer.site.access_points] == ["ap-1", "ap-3"]
    by_arrival = {name for _, m in fewer.arrivals if isinstance(m, RadioScan) for name in m.access_point}
    by_device = {name for scans in fewer.scans.values() for scan in scans for name in scan.access_point}
    assert by_arrival == by_device == {"ap-1", "ap-3"}


def test_a_survey_knows_nothing_of_what_changes_later() -> None:
    changed = SCENARIO.model_copy(
        update={
            "radio": SCENARIO.radio.model_copy(
                update={"changes": [PowerChange(at=0.0, kind="power", access_point="ap-1", by=30.0)]}
            )
        }
    )
    before, after = (survey_world(one, SITE, "hall", 3, samples=4, spacing=3.0) for one in (SCENARIO, changed))
    np.testing.assert_array_equal(before.readings, after.readings)


def identity(named: int, right: int, first: list[float]) -> IdentityScore:
    one = np.array([10])
    return IdentityScore(
        device=["phone"],
        named=np.array([named]),
        right=np.array([right]),
        in_view=one,
        right_in_view=np.array([right]),
        near=np.array([right]),
        switches=np.array([0]),
        stay=np.zeros(len(first), np.int64),
        first=np.array(first),
        settled=np.array(first),
    )


def test_an_area_that_failed_is_not_forgotten() -> None:
    good, failed = identity(10, 9, [2.0, 2.0]), identity(0, 0, [np.inf, np.inf, np.inf])
    scores = TwinScores(identity=IdentityScore.together([good, failed]))
    figures = figures_of(scores, "trial1")
    assert figures["trial1_id_precision"] == pytest.approx(0.9)
    assert figures["trial1_id_recall"] == pytest.approx(9 / 20)
    assert figures["trial1_never_identified"] == pytest.approx(3 / 5)
    assert figures["trial1_seconds_to_identify"] is None
    assert IdentityScore.together([good, failed]).stay.tolist() == [0, 0, 1, 1, 1]


def test_no_tracker_sees_the_truth() -> None:
    record = record_world(SCENARIO, SITE, SCENARIO.seeds.train, seconds=10.0, motion=False)["hall"]
    blind = replace(record, truth=NOBODY)
    assert list(chunks_of(blind)) == list(chunks_of(record))


def test_other_people_teach_the_radio_of_the_world_that_is_scored(monkeypatch: pytest.MonkeyPatch) -> None:
    made, teachers = [], []

    def recorded(*args: Any, **more: Any) -> dict[str, WorldRecord]:
        made.append(record_world(*args, **more))
        return made[-1]

    def taught_by(record: WorldRecord, tracker: str, rounds: int) -> RadioModel:
        teachers.append(record)
        view = AreaView.of(record.site, record.area)
        return RadioLearner.over(view.radio, view.lower, view.upper).solve(record.site.site)

    monkeypatch.setattr(twin_scores, "record_world", recorded)
    monkeypatch.setattr(twin_scores, "train_radio", taught_by)
    monkeypatch.setattr(twin_scores, "METHODS", {"evidence": "evidence"})
    monkeypatch.setattr(twin_scores, "baseline_window_errors", lambda record, survey: {})
    monkeypatch.setattr(twin_scores, "survey_world", lambda *args, **more: None)
    scores = score_twin("museum", SCENARIO.seeds.train, seconds=10.0, access_points=2, taught=10.0)
    assert {"evidence", "evidence_warm"} == set(scores.errors)
    assert "trial1_p90_evidence_warm" in figures_of(scores, "trial1")
    [scored, taught], [teacher] = [one["hall"].truth for one in made], teachers
    assert teacher.truth is taught
    assert len(teacher.site.access_points) == 2
    assert not np.array_equal(taught.position, scored.position, equal_nan=True)
