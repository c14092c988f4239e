"""Emulated phones hear and feel what somebody on that path would."""

import math
from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_site
from numpy.typing import NDArray

from benchmarks.phones_on_tracks import (
    AROUND,
    Recording,
    between,
    only_phones,
    phones_on,
    ring_of,
    with_site_points,
    without_motion,
)
from benchmarks.world_record import WorldRecord
from shared.messages import MotionBatch

T = 1000.0 + np.arange(200) / 7.0
SPEED = 0.6


def straight(y: float) -> NDArray[np.float64]:
    return np.column_stack([2.0 + SPEED * (T - T[0]), np.full(len(T), y)])


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    position = np.stack([straight(3.0), straight(9.0)], axis=1)
    position[70:90, 1] = np.nan
    return Recording(make_site(tmp_path), "hall", [], T, ["1", "2"], position)


@pytest.fixture
def record(recording: Recording) -> WorldRecord:
    return phones_on(recording, ["1", "2"], 5)


def test_phones_are_heard_before_and_after_the_view_and_in_its_gaps(record: WorldRecord) -> None:
    for device in ("phone-1", "phone-2"):
        heard = np.array([scan.t for scan in record.scans[device]])
        assert heard[0] < T[0] - AROUND + 1.0
        assert heard[-1] > T[-1] + AROUND - 1.0
        np.testing.assert_allclose(np.diff(heard), 1.0)


def test_where_a_phone_out_of_view_is_heard_its_place_is_known_and_nobody_elses(recording: Recording) -> None:
    away = slice(70, 90)
    truth = phones_on(recording, ["2"], 5).truth
    assert not truth.in_view[away, 1].any()
    np.testing.assert_allclose(truth.position[away, 1], straight(9.0)[away], atol=0.1)
    assert np.isnan(phones_on(recording, ["1"], 5).truth.position[away, 1]).all()
    assert np.isnan(recording.position[away, 1]).all()


def test_steps_add_up_to_the_way_and_point_along_it(record: WorldRecord) -> None:
    inside = [batch for batch in record.motions["phone-1"] if T[0] <= batch.t_start <= T[-1] - 1.0]
    walked = sum(sum(batch.length) for batch in inside)
    assert walked == pytest.approx(SPEED * len(inside), rel=0.3)
    headings = np.array([heading for batch in inside for heading in batch.heading])
    assert abs(np.angle(np.exp(1j * headings).mean())) < math.radians(40.0)
    assert inside[0].heading_variance[0] > inside[0].heading_bias_variance > 0.0


def test_strength_falls_with_distance_from_an_access_point(record: WorldRecord) -> None:
    # The path runs from ap-1's end of the hall to ap-3's.
    levels = [dict(zip(scan.access_point, scan.rssi, strict=True)) for scan in record.scans["phone-1"]]
    early, late = levels[8:14], levels[-20:-14]

    def change(name: str) -> float:
        return float(
            np.mean([one[name] for one in late if name in one]) - np.mean([one[name] for one in early if name in one])
        )

    assert change("ap-3") - change("ap-1") > 8.0


def test_a_persons_phone_does_not_depend_on_who_else_carries_one(recording: Recording, record: WorldRecord) -> None:
    alone = phones_on(recording, ["2"], 5)
    assert only_phones(record, {"phone-2"}).arrivals == alone.arrivals
    assert alone.scans["phone-2"] == record.scans["phone-2"]
    assert alone.motions["phone-2"] == record.motions["phone-2"]
    assert alone.truth.device == [None, "phone-2"]


def test_another_seed_is_another_world(recording: Recording, record: WorldRecord) -> None:
    assert phones_on(recording, ["1"], 6).scans["phone-1"] != record.scans["phone-1"]


def test_a_part_of_a_record_holds_that_time_alone_and_phones_without_steps_tell_of_none(record: WorldRecord) -> None:
    part = between(record, T[50], T[100])
    assert part.truth.t.tolist() == T[50:100].tolist()
    assert all(T[50] <= t < T[100] for t, _ in part.arrivals)
    silent = without_motion(record)
    assert not any(isinstance(message, MotionBatch) for _, message in silent.arrivals)
    assert silent.scans == record.scans


def test_access_points_lie_evenly_on_the_edges(recording: Recording) -> None:
    points = ring_of("ground", (0.0, 0.0), (8.0, 4.0), 6, 3.0)
    assert [point.position[:2] for point in points] == [(0, 0), (4, 0), (8, 0), (8, 4), (4, 4), (0, 4)]
    site = with_site_points(recording.site, points)
    assert [point.id for point in site.access_points] == [f"ap-{number}" for number in range(1, 7)]
