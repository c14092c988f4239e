"""The study's perturbations change what they say, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest
from baseline_world import VIEW, make_site, sighted

from benchmarks.blocked_path import blocked_path_error
from benchmarks.perturbations import accompanied, crowded, cut, occluded, random_rectangle, thinned, turned
from benchmarks.world_record import Truth, WorldRecord
from services.fusion.forces import ForceSettings
from shared.messages import MotionBatch, RadioScan

T0 = 1000.0


def record() -> WorldRecord:
    """Return ten seconds: one person walks east at 1 m/s at y = 4, another stands at (9, 8); one phone."""
    frames = [sighted(T0 + second, [(1.0 + second, 4.0), (9.0, 8.0)]) for second in range(10)]
    scans = [
        RadioScan(t=T0 + second + 0.3, device="p", seq=second, access_point=["ap-0"], rssi=[-50.0 - second])
        for second in range(10)
    ]
    motions = [
        MotionBatch(
            t=T0 + second + 1.0,
            t_start=T0 + second,
            device="p",
            seq=second,
            activity="walking",
            step_t=[T0 + second + 0.5],
            length=[1.0],
            length_variance=[0.01],
            heading=[0.1],
            heading_variance=[0.03],
            other_heading=[3.0],
            other_probability=[0.2],
        )
        for second in range(9)
    ]
    times = T0 + np.arange(10.0)
    position = np.stack([np.column_stack([1.0 + np.arange(10.0), np.full(10, 4.0)]), np.full((10, 2), 8.5)], axis=1)
    return WorldRecord(
        site=make_site(),
        area="yard",
        arrivals=sorted([(one.t + 0.1, one) for one in [*frames, *scans, *motions]], key=lambda arrival: arrival[0]),
        frames=frames,
        scans={"p": scans},
        motions={"p": motions},
        truth=Truth(times, ["one", "two"], ["p", None], position, np.ones((10, 2), np.bool_)),
        view=VIEW,
    )


def test_a_hidden_rectangle_hides_what_is_in_it_and_nothing_else() -> None:
    before, after = record(), occluded(record(), (3.5, 3.0, 6.5, 5.0))
    counts = [len(frame.x) for frame in after.frames]
    assert counts == [2, 2, 2, 1, 1, 1, 2, 2, 2, 2]
    assert all(len(frame.box) == len(frame.x) and 9.0 in frame.x for frame in after.frames)
    assert [t for t, _ in after.arrivals] == [t for t, _ in before.arrivals]
    assert after.scans == before.scans
    assert after.motions == before.motions
    assert len(before.frames[3].x) == 2


@pytest.mark.parametrize("share", [0.0, 0.25, 0.6, 1.0])
def test_a_random_rectangle_has_its_share_and_lies_in_view(share: float) -> None:
    low, high = VIEW.min(axis=0), VIEW.max(axis=0)
    for seed in range(20):
        left, lower, right, upper = random_rectangle(VIEW, share, np.random.default_rng(seed))
        assert (right - left) * (upper - lower) == pytest.approx(share * np.prod(high - low))
        assert low[0] <= left <= right <= high[0] + 1e-9
        assert low[1] <= lower <= upper <= high[1] + 1e-9


def test_the_future_is_pasted_into_every_frame() -> None:
    after = crowded(record(), [3.0])
    assert [len(frame.x) for frame in after.frames] == [4] * 10
    assert after.frames[2].x == [3.0, 9.0, 6.0, 9.0]
    assert after.frames[7].x[2] == pytest.approx(2.0)  # the record begins anew after its end
    assert [frame.t for frame in after.frames] == [frame.t for frame in record().frames]


def test_company_brings_its_phones() -> None:
    after = accompanied(record(), [3.0])
    assert [scan.rssi[0] for scan in after.scans["p-1"]] == [-50.0 - second for second in range(3, 10)]
    first = after.motions["p-1"][0]
    assert first.t == pytest.approx(first.t_start + 1.0)
    assert first.step_t == pytest.approx([first.t_start + 0.5])
    assert after.scans["p"] == record().scans["p"]
    assert [t for t, _ in after.arrivals] == sorted(t for t, _ in after.arrivals)


def test_headings_err_within_the_range_to_one_side() -> None:
    before, after = record(), turned(record(), 20.0, 30.0, np.random.default_rng(1))
    errors = np.degrees(
        [b.heading[0] - a.heading[0] for a, b in zip(before.motions["p"], after.motions["p"], strict=True)]
    )
    assert (np.abs(errors) >= 20.0).all()
    assert (np.abs(errors) <= 30.0).all()
    assert len(np.unique(np.sign(errors))) == 1
    assert len(np.unique(errors)) > 1
    others = [np.degrees(batch.other_heading[0] - 3.0) for batch in after.motions["p"]]
    np.testing.assert_allclose(others, errors)
    assert after.scans == before.scans


def test_one_frame_in_so_many_is_left() -> None:
    after = thinned(record(), 4)
    assert [frame.t - T0 for frame in after.frames] == [0.0, 4.0, 8.0]
    assert len(after.scans["p"]) == 10


def test_a_cut_record_ends_for_sensors_and_truth_alike() -> None:
    after = cut(record(), 4.0)
    assert len(after.truth.t) == len(after.frames) == 4
    assert len(after.scans["p"]) == 4
    assert max(t for t, _ in after.arrivals) < T0 + 4.0


def test_contact_keeps_a_prediction_out_of_what_blocks_its_way() -> None:
    """The study: about 0.6 m without contact."""
    through, stopped = (
        blocked_path_error(ForceSettings(contact=contact), 400, np.random.default_rng(0)) for contact in (0.0, 250.0)
    )
    assert 0.4 < through < 0.8
    assert stopped < 0.95 * through
