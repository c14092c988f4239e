"""A device's minute told right looks good; told elsewhere, or where no camera sees it, it looks worse."""

from __future__ import annotations

import dataclasses

import msgspec
import numpy as np
import pytest

from benchmarks.device_minutes import device_minutes
from benchmarks.fusion_run import FusionRun
from benchmarks.learning_checks import true_run
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import load, record_world
from shared.messages import TrackFrame

SCENARIO, SITE = load("construction-1")
MINUTE = 10.0


@pytest.fixture(scope="module")
def record() -> WorldRecord:
    return record_world(SCENARIO, SITE, SCENARIO.seeds.train, seconds=21.0, motion=False)["west"]


def _elsewhere(frame: TrackFrame) -> TrackFrame:
    return msgspec.structs.replace(frame, x=[12.0 - x for x in frame.x])


def _unseen(frame: TrackFrame) -> TrackFrame:
    return msgspec.structs.replace(frame, state=["unseen"] * len(frame.track))


def test_quality_falls_where_places_are_wrong_or_no_camera_sees(record: WorldRecord) -> None:
    run = true_run(record)
    wrong, unseen = (
        FusionRun([change(frame) for frame in run.frames], run.revisions, run.seconds)
        for change in (_elsewhere, _unseen)
    )
    right, worse, blind = (device_minutes(record, one, MINUTE) for one in (run, wrong, unseen))
    assert len(right.rmse)
    assert right.rmse.max() < 0.3
    assert np.all(right.named == 1.0)
    assert worse.rmse.mean() > 1.0
    assert worse.printed.mean() < right.printed.mean()
    assert np.all(blind.named == 0.0)
    assert np.all(blind.sight < 0.0)
    for part in dataclasses.fields(right):
        assert getattr(right, part.name).shape == right.rmse.shape
