"""Stretches: cut where they should be, with what phones said meanwhile, after revisions and once only."""

from __future__ import annotations

import numpy as np

from services.learning.tracks.assembler import StretchAssembler
from shared.messages import MotionBatch, RadioScan, Revision, TrackFrame

T0 = 1000.0


def _frame(t: float, rows: list[tuple[int, float, str | None, str]]) -> TrackFrame:
    count = len(rows)
    return TrackFrame(
        t=T0 + t,
        area="hall",
        chunk=int(t * 15),
        tracker="test",
        track=[row[0] for row in rows],
        floor=["ground"] * count,
        x=[row[1] for row in rows],
        y=[0.0] * count,
        covariance=[(0.04, 0.0, 0.04)] * count,
        vx=[0.0] * count,
        vy=[0.0] * count,
        state=[row[3] for row in rows],  # type: ignore[misc]
        device=[row[2] for row in rows],
        probability=[0.9] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[] for _ in rows],
        sources=[[] for _ in rows],
        quality=[1.0] * count,
    )


def _walked(assembler: StretchAssembler, seconds: float, track: int = 7, start: float = 0.0) -> None:
    for k in range(round(seconds * 15)):
        t = start + k / 15
        assembler.take_frame(_frame(t, [(track, t, "phone", "confirmed"), (9, 5.0, None, "coasting")]), {track: 0.1})


def test_a_stretch_holds_what_the_phone_said_meanwhile() -> None:
    assembler = StretchAssembler(["a", "b"])
    _walked(assembler, 20.0)
    assembler.take_scan(RadioScan(t=T0 + 10.0, device="phone", seq=1, access_point=["b", "c"], rssi=[-50.0, -60.0]))
    assembler.take_motion(
        MotionBatch(
            t=T0 + 6.0, device="phone", seq=1, t_start=T0 + 4.0, activity="walking", step_t=[T0 + 5.0], length=[0.7],
            length_variance=[0.01], heading=[0.1], heading_variance=[0.2], walk=3, magnetic=[51.0],
        )
    )  # fmt: skip
    assert assembler.close() == []  # it still goes on
    [stretch] = assembler.close(T0 + 60.0)
    assert (stretch.device, stretch.track) == ("phone", 7)
    assert abs(stretch.seconds - 20.0) < 0.4
    assert np.diff(stretch.t).min() > 0.19
    assert stretch.seen.all()
    assert abs(stretch.sight.sum() - 0.1 * 20 * 15) < 0.5
    assert (stretch.point.tolist(), stretch.level.tolist()) == ([1], [-50.0])
    np.testing.assert_allclose(stretch.scan_place, [[10.0, 0.0]], atol=1e-6)
    np.testing.assert_allclose(stretch.scan_spread, [0.2])
    assert (stretch.length.tolist(), stretch.walk.tolist(), stretch.magnetic.tolist()) == ([0.7], [3], [51.0])
    assert assembler.close(T0 + 100.0) == []


def test_stretches_end_with_their_track_and_after_a_minute() -> None:
    assembler = StretchAssembler(["a"])
    _walked(assembler, 70.0)
    _walked(assembler, 10.0, track=8, start=70.0)
    closed = assembler.close(T0 + 200.0)
    assert [stretch.track for stretch in closed] == [7, 7, 8]
    assert abs(closed[0].seconds - 60.0) < 0.3
    assert closed[1].t[0] > closed[0].t[-1]


def test_a_revision_takes_a_name_from_one_track_to_another() -> None:
    assembler = StretchAssembler(["a"])
    _walked(assembler, 10.0)
    at = [T0 + 4.0 + k / 5 for k in range(30)]
    revision = Revision(
        t=T0 + 10.0, area="hall", chunk=1, tracker="test", device=["phone"], since=[T0 + 4.0], of=[0] * 30, at=at,
        track=[9] * 30, x=[5.0] * 30, y=[0.0] * 30, covariance=[(0.04, 0.0, 0.04)] * 30, probability=[0.8] * 30,
    )  # fmt: skip
    assembler.take_revision(revision)
    first, second = assembler.close(T0 + 60.0)
    assert (first.track, second.track) == (7, 9)
    assert first.t[-1] < T0 + 4.0
    assert not second.seen.any()
    np.testing.assert_allclose(second.place[:, 0], 5.0)


def test_steps_told_again_replace_the_old_ones() -> None:
    assembler = StretchAssembler(["a"])
    _walked(assembler, 10.0)

    def told(steps: list[float], since: float | None) -> MotionBatch:
        count = len(steps)
        return MotionBatch(
            t=T0 + 9.0, device="phone", seq=1, t_start=T0 + 1.0, activity="walking", step_t=steps,
            length=[0.7] * count, length_variance=[0.01] * count, heading=[0.0] * count,
            heading_variance=[0.1] * count, revises_from=since,
        )  # fmt: skip

    assembler.take_motion(told([T0 + 2.0, T0 + 3.0, T0 + 4.0], None))
    assembler.take_motion(told([T0 + 3.5], T0 + 2.5))
    [stretch] = assembler.close(T0 + 60.0)
    assert stretch.step_t.tolist() == [T0 + 2.0, T0 + 3.5]


def test_who_withdraws_teaches_nothing_and_memory_is_bounded() -> None:
    assembler = StretchAssembler(["a"], settle=5.0)
    for start in range(0, 300, 10):
        _walked(assembler, 10.0, start=float(start))
        assembler.close()
    assert len(assembler._crowd) < 5 * (60 + 20)
    assembler.forget("phone")
    assert assembler.close(T0 + 1000.0) == []


def test_a_clock_set_back_begins_anew() -> None:
    assembler = StretchAssembler(["a"])
    _walked(assembler, 10.0, start=500.0)
    _walked(assembler, 10.0)
    [stretch] = assembler.close(T0 + 60.0)
    assert stretch.t[-1] < T0 + 11.0


def test_a_silent_fusion_and_clocks_ahead_leave_nothing_behind() -> None:
    assembler = StretchAssembler(["a"])
    for second in range(5000):
        name = f"phone-{second % 20}"
        assembler.take_scan(RadioScan(t=T0 + second, device=name, seq=second, access_point=["a"], rssi=[-50.0]))
        if second % 100 == 0:
            assert assembler.close() == []
    assert sum(len(phone.readings) for phone in assembler._phones.values()) < 350


def test_nothing_said_is_lost_when_stretches_are_asked_for_late() -> None:
    assembler = StretchAssembler(["a"])
    for second in range(200):
        _walked(assembler, 1.0, start=float(second))
        assembler.take_scan(RadioScan(t=T0 + second, device="phone", seq=second, access_point=["a"], rssi=[-50.0]))
    closed = assembler.close()
    assert sum(len(stretch.level) for stretch in closed) >= 175


def test_nothing_said_before_a_clock_was_set_back_is_left() -> None:
    assembler = StretchAssembler(["a"])
    _walked(assembler, 20.0, start=5000.0)
    assembler.take_scan(RadioScan(t=T0 + 5010.0, device="phone", seq=1, access_point=["a"], rssi=[-50.0]))
    _walked(assembler, 20.0, track=8)
    [stretch] = assembler.close(T0 + 100.0)
    assert (stretch.track, len(stretch.level)) == (8, 0)
    assert abs(stretch.seconds - 20.0) < 0.4
