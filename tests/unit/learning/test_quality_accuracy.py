"""Self-reported accuracy: right shares from evidence that came afterwards, errors near the truth, bounded memory."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_site
from numpy.typing import NDArray
from unit.learning.walking_crowd import POINTS, Crowd

from services.learning.accuracy.claims import Claim, claim_of
from services.learning.accuracy.name_shares import right_probabilities
from services.learning.accuracy.self_report import SelfReport
from services.learning.tracks.quality import QualityJudge
from shared.messages import MotionBatch, RadioScan, TrackFrame
from shared.site import camera_views

T0 = 1000.0


@pytest.mark.parametrize("right", [0.5, 0.8, 0.95])
def test_the_share_of_right_names_is_found_though_fusion_told_another(right: float) -> None:
    rng = np.random.default_rng(0)
    true = rng.random(600) < right
    fits = true ^ (rng.random(600) < 0.05)  # now and then what comes afterwards misleads
    ratio = np.where(fits, rng.normal(2.0, 2.0, 600), rng.normal(-2.0, 2.0, 600))  # log of N(2, 2) over N(−2, 2)
    found = right_probabilities(np.full(600, 0.7), ratio)
    assert found.mean() == pytest.approx(true.mean(), abs=0.05)
    assert found[true].mean() > found[~true].mean() + 0.2


def test_without_evidence_what_fusion_told_stands() -> None:
    told = np.array([0.55, 0.7, 0.8, 0.95])
    np.testing.assert_allclose(right_probabilities(told, np.zeros(4)), told)


def test_a_track_that_passes_to_somebody_else_later_does_not_decide_that_its_name_was_wrong() -> None:
    ratios: dict[str, list[float]] = {"right": [], "wrong": [], "passed on": []}
    for seed in range(8):
        crowd = Crowd(seed, seconds=20)
        crowd.bias[:] = 0.0
        early = crowd.t[:, None] < 6.0
        ways = {"right": None, "wrong": crowd.paths[1], "passed on": np.where(early, crowd.paths[0], crowd.paths[1])}
        for kind, way in ways.items():
            stretch = crowd.stretch(0, 1 if kind == "wrong" else None, path=way)
            judge = QualityJudge(POINTS)
            claim = claim_of(stretch, crowd.radio, None, judge.belief("phone-0"), np.zeros((0, 2)))
            ratios[kind].append(claim.ratio)
            assert claim.weight.sum() == pytest.approx(1.0)
    right, wrong, passed = (np.median(ratios[kind]) for kind in ("right", "wrong", "passed on"))
    assert right > 3.0
    assert wrong < -6.0 < passed


def _frame(t: float, places: NDArray[np.float64], names: list[str | None]) -> TrackFrame:
    count = len(places)
    return TrackFrame(
        t=t, area="hall", chunk=int(t * 15), tracker="test", track=list(range(1, count + 1)), floor=["g"] * count,
        x=places[:, 0].tolist(), y=places[:, 1].tolist(), covariance=[(0.01, 0.0, 0.01)] * count,
        vx=[0.0] * count, vy=[0.0] * count, state=["confirmed"] * count, device=names, probability=[0.8] * count,
        runner_up=[None] * count, runner_up_probability=[0.0] * count, former=[[]] * count, sources=[[]] * count,
        quality=[1.0] * count,
    )  # fmt: skip


def _told(crowd: Crowd, wrong: int) -> tuple[SelfReport, float]:
    """Feed a minute in which the names of ``wrong`` pairs of people are exchanged; return the true error as well."""
    report, judge = SelfReport(crowd.radio.names, np.zeros((0, 2))), QualityJudge(POINTS)
    people = len(crowd.paths)
    names: list[str | None] = [f"phone-{person}" for person in range(people)]
    carrier = list(range(people))
    for pair in range(wrong):
        names[2 * pair], names[2 * pair + 1] = names[2 * pair + 1], names[2 * pair]
        carrier[2 * pair], carrier[2 * pair + 1] = carrier[2 * pair + 1], carrier[2 * pair]
    stretches = [crowd.stretch(person) for person in range(people)]
    squares: list[float] = []
    for second in range(61):
        row = 5 * second
        for stretch in stretches:
            heard = np.flatnonzero(stretch.scan_t == float(second))
            report.take_scan(
                RadioScan(
                    t=T0 + second, device=stretch.device, seq=second,
                    access_point=[crowd.radio.names[k] for k in stretch.point[heard]],
                    rssi=stretch.level[heard].tolist(),
                )
            )  # fmt: skip
            step = (stretch.step_t > second - 1) & (stretch.step_t <= second)
            report.take_motion(
                MotionBatch(
                    t=T0 + second, device=stretch.device, seq=second, t_start=T0 + second - 1.0,
                    activity="walking" if step.any() else "still", step_t=(T0 + stretch.step_t[step]).tolist(),
                    length=stretch.length[step].tolist(), length_variance=stretch.length_variance[step].tolist(),
                    heading=stretch.heading[step].tolist(),
                    heading_variance=stretch.heading_variance[step].tolist(),
                )
            )  # fmt: skip
        places = crowd.paths[:, row]
        noisy = places + crowd.rng.normal(0.0, 0.1, places.shape)
        report.take_frame(_frame(T0 + second, noisy, names))
        report.judge(crowd.radio, None, judge.belief)
        squares += ((noisy - places[carrier]) ** 2).sum(axis=1).tolist()
    return report, float(np.sqrt(np.mean(squares)))


@pytest.mark.parametrize("wrong", [0, 2])
def test_reported_and_true_error_agree(wrong: int) -> None:
    crowd = Crowd(11)
    crowd.bias[:] = 0.0
    report, true = _told(crowd, wrong)
    told = report.report()
    assert told.rms is not None
    assert told.p50 is not None
    assert told.right == pytest.approx(1.0 - 2 * wrong / 8, abs=0.15)
    assert told.named == pytest.approx(1.0, abs=0.05)
    assert told.seconds == pytest.approx(61 * 8)
    if wrong:
        assert told.rms == pytest.approx(true, rel=0.5)
    else:
        assert told.p50 == pytest.approx(0.12, abs=0.04)


@pytest.mark.parametrize(("wrong", "told"), [(0.02, True), (0.13, False), (0.4, True)])
def test_the_p90_is_told_only_where_the_share_of_wrong_names_decides_it(wrong: float, told: bool) -> None:
    report, rng = SelfReport(("a",), np.zeros((0, 2))), np.random.default_rng(0)
    for number in range(400):
        ratio = -8.0 if rng.random() < wrong else 8.0
        report._claims.append(Claim(T0 + number, 0.9, 0.02, ratio, np.array([3.0]), np.ones(1)))
    found = report.report()
    assert (found.p90 is not None) == told
    assert found.rms is not None
    if found.p90 is not None:
        assert found.p90 == pytest.approx(0.21 if wrong < 0.1 else 3.0, rel=0.25)


def test_nothing_is_reported_before_enough_names_were_judged_and_withdrawn_phones_are_forgotten() -> None:
    report = SelfReport(("a",), np.zeros((0, 2)))
    assert report.report().rms is None
    judge = QualityJudge(POINTS)
    crowd = Crowd(3)
    for second in range(500):
        report.take_frame(_frame(T0 + second, crowd.paths[:, 5 * (second % 60)], ["phone-0"] + [None] * 7))
        report.take_scan(RadioScan(t=T0 + second, device="phone-0", seq=second, access_point=["a"], rssi=[-50.0]))
        report.judge(crowd.radio, None, judge.belief)
    assert len(report._pictures) < 40
    assert len(report._phones["phone-0"].readings) < 70
    report.forget("phone-0")
    assert not report._phones
    assert not any("phone-0" in picture.named for picture in report._pictures)
    report.take_frame(_frame(T0, crowd.paths[:, 0], [None] * 8))  # a clock set back
    assert len(report._pictures) == 1


def test_names_nobody_tells_any_more_leave_no_readings_behind() -> None:
    report = SelfReport(("a",), np.zeros((0, 2)))
    for second in range(2000):  # of a fusion that is silent
        name = f"phone-{second % 20}"
        report.take_scan(RadioScan(t=T0 + second, device=name, seq=second, access_point=["a"], rssi=[-50.0]))
    assert sum(len(phone.readings) for phone in report._phones.values()) < 70


def test_a_site_tells_where_no_camera_looks(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    report = SelfReport.of(site, "hall")
    views, plan = camera_views(site, "hall"), site.floor(site.area("hall").floor).plan()
    assert len(report._elsewhere)
    assert plan.contains(report._elsewhere).all()
    assert (views.everywhere.depth_at(report._elsewhere) <= 0.0).all()
