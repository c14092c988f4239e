"""What the API tells of tracks and devices: ages, bounds, and which of two claims counts."""

import json
from pathlib import Path

import msgspec
import pytest

from services.api.live_state import LiveState
from shared.messages import Alert, CameraStatus, TrackFrame
from shared.site import load_site


def frame(
    t: float, devices: list[str | None], area: str = "hall", probability: list[float] | None = None
) -> TrackFrame:
    n = len(devices)
    return TrackFrame(
        t=t,
        area=area,
        chunk=0,
        tracker="test",
        track=list(range(n)),
        floor=["ground"] * n,
        x=[10.0 + i for i in range(n)],
        y=[1.0] * n,
        covariance=[(0.04, 0.0, 0.04)] * n,
        vx=[0.0] * n,
        vy=[0.0] * n,
        state=["confirmed"] * n,
        device=devices,
        probability=probability or [0.9] * n,
        runner_up=[None] * n,
        runner_up_probability=[0.0] * n,
        former=[[] for _ in range(n)],
        sources=[[] for _ in range(n)],
        quality=[1.0] * n,
    )


def alert(number: int, zone: str = "entrance") -> Alert:
    return Alert(
        t=float(number), id=f"a-{number}", zone=zone, kind="enter", area="hall", track=1, floor="ground", x=0.0, y=0.0
    )


@pytest.fixture
def live(project: Path) -> LiveState:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    return LiveState(site, positions_kept=60.0, tracks_kept=5.0)


def positions(live: LiveState, now: float) -> list[dict[str, object]]:
    told: list[dict[str, object]] = json.loads(live.positions_json(now))["positions"]
    return told


def test_a_device_out_of_sight_is_lost_with_a_growing_age_and_dropped_at_last(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p"]), origin=100.0)
    live.take_tracks(frame(50.1, [None]), origin=100.1)
    first, later = positions(live, 101.0)[0], positions(live, 130.0)[0]
    assert (first["state"], first["age"], later["age"]) == ("lost", 1.0, 30.0)
    assert positions(live, 161.0) == []
    assert live.position("p", 161.0) is None


def test_ages_grow_without_any_frame(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p"]), origin=100.0)
    assert [positions(live, now)[0]["age"] for now in (100.5, 101.5)] == [0.5, 1.5]


def test_bytes_are_built_once_per_frame_and_not_per_request(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p"]), origin=100.0)
    first = live.positions_json(100.0)
    assert live.positions_json(100.1) is first
    live.take_tracks(frame(50.1, ["p"]), origin=100.1)
    assert live.positions_json(100.1) is not first


def test_of_two_tracks_that_claim_one_device_the_surer_has_it(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p", "p"], probability=[0.4, 0.8]), origin=100.0)
    assert [p["track"] for p in positions(live, 100.0)] == [1]
    live.take_tracks(frame(50.1, ["p", "p"], probability=[0.8, 0.4]), origin=100.1)
    assert [p["track"] for p in positions(live, 100.1)] == [0]


def test_a_late_frame_does_not_turn_time_back_but_a_new_pass_of_a_recording_counts(live: LiveState) -> None:
    assert live.take_tracks(frame(50.0, ["p"]), origin=100.0)
    assert not live.take_tracks(frame(49.9, ["q"]), origin=99.9)
    assert live.take_tracks(frame(1.0, ["q"]), origin=101.0)


def test_a_clock_that_ran_ahead_and_is_set_right_does_not_hide_the_present(live: LiveState) -> None:
    """For a few seconds a camera stamps its frames an hour ahead; the frames after these are the truth."""
    assert live.take_tracks(frame(50.0, ["p"]), origin=100.0)
    assert live.take_tracks(frame(3650.0, ["ghost"]), origin=3700.0)
    assert live.take_tracks(frame(54.0, ["p"]), origin=104.0)
    assert [(p["device"], p["state"]) for p in positions(live, 104.0)] == [("p", "confirmed")]


def test_an_area_not_in_the_site_file_is_left_out(live: LiveState) -> None:
    assert not live.take_tracks(frame(50.0, ["p"], area="elsewhere"), origin=100.0)
    assert positions(live, 100.0) == []


def test_old_tracks_are_no_longer_shown_nor_counted(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p", None]), origin=100.0)
    assert [zone["inside"] for zone in json.loads(live.zones_json(101.0))["zones"]] == [2, 0]
    assert len(json.loads(live.tracks_json("hall", 101.0))["tracks"]) == 2
    assert [zone["inside"] for zone in json.loads(live.zones_json(106.0))["zones"]] == [0, 0]
    assert json.loads(live.tracks_json(None, 106.0))["tracks"] == []


def test_a_camera_of_another_site_and_an_old_status_are_left_out(live: LiveState) -> None:
    assert live.camera("hall-east", 0.0).state == "unknown"
    assert live.take_status(CameraStatus(t=2.0, camera="hall-east", state="ok"), 10.0)
    assert not live.take_status(CameraStatus(t=1.0, camera="hall-east", state="ended"), 11.0)
    assert not live.take_status(CameraStatus(t=3.0, camera="spy", state="ok"), 11.0)
    assert (live.camera("hall-east", 12.0).state, live.camera("hall-east", 12.0).age) == ("ok", 2.0)


def test_a_camera_whose_clock_was_set_back_is_heard_at_once(live: LiveState) -> None:
    assert live.take_status(CameraStatus(t=4000.0, camera="hall-east", state="ok"), 10.0)
    assert live.take_status(CameraStatus(t=400.0, camera="hall-east", state="degraded"), 11.0)
    assert live.take_status(CameraStatus(t=401.0, camera="hall-east", state="ok"), 12.0)
    assert (live.camera("hall-east", 12.0).t, live.camera("hall-east", 12.0).age) == (401.0, 0.0)


def test_a_withdrawn_device_is_gone_at_once_from_positions_and_tracks(live: LiveState) -> None:
    live.take_tracks(frame(50.0, ["p", "q"]), origin=100.0)
    assert len(positions(live, 100.0)) == 2
    live.erase("p")
    assert [position["device"] for position in positions(live, 100.0)] == ["q"]
    assert b'"p"' not in live.tracks_json(None, 100.0)
    assert live.position("p", 100.0) is None
    live.take_tracks(frame(50.1, ["p", "q"]), origin=100.1)  # a frame that was still under way
    assert [position["device"] for position in positions(live, 100.1)] == ["q"]


def test_whom_only_a_phone_tells_of_is_located_but_no_second_person(live: LiveState) -> None:
    seen = frame(50.0, ["p", None])
    wide = [(0.04, 0.0, 0.04), (9.0, 0.0, 4.0)]
    live.take_tracks(
        msgspec.structs.replace(seen, device=["p", "q"], state=["confirmed", "unseen"], covariance=wide), origin=100.0
    )
    told = {str(one["device"]): one for one in positions(live, 100.1)}
    assert told["q"]["state"] == "unseen"
    assert told["q"]["covariance"] == [9.0, 0.0, 4.0]
    (entrance,) = [zone for zone in json.loads(live.zones_json(100.1))["zones"] if zone["id"] == "entrance"]
    assert (entrance["inside"], entrance["unseen"]) == (1, 1)
    assert [area.people for area in live.areas(100.1)] == [1]


def test_who_fed_a_track_lately_and_since_when_its_name_is_held(live: LiveState) -> None:
    def take(
        t: float, track: list[int], device: list[str | None], fed: list[list[str]], former: list[list[int]]
    ) -> None:
        seen = msgspec.structs.replace(frame(t, device), track=track, sources=fed, former=former)
        live.take_tracks(seen, origin=100.0)

    take(50.0, [1, 2], ["p", None], [["east", "p"], ["east"]], [[], []])
    take(50.6, [1, 2], ["p", "q"], [["west"], []], [[], []])
    take(51.2, [3, 2], ["p", "q"], [["west"], ["q"]], [[1], []])
    told = {row.track: row for row in live.tracks("hall", 100.0)}
    assert (told[3].device_since, told[2].device_since) == (50.0, 50.6), "a new number is the same person"
    assert (told[3].sources, told[2].sources) == (["west"], ["q"]), "what is more than a second old fed nobody lately"
    take(51.3, [3, 2], [None, "q"], [[], []], [[1], []])
    take(51.4, [3, 2], ["p", "q"], [[], []], [[1], []])
    live.erase("q")
    told = {row.track: row for row in live.tracks("hall", 100.0)}
    assert (told[3].device_since, told[3].sources) == (51.4, ["west"]), "a break is a break"
    assert (told[2].device_since, told[2].sources) == (None, [])
