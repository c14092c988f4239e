"""The identity filter as a tracker: absurd reports, states that are no numbers, and who came young and went."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from fusion_world import World, frame, make_site

from services.fusion.area_view import AreaView
from services.fusion.rbmcda.followed import FollowedPeople
from services.fusion.rbmcda.settings import RbmcdaSettings
from services.fusion.rbmcda.tracker import RbmcdaTracker
from services.fusion.tracker import Chunk
from shared.messages import TrackFrame
from shared.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


def chunks_of(site: Site, seconds: float) -> list[Chunk]:
    return World(site, seed=2, seconds=seconds, people=3).chunks(period=1.0)


def numbers(tracks: TrackFrame) -> np.ndarray:
    return np.concatenate(
        [np.ravel(column) for column in (tracks.x, tracks.y, tracks.vx, tracks.vy, tracks.covariance)]
    )


@pytest.mark.parametrize(
    "absurd",
    [
        {"length_variance": [1e30] * 2},
        {"heading": [1e300] * 2, "heading_variance": [1e300] * 2},
        {"other_heading": [float("nan"), float("inf")], "other_probability": [0.5] * 2},
        {"step_t": [1e15, 1e16]},
    ],
)
def test_an_absurd_report_costs_its_own_steps_and_no_more(site: Site, absurd: dict[str, list[float]]) -> None:
    tracker = RbmcdaTracker(AreaView.of(site, "hall"), 3)
    for number, one in enumerate(chunks_of(site, 12.0)):
        motions = tuple(
            msgspec.structs.replace(told, **absurd) if told.device == "0" and number == 6 else told
            for told in one.motions
        )
        tracks = tracker.step(replace(one, motions=motions))
        assert np.isfinite(numbers(tracks)).all()
    assert set(tracks.device) == {"0", "1", "2"}
    assert all(xx < 100.0 and yy < 100.0 for xx, _, yy in tracks.covariance)
    newest = tracker._walks["0"].steps[-1][1]
    assert newest > tracks.t - 3.0


def test_a_phone_whose_place_is_no_number_begins_anew(site: Site) -> None:
    tracker = RbmcdaTracker(AreaView.of(site, "hall"), 3)
    *first, poisoned, last, end = chunks_of(site, 12.0)
    for one in first:
        before = tracker.step(one)
    tracker._particles.mean[:, tracker._particles.state[:, before.device.index("0")]] = np.nan
    with np.errstate(invalid="ignore"):
        tracks = tracker.step(poisoned)
    assert sorted(tracks.device, key=str) == ["1", "2"]
    tracker.step(last)
    after = tracker.step(end)
    assert np.isfinite(numbers(after)).all()
    assert set(after.device) == {"0", "1", "2"}
    ids, now = (dict(zip(told.device, told.track, strict=True)) for told in (before, after))
    assert [ids[name] == now[name] for name in "012"] == [False, True, True]
    assert tracker.ignored()["phone whose place was no number"] == 1


def test_a_report_told_twice_is_counted_as_told_again(site: Site) -> None:
    tracker = RbmcdaTracker(AreaView.of(site, "hall"), 3)
    again = 0
    for one in chunks_of(site, 5.0):
        again += len(one.motions[-1:])
        tracker.step(replace(one, motions=(*one.motions, *one.motions[-1:])))
    assert again > 0
    assert tracker.ignored() == {"motion told again or out of order": again}


def test_who_came_young_and_went_was_young_in_the_cycle_before(site: Site) -> None:
    settings = RbmcdaSettings()
    people = FollowedPeople(AreaView.of(site, "hall"), settings)
    seen, _ = people.cycle([frame(100.0 + k / 10, [(12.0, 7.0)], seq=k) for k in range(10)], 100.9)
    assert len(seen.link) == 1
    gone, _ = people.cycle([frame(101.0 + k / 10, [], seq=10 + k) for k in range(30)], 103.9)
    assert len(gone.link) == 0
    assert people.pickup(100.9, seen.link).tolist() == [1.0]
    people.cycle([frame(104.0, [], seq=40)], 104.0)
    assert people.pickup(103.9, seen.link).tolist() == [settings.pickup]
    assert people.state()["told_since"] == []
