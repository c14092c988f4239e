"""A phone's walk against the paths of the people followed, and its state."""

from typing import Literal

import msgspec
import numpy as np

from services.fusion.rbmcda.walk_evidence import WalkEvidence
from services.fusion.snapshot import encode_snapshot
from shared.messages import MotionBatch

LINKS = np.array([7, 9])


def batch(seq: int, t: float, activity: Literal["still", "walking"], steps: int = 0) -> MotionBatch:
    """Steps of 0.6 m along x, two a second."""
    ends = [t - 2.0 + 0.5 * (k + 1) for k in range(steps)]
    return MotionBatch(
        device="phone",
        seq=seq,
        t_start=t - 2.0,
        t=t,
        activity=activity,
        step_t=ends,
        length=[0.6] * steps,
        length_variance=[0.01] * steps,
        heading=[0.0] * steps,
        heading_variance=[0.05] * steps,
        walk=1,
    )


def followed(evidence: WalkEvidence, begin: float, end: float) -> None:
    """Link 7 walks along x from t = 4 to 8 and stands before and after, link 9 walks along y when 7 stands."""
    for t in np.arange(begin, end, 0.2).tolist():
        ahead = 1.2 * min(max(t - 4.0, 0.0), 4.0)
        aside = 1.2 * (min(t, 4.0) + max(t - 8.0, 0.0))
        evidence.follow(t, LINKS, np.array([[ahead, 0.0], [5.0, aside]]))


def test_who_walks_as_the_phone_says_is_favoured() -> None:
    evidence = WalkEvidence()
    followed(evidence, 0.0, 10.1)
    evidence.take(batch(0, 2.0, "still"))
    evidence.take(batch(1, 4.0, "still"))
    evidence.take(batch(2, 6.0, "walking", 4))
    evidence.take(batch(3, 8.0, "walking", 4))
    total = evidence.of_cycle(["phone"], 8.5, LINKS)[0]
    assert total[0] > 1.0
    assert total[1] < -4.0


def test_a_stretch_counts_once_and_not_before_its_end_is_worked_on() -> None:
    evidence = WalkEvidence()
    followed(evidence, 0.0, 10.1)
    evidence.take(batch(0, 6.0, "walking", 4))
    assert not evidence.of_cycle(["phone"], 4.2, LINKS).any()
    assert evidence.of_cycle(["phone"], 6.5, LINKS).any()
    assert not evidence.of_cycle(["phone"], 7.5, LINKS).any()


def test_a_link_without_a_path_and_a_device_without_a_walk_get_nothing() -> None:
    evidence = WalkEvidence()
    followed(evidence, 0.0, 10.1)
    evidence.take(batch(0, 6.0, "walking", 4))
    found = evidence.of_cycle(["other", "phone"], 6.5, np.array([8, 7]))
    assert not found[0].any()
    assert found[1, 0] == 0.0
    assert found[1, 1] != 0.0


def test_a_restored_one_goes_on_alike() -> None:
    evidence, restored = WalkEvidence(), WalkEvidence()
    followed(evidence, 0.0, 7.0)
    evidence.take(batch(0, 6.0, "walking", 4))
    evidence.of_cycle(["phone"], 5.1, LINKS)
    restored.restore(msgspec.json.decode(encode_snapshot(evidence.state())))
    for one in (evidence, restored):
        followed(one, 7.0, 9.0)
        one.take(batch(1, 8.0, "walking", 4))
    np.testing.assert_array_equal(evidence.of_cycle(["phone"], 9.0, LINKS), restored.of_cycle(["phone"], 9.0, LINKS))


def test_standing_told_again_is_no_new_evidence() -> None:
    once, again = WalkEvidence(), WalkEvidence()
    for evidence in (once, again):
        followed(evidence, 0.0, 10.1)
        assert evidence.take(batch(0, 2.0, "still"))
        assert evidence.take(batch(1, 4.0, "still"))
    restored = WalkEvidence()
    restored.restore(msgspec.json.decode(encode_snapshot(again.state())))
    expected = once.of_cycle(["phone"], 4.5, LINKS)
    assert expected.any()
    for evidence in (again, restored):
        assert not evidence.take(batch(2, 4.0, "still"))
        assert not evidence.take(batch(3, 3.0, "still"))
        np.testing.assert_array_equal(evidence.of_cycle(["phone"], 4.5, LINKS), expected)


def test_who_is_forgotten_leaves_no_walk() -> None:
    evidence = WalkEvidence()
    followed(evidence, 0.0, 10.1)
    evidence.take(batch(0, 6.0, "walking", 4))
    evidence.of_cycle(["phone"], 6.5, LINKS)
    evidence.forget("phone")
    assert "phone" not in str(evidence.state())
    assert np.isnan(evidence._filters.last).all()
    assert not evidence._filters.bias.any()
