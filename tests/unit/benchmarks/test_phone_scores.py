"""Located trajectories and names of phones, with known answers."""

import numpy as np
import pytest
from msgspec.structs import replace
from track_frames import frame

from benchmarks.people_followed import NOBODY
from benchmarks.phone_scores import PhoneScore, followed, score_phones
from benchmarks.revised import said_live
from benchmarks.world_record import Truth
from shared.messages import TrackFrame

# Ann stands at 0 with phone a and leaves after five of ten seconds; Eve, without one, stands at 3.
T = 1000.0 + np.arange(10.0)
PLACES = {1: (0.1, 0.0), 2: (3.1, 0.0)}


def people() -> Truth:
    position = np.full((10, 2, 2), np.nan)
    position[:5, 0], position[:, 1] = (0.0, 0.0), (3.0, 0.0)
    return Truth(T, ["ann", "eve"], ["a", None], position, np.isfinite(position[..., 0]))


def score(frames: list[TrackFrame]) -> PhoneScore:
    truth = people()
    return score_phones(truth, followed(truth, frames), said_live(T, ["a"], frames, fresh=0.5))


def test_all_right() -> None:
    found = score([frame(t, PLACES, {1: "a"}) for t in T[:5].tolist()])
    figures = found.figures("x")
    assert (figures["idf1_x"], figures["precision_x"], figures["recall_x"]) == (1.0, 1.0, 1.0)
    assert figures["error_p90_x"] == pytest.approx(0.1)
    assert figures["seconds_to_identify_x"] == 0.0


def test_a_name_on_a_stranger_is_claimed_found_nowhere_and_wrong() -> None:
    found = score([frame(t, PLACES, {2: "a"}) for t in T.tolist()])
    assert (found.found[0], found.claimed[0], found.present[0]) == (0, 10, 5)
    assert (found.right[0], found.named[0]) == (0, 10)
    assert found.figures("x")["never_identified_x"] == 1.0
    assert found.figures("x")["seconds_to_identify_x"] is None


def test_a_name_that_stays_behind_when_its_carrier_left_lowers_f1() -> None:
    found = score([frame(t, PLACES if t < 1005 else {2: (3.1, 0.0)}, {1: "a", 2: "a"}) for t in T.tolist()])
    assert found.f1 == pytest.approx(2 * 5 / (10 + 5))


def unseen(t: float, sigma: float, x: float = 0.5) -> TrackFrame:
    whole = frame(t, {7: (x, 0.0)}, {7: "a"})
    return replace(whole, state=["unseen"], covariance=[(sigma**2, 0.0, sigma**2)])


def test_a_place_without_a_camera_is_a_claim_only_if_it_says_that_it_is_exact() -> None:
    exact = score([unseen(t, 0.9) for t in T[:5].tolist()])
    assert (exact.found[0], exact.claimed[0], exact.named[0]) == (5, 5, 0)
    rough = score([unseen(t, 1.5, x=7.0) for t in T.tolist()])
    assert (rough.found[0], rough.claimed[0]) == (0, 0)


@pytest.mark.parametrize("seen", [True, False])
def test_a_wrong_claim_counts_wherever_its_carrier_is_and_a_right_one_out_of_view_neither_way(seen: bool) -> None:
    # Ann is known to stand at 0 for two seconds after she left the view; where she is later nobody knows.
    truth = people()
    position = truth.position.copy()
    position[5:7, 0] = 0.0, 0.0
    known = Truth(T, truth.person, truth.device, position, truth.in_view)

    def claims(x: float) -> PhoneScore:
        frames = [frame(t, {7: (x, 0.0)}, {7: "a"}) if seen else unseen(t, 0.9, x) for t in T.tolist()]
        return score_phones(known, followed(known, frames), said_live(T, ["a"], frames, fresh=0.5))

    right, wrong = claims(0.5), claims(7.0)
    assert (right.found[0], right.claimed[0], right.present[0]) == (5, 5 + 3, 5)
    assert (wrong.found[0], wrong.claimed[0]) == (0, 10)
    assert right.f1 == pytest.approx(2 * 5 / (8 + 5))
    assert right.figures("x")["idf1_x_in_view"] == pytest.approx(2 * 5 / (10 + 5) if seen else 1.0)


def test_whom_a_track_follows_is_decided_by_the_second_around() -> None:
    # For one of ten frames a second the tracks come to lie the other way round, as where people cross.
    t = 1000.0 + np.arange(30) / 10.0
    position = np.broadcast_to(np.array([[0.0, 0.0], [0.8, 0.0]]), (30, 2, 2)).copy()
    truth = Truth(t, ["ann", "bob"], ["a", "b"], position, np.ones((30, 2), np.bool_))
    straight, crossed = {1: (0.0, 0.0), 2: (0.8, 0.0)}, {1: (0.8, 0.0), 2: (0.0, 0.0)}
    frames = [frame(when, crossed if row == 15 else straight) for row, when in enumerate(t.tolist())]
    whom = followed(truth, frames)
    assert [whom.whom(1, 15), whom.whom(2, 15)] == [0, 1]
    assert whom.whom(3, 15) == NOBODY


def test_scores_of_several_runs_stand_side_by_side() -> None:
    right = score([frame(t, PLACES, {1: "a"}) for t in T[:5].tolist()])
    wrong = score([frame(t, PLACES, {2: "a"}) for t in T[:5].tolist()])
    both = PhoneScore.together([right, wrong])
    assert both.f1 == pytest.approx(0.5)
    assert both.figures("x")["precision_x"] == pytest.approx(0.5)
