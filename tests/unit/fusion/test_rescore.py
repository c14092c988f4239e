"""Trying other models on the last minutes: what is kept, what is asked, what a score means."""

import dataclasses
import json
from concurrent.futures import Future
from types import SimpleNamespace
from typing import Any

import msgspec
import numpy as np
import pytest
from fusion_world import World, frame, make_site
from msgspec.structs import replace
from scipy.stats import multivariate_normal

from services.fusion.area_view import AreaView, ViewMap
from services.fusion.evidence.identity_settings import NOISE
from services.fusion.rescore import quality
from services.fusion.rescore.candidate import CandidateError, apply, read_candidate
from services.fusion.rescore.desk import RescoreDesk
from services.fusion.rescore.offsets import Offsets
from services.fusion.rescore.quality import (
    LIMIT,
    NAME_ERROR,
    Heard,
    null_of,
    placed_covariance,
    places_at,
    score_scans,
    score_walks,
)
from services.fusion.rescore.recent import RecentChunks, decode_chunk
from services.fusion.rescore.setting import Asked, Setting, under
from services.fusion.rescore.sight import DETECTION, SightJudge
from services.fusion.rescore.significance import gain_error
from services.fusion.rescore.trial import withhold
from services.fusion.rescore.worker import Job, answer, by_radio, rescore
from services.fusion.tracker import Chunk
from shared.messages import DetectionFrame, Erasure, TrackFrame
from shared.radio import PathLoss, ShadowingMap, log_likelihood
from shared.site import Site

CORNERS = [(0.0, 0.0, 2.8), (20.0, 0.0, 2.8), (20.0, 12.0, 2.8), (0.0, 12.0, 2.8)]
RADIO = PathLoss(("a", "b", "c", "d"), np.array(CORNERS), np.full(4, -40.0), np.full(4, 2.5))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    return make_site(tmp_path_factory.mktemp("site"))


@pytest.fixture(scope="module")
def view(site: Site) -> AreaView:
    return AreaView.of(site, "hall")


@pytest.fixture(scope="module")
def chunks(site: Site) -> list[Chunk]:
    return World(site, seed=5, seconds=60.0, people=3).chunks()


def readings(seconds: int, seed: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A walk: levels (4 n,), access points (4 n,) and places (4 n, 2)."""
    rng = np.random.default_rng(seed)
    t = np.arange(seconds) + 100.0 * seed
    places = np.column_stack([10.0 + 9.0 * np.sin(t / 9.0), 6.0 + 5.0 * np.sin(t / 5.0)])
    level = RADIO.rssi(places) + rng.normal(0.0, 3.0, (seconds, 4)) + rng.normal(0.0, 3.0)
    return level.ravel(), np.tile(np.arange(4), seconds), np.repeat(places, 4, axis=0)


def score(radio: PathLoss, seconds: int = 100, seed: int = 1, known: float = 1.0) -> float:
    level, points, places = readings(seconds, seed)
    places = places.copy()
    places[int(known * len(places)) :] = np.nan
    heard = Heard(np.arange(len(level)) // 4 * 1.0, level, points, places)
    return score_scans([heard], null_of(level, points, 4, NOISE), radio, None, NOISE)[0].per_reading


def test_the_likelihood_is_that_of_the_slow_oracle() -> None:
    level, points, places = readings(10, 1)
    residual = level - RADIO.rssi(places)[np.arange(40), points]
    covariance = placed_covariance(places, points, np.full(40, NOISE.shadowing**2), NOISE)
    told = Offsets(1, NOISE.device, np.full(4, NOISE.access_point)).log_likelihood(residual, 0, points, covariance)
    oracle = log_likelihood(
        residual, places, points, dataclasses.replace(NOISE, white=np.sqrt(NOISE.white**2 + NAME_ERROR))
    )
    assert told == pytest.approx(oracle, rel=1e-12)


def test_offsets_are_one_number_for_the_whole_time_whatever_the_order_of_blocks() -> None:
    rng = np.random.default_rng(6)
    blocks = [(int(rng.integers(2)), rng.integers(3, size=5), rng.normal(0.0, 5.0, 5)) for _ in range(6)]
    device, point = np.repeat([one for one, _, _ in blocks], 5), np.concatenate([points for _, points, _ in blocks])
    joint = 9.0 * (device[:, None] == device) + 16.0 * (point[:, None] == point) + 4.0 * np.eye(30)
    whole = multivariate_normal(np.zeros(30), joint).logpdf(np.concatenate([residual for _, _, residual in blocks]))
    for order in (blocks, blocks[::-1]):
        offsets = Offsets(2, 3.0, np.full(3, 4.0))
        told = sum(offsets.log_likelihood(residual, one, points, 4.0 * np.eye(5)) for one, points, residual in order)
        assert told == pytest.approx(whole, rel=1e-9)


def test_a_model_that_needs_another_offset_for_every_stretch_pays_for_it() -> None:
    """Who is 6 dB off always has a phone that is 6 dB louder; who is off now this way and now that is wrong."""
    points, covariance = np.tile(np.arange(4), 10), 16.0 * np.eye(40)

    def told(shifts: tuple[float, ...]) -> float:
        offsets = Offsets(1, 3.0, np.full(4, 3.0))
        return sum(offsets.log_likelihood(np.full(40, shift), 0, points, covariance) for shift in shifts)

    assert told((6.0, 6.0, 6.0, 6.0)) > told((6.0, -6.0, 6.0, -6.0)) + 100.0
    assert told((6.0,)) == pytest.approx(told((-6.0,)))


def test_what_one_phone_tells_of_an_access_point_is_known_when_the_next_is_scored() -> None:
    points, covariance, residual = np.arange(4), 16.0 * np.eye(4), np.array([8.0, -8.0, 8.0, -8.0])
    offsets = Offsets(2, 3.0, np.full(4, 5.0))
    first, second = (offsets.log_likelihood(residual, device, points, covariance) for device in (0, 1))
    assert second > first + 1.0


def test_the_right_model_explains_more_than_a_wrong_one_and_than_none() -> None:
    flat = dataclasses.replace(RADIO, exponent=np.full(4, 1.2))
    shuffled = dataclasses.replace(RADIO, positions=RADIO.positions[[2, 3, 0, 1]])
    right = [score(RADIO, seed=seed) for seed in range(1, 6)]
    for wrong in (flat, shuffled):
        assert all(one > score(wrong, seed=seed) + 0.05 for seed, one in enumerate(right, 1))
    assert np.mean(right) > 0.05
    assert score(shuffled) < 0.0


def test_a_longer_time_is_not_a_better_model() -> None:
    assert score(RADIO, 400) == pytest.approx(score(RADIO, 100), abs=0.1)


def test_a_true_map_is_better_than_none_though_visits_to_one_spot_differ(monkeypatch: pytest.MonkeyPatch) -> None:
    """Who carries a phone, and how they face, no map knows: without room for it the truest map would look too sure."""
    rng = np.random.default_rng(9)
    level, points, places = readings(240, 3)
    x, y = np.meshgrid(np.arange(21.0), np.arange(13.0))
    shade = np.stack([4.0 * np.sin(x / 2.0 + n) * np.cos(y / 2.0 - n) for n in range(4)])
    grid = ShadowingMap(RADIO.names, np.zeros(2), 1.0, shade, np.full_like(shade, 0.5))
    visits = rng.normal(0.0, 4.0, (24, 4))
    seconds = np.arange(len(level)) // 4
    level = level + grid.at(places)[0][np.arange(len(level)), points] + visits[seconds // 10, points]
    heard = Heard(seconds * 1.0, level, points, places)

    def told(shadowing: ShadowingMap | None) -> float:
        return score_scans([heard], null_of(level, points, 4, NOISE), RADIO, shadowing, NOISE)[0].per_reading

    assert told(grid) > told(None) + 0.02
    monkeypatch.setattr(quality, "CARRIER", 0.0)
    assert told(grid) < told(None)


def test_not_to_know_is_worth_nothing() -> None:
    assert score(RADIO, known=0.0) == 0.0
    assert 0.0 < score(RADIO, known=0.5) < score(RADIO)


def test_places_are_taken_between_frames_and_not_across_gaps() -> None:
    frames, path = np.array([0.0, 1.0, 5.0]), np.array([[0.0, 0.0], [1.0, 2.0], [9.0, 9.0]])
    found = places_at(np.array([-0.5, 0.25, 3.0, 5.0, 5.9, 6.1]), frames, path, 1.0)
    assert found[[0, 1, 3, 4]].tolist() == [[0.0, 0.0], [0.25, 0.5], [9.0, 9.0], [9.0, 9.0]]
    assert np.isnan(found[[2, 5]]).all()
    assert np.isnan(places_at(np.array([1.0]), np.zeros(0), np.zeros((0, 2)), 1.0)).all()


def test_the_last_minutes_are_bounded_in_time_and_bytes(chunks: list[Chunk]) -> None:
    by_time, by_bytes = RecentChunks(10.0, 10**9), RecentChunks(1e9, 20_000)
    for one in chunks:
        by_time.add(one)
        by_bytes.add(one)
    kept = [decode_chunk(packed) for packed in by_time.copy()]
    assert all(box == (0.0, 0.0, 0.0, 0.0) for one in kept for seen in one.frames for box in seen.box)
    for one, given in zip(kept, chunks[-len(kept) :], strict=True):
        frames = tuple(replace(seen, box=again.box) for seen, again in zip(given.frames, one.frames, strict=True))
        assert one == dataclasses.replace(given, frames=frames)
    assert 9.0 < kept[-1].t_end - kept[0].t_start < 11.0
    assert 10_000 < by_bytes.bytes <= 20_000
    assert by_bytes.bytes == sum(map(len, by_bytes.copy()))
    nothing = RecentChunks(0.0, 10**9)
    nothing.add(chunks[0])
    assert nothing.copy() == []


def test_who_withdraws_consent_is_in_nothing_that_is_kept(chunks: list[Chunk]) -> None:
    recent = RecentChunks(1e9, 10**9)
    for one in chunks[:50]:
        recent.add(one)
    recent.add(dataclasses.replace(chunks[50], erasures=(Erasure(t=0.0, device="1"),)))
    assert recent.copy() == []
    assert recent.bytes == 0


def test_every_second_scan_is_withheld_and_the_first_part_does_not_count(view: AreaView, chunks: list[Chunk]) -> None:
    held = withhold(chunks, view.radio.names)
    kept, withheld, seconds = held.chunks, held.withheld, held.seconds
    everything = [scan for one in chunks for scan in one.scans]
    left = [scan for one in kept for scan in one.scans]
    assert len(left) == pytest.approx(len(everything) / 2, abs=3)
    assert seconds == pytest.approx(40.0, abs=1.5)
    assert set(withheld) == {"0", "1", "2"}
    for device, one in withheld.items():
        assert one.scans == pytest.approx(20, abs=2)
        assert one.t.min() >= chunks[0].t_start + 19.0
        assert not {scan.t for scan in left if scan.device == device} & set(one.t.tolist())


def test_a_worse_radio_model_scores_worse_and_the_same_model_the_same(view: AreaView, chunks: list[Chunk]) -> None:
    recent = RecentChunks(1e9, 10**9)
    for one in chunks:
        recent.add(one)
    points = {f"ap-{n}": {"power_1m": -80 if n % 2 else -20, "path_loss_exponent": 1.2} for n in range(1, 7)}
    question = json.dumps({"kind": "radio", "access_points": points}).encode()
    job = Job(recent.copy(), "evidence", 0, view, question)
    told = answer(job)
    assert told.error is None
    assert told.scans > 50
    assert told.active > 0.05
    assert told.gain is not None
    assert told.gain < -0.05
    assert {device: one.scans for device, one in told.devices.items()}.keys() == {"0", "1", "2"}
    assert told.gain_error is not None
    assert 0.0 < told.gain_error < abs(told.gain)
    same = answer(dataclasses.replace(job, question=b'{"kind": "radio", "model": null}'))
    assert (same.gain, same.gain_error, same.active) == (0.0, 0.0, told.active)
    assert (same.tracks_gain, same.tracks_gain_error) == (0.0, 0.0)
    # Three people are told apart all the same: only the model is worse, not where it puts them.
    assert told.tracks_gain == pytest.approx(0.0, abs=0.01)
    few = answer(dataclasses.replace(job, chunks=job.chunks[:30]))
    assert few.error is not None
    assert "20 or more" in few.error
    assert msgspec.json.decode(msgspec.json.encode(told))["candidate"] == told.candidate


def test_a_stride_candidate_stretches_what_phones_say(view: AreaView, chunks: list[Chunk]) -> None:
    recent = RecentChunks(1e9, 10**9)
    for one in chunks:
        recent.add(one)
    question = b'{"kind": "stride", "scale": {"0": 1.8, "1": 0.55}}'
    told = answer(Job(recent.copy(), "evidence", 0, view, question))
    gains = {device: one.gain or 0.0 for device, one in told.devices.items()}
    assert max(gains["0"], gains["1"]) < -0.02
    assert gains["2"] > max(gains["0"], gains["1"])


def test_steps_as_long_as_the_track_went_explain_it_best() -> None:
    rng = np.random.default_rng(4)
    moved = rng.normal(1.1, 0.3, 200)
    length = moved + rng.normal(0.0, 0.1, 200)
    ends, duration, variance = np.arange(200.0), np.ones(200), np.full(200, 0.02)
    scores = [
        score_walks(ends, k * length, k**2 * variance, duration, moved).per_reading for k in (0.7, 0.85, 1.0, 1.15, 1.3)
    ]
    assert np.argmax(scores) == 2
    assert scores[2] > 0.1
    hidden = score_walks(ends, length, variance, duration, np.full(200, np.nan))
    assert (hidden.readings, hidden.named, hidden.gain) == (200, 0, 0.0)


@pytest.mark.parametrize(
    ("question", "words"),
    [
        (b"{", "allowed kinds: detections, none, radio, stride"),
        (b'{"kind": "magic"}', "magic"),
        (b'{"kind": "radio"}', "found neither"),
        (b'{"kind": "stride", "scale": {}}', "scale, lines: found nothing"),
        (b'{"kind": "stride", "scale": {"d": 9}}', "scale.d: found 9; allowed: 0.5 … 2"),
    ],
)
def test_a_wrong_candidate_is_one_clear_message(view: AreaView, question: bytes, words: str) -> None:
    with pytest.raises(CandidateError) as caught:
        apply(read_candidate(question), view)
    assert words in str(caught.value)


def test_no_stretch_of_steps_says_more_than_the_limit() -> None:
    wild = score_walks(np.zeros(2), np.array([1.0, 90.0]), np.full(2, 1e-4), np.ones(2), np.array([30.0, 1.0]))
    assert wild.gain == pytest.approx(0.0, abs=2.0 * LIMIT)
    assert abs(score_walks(np.zeros(1), np.array([90.0]), np.array([1e-4]), np.ones(1), np.ones(1)).gain) == LIMIT


def test_a_trial_that_runs_while_somebody_withdraws_is_not_told(view: AreaView, chunks: list[Chunk]) -> None:
    class Asked:
        payload = b""

        def __init__(self) -> None:
            self.told: Future[bytes] = Future()

        def answer(self, payload: bytes) -> None:
            self.told.set_result(payload)

    recent = RecentChunks(1e9, 10**9)
    for one in chunks:
        recent.add(one)
    desk, asked = RescoreDesk(view, "evidence", 0, recent, 60.0), Asked()
    desk.take(asked)  # type: ignore[arg-type]
    desk.forget()
    assert b"withdrew consent" in asked.told.result(timeout=60.0)
    desk.close()


def test_tracks_are_judged_apart_from_the_models_that_made_them(
    site: Site, view: AreaView, chunks: list[Chunk]
) -> None:
    world = World(site, seed=5, seconds=60.0, people=3)
    times = [one.t_start for one in chunks]
    right = {str(one): {t: (*world.places(t)[one].tolist(),) for t in times} for one in range(3)}
    swapped = {"0": right["1"], "1": right["0"], "2": right["2"]}
    surer = dataclasses.replace(view, radio=dataclasses.replace(view.radio, power_1m=view.radio.power_1m - 9.0))
    held = withhold(chunks, view.radio.names)
    same = by_radio(held, Asked(Setting(view), Setting(view)), right, swapped)
    assert same.gain is not None
    assert same.tracks_gain == pytest.approx(same.gain)
    assert same.tracks_gain < -0.1
    other = by_radio(held, Asked(Setting(view), Setting(surer)), right, right)
    assert other.gain != 0.0
    assert other.tracks_gain == 0.0


def frames_of(chunks: list[Chunk], camera: str = "west") -> list[DetectionFrame]:
    return sorted((seen for one in chunks for seen in one.frames if seen.camera == camera), key=lambda seen: seen.t)


def ask(view: AreaView, chunks: list[Chunk], **candidate: Any) -> dict[str, Any]:
    return rescore(json.dumps(candidate).encode(), chunks, view)


def thinned(frames: list[DetectionFrame], kept: float) -> list[dict[str, Any]]:
    """What a detector that misses more would have told."""
    rng = np.random.default_rng(2)
    told = []
    for seen in frames:
        left = np.flatnonzero(rng.random(len(seen.x)) < kept).tolist()
        columns = {name: [getattr(seen, name)[row] for row in left] for name in seen.columns()}
        told.append(msgspec.to_builtins(replace(seen, **columns)))
    return told


def test_a_detector_that_misses_more_has_less_quality_and_the_same_detections_as_much(
    view: AreaView, chunks: list[Chunk]
) -> None:
    frames = frames_of(chunks)
    same = ask(view, chunks, kind="detections", frames={"west": [msgspec.to_builtins(seen) for seen in frames]})
    assert same["error"] is None
    assert (same["sight"]["gain"], same["gain"]) == (0.0, 0.0)
    assert same["sight"]["active"] > 20.0
    assert same["sight"]["active_people"] == pytest.approx(3.0, abs=0.5)
    half = ask(view, chunks, kind="detections", frames={"west": thinned(frames, 0.5)})
    assert half["sight"]["active"] == same["sight"]["active"]
    assert half["sight"]["gain"] < -3.0 * half["sight"]["gain_error"] < 0.0
    # Both sides on the same pictures: what the camera did detect live is no side.
    thin = thinned(frames, 0.5)
    both = ask(view, chunks, kind="detections", frames={"west": thin}, active={"west": thin})
    assert (both["sight"]["gain"], both["sight"]["active"]) == (0.0, half["sight"]["candidate"])


def test_detections_are_judged_without_phones_and_only_where_cameras_looked_anew(
    view: AreaView, chunks: list[Chunk]
) -> None:
    deaf = [dataclasses.replace(one, scans=(), motions=()) for one in chunks]
    frames = [msgspec.to_builtins(seen) for seen in frames_of(chunks)]
    told = ask(view, deaf, kind="detections", frames={"west": frames[280:350]})
    assert (told["error"], told["gain"], told["scans"]) == (None, None, 0)
    assert told["seconds"] == pytest.approx(10.0, abs=0.5)
    assert told["sight"]["gain"] == 0.0


def test_clutter_is_worth_less_than_misses_are_dear() -> None:
    """The score of one track by hand: assigned, missed, and a detection that is nobody's."""
    depth = np.full((40, 40), 5.0)
    seen = ViewMap(np.zeros(2), 0.25, depth)
    judge = SightJudge(SimpleNamespace(views={"west": seen}), 0.0, 100.0)  # type: ignore[arg-type]
    tracks = TrackFrame(
        t=0.0, area="hall", chunk=0, tracker="anonymous", track=[7], floor=["ground"], x=[5.0], y=[5.0],
        covariance=[(0.02, 0.0, 0.02)], vx=[0.0], vy=[0.0], state=["confirmed"], device=[None], probability=[1.0],
        runner_up=[None], runner_up_probability=[0.0], former=[[]], sources=[[]], quality=[1.0],
    )  # fmt: skip
    looks = [[(5.0, 5.1)], [(9.0, 9.0)], [(5.0, 5.0), (5.1, 5.0)]]
    for number, places in enumerate(looks * 3):
        t = float(number)
        judge.look([frame(t, places, sigma=0.1)], replace(tracks, t=t))
    spread = 0.02 + 0.01
    density = [float(multivariate_normal(np.zeros(2), spread * np.eye(2)).pdf(off)) for off in ([0.0, 0.1], [0.0, 0.0])]
    by_hand = 3.0 * (sum(np.log(p * DETECTION * 100.0) for p in density) + np.log(1.0 - DETECTION))
    assert judge.sight().quality == pytest.approx(by_hand)
    assert (judge.sight().tracks, judge.sight().lasted) == (1, 8.0)
    assert sum(judge.sight().slots.values()) == pytest.approx(by_hand)


def test_only_what_came_later_is_scored_and_nothing_there_is_an_error(view: AreaView, chunks: list[Chunk]) -> None:
    t0 = chunks[0].t_start
    late = ask(view, chunks, kind="none", since=t0 + 40.0)
    early = ask(view, chunks, kind="none", until=t0 + 40.0)
    whole = ask(view, chunks, kind="none")
    assert late["seconds"] == pytest.approx(20.0, abs=1.0)
    assert whole["scans"] == pytest.approx(60, abs=3)
    assert late["scans"] == pytest.approx(30, abs=3)
    assert early["seconds"] < 30.0
    assert "found 0 to withhold in the time asked about" in ask(view, chunks, kind="none", since=t0 + 900.0)["error"]
    assert "until: found" in ask(view, chunks, kind="none", since=t0 + 9.0, until=t0 + 3.0)["error"]


def test_a_line_of_steps_on_cadence_is_a_candidate_too(view: AreaView, chunks: list[Chunk]) -> None:
    """The people of this world take two steps a second, whatever their pace: any line is a length."""
    usual = float(np.mean([length for one in chunks for batch in one.motions for length in batch.length]))
    asked = apply(
        read_candidate(json.dumps({"kind": "stride", "lines": {"0": {"slope": 0.0, "offset": usual}}}).encode()), view
    )
    assert asked.candidate is not None
    walked = [batch for one in under(asked.candidate, chunks) for batch in one.motions]
    assert {length for batch in walked if batch.device == "0" for length in batch.length} == {usual}
    published = [batch for one in chunks for batch in one.motions if batch.device != "0"]
    assert [batch for batch in walked if batch.device != "0"] == published
    told = ask(view, chunks, kind="stride", lines={"0": {"slope": 0.6, "offset": 0.0}})
    assert told["devices"]["0"]["gain"] < 0.0


def test_an_error_of_a_gain_is_that_of_independent_blocks() -> None:
    rng = np.random.default_rng(3)
    gains, errors = [], []
    for _ in range(200):
        gain = {(str(device), slot): float(rng.normal(2.0, 5.0)) for device in range(4) for slot in range(10)}
        told = gain_error(gain, dict.fromkeys(gain, 10))
        assert told is not None
        gains.append(sum(gain.values()) / 400.0)
        errors.append(told)
    assert np.mean(errors) == pytest.approx(np.std(gains), rel=0.15)
    assert gain_error({}, {("a", 1): 5}) is None


@pytest.mark.parametrize(
    ("candidate", "words"),
    [
        ({"frames": {}}, "frames: found nothing; allowed: camera ids"),
        ({"frames": {"north": []}}, "frames.north: no camera of area hall; allowed: east, west"),
        ({"frames": {"west": []}}, "frames.west: found 0 frames; allowed: 2 or more"),
        ({"frames": {"west": [(1.0, "east"), (2.0, "west")]}}, "frames.west[0]: found 'east' on floor 'ground'"),
        ({"frames": {"west": [(2.0, "west"), (1.0, "west")]}}, "frames.west[1].t: found 1.0; allowed: later than"),
        (
            {"frames": {"west": [(1.0, "west"), (2.0, "west")]}, "active": {"east": [(1.0, "east"), (2.0, "east")]}},
            "active.west: found 0 frames; allowed: as many as in frames, 2",
        ),
    ],
)
def test_wrong_detections_are_one_clear_message(
    view: AreaView, chunks: list[Chunk], candidate: dict[str, dict[str, list[tuple[float, str]]]], words: str
) -> None:
    made = {
        field: {name: [msgspec.to_builtins(frame(t, camera=camera)) for t, camera in told] for name, told in of.items()}
        for field, of in candidate.items()
    }
    assert words in ask(view, chunks, kind="detections", **made)["error"]


def test_an_absurd_question_is_refused_unread(view: AreaView) -> None:
    with pytest.raises(CandidateError, match=r"question: found 65 MB; allowed: at most 64"):
        read_candidate(b" " * (65 * 2**20))
