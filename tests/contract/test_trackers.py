"""What every tracker must do, whatever it is made of."""

import dataclasses
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pytest
import scipy.stats
from fusion_world import World, chunk, frame, make_site

from services.fusion.area_view import AreaView
from services.fusion.chunks import period_of
from services.fusion.registry import TRACKERS, make_tracker
from services.fusion.snapshot import unpack
from services.fusion.tracker import Chunk, Retuning, Tracker, TrackerStateError
from services.fusion.trained_view import under_model
from services.simulator.radio.radio_world import RadioWorld
from shared.messages import DetectionFrame, Erasure, MotionBatch, RadioModelFile, RadioScan, TrackFrame, encode
from shared.radio import PathLoss, RadioModel, ShadowingMap, pack_radio_model
from shared.site import Site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Site:
    folder: Path = tmp_path_factory.mktemp("site")
    return make_site(folder)


@pytest.fixture(scope="module")
def view(site: Site) -> AreaView:
    return AreaView.of(site, "hall")


PHONES_ONLY = {"rbmcda", "rbmcda-forces"}
"""Who has no phone is nobody to these."""


@pytest.fixture(params=sorted(TRACKERS))
def tracker(request: pytest.FixtureRequest, view: AreaView) -> Tracker:
    return make_tracker(request.param, view, seed=3)


@pytest.fixture(params=sorted(TRACKERS.keys() - PHONES_ONLY))
def everybodys(request: pytest.FixtureRequest, view: AreaView) -> Tracker:
    """A tracker that follows people without phones too."""
    return make_tracker(request.param, view, seed=3)


@pytest.fixture(params=sorted(PHONES_ONLY | {"evidence"}))
def phones(request: pytest.FixtureRequest, view: AreaView) -> Tracker:
    """A tracker that tells which person a phone is."""
    return make_tracker(request.param, view, seed=3)


@pytest.fixture(scope="module")
def recorded(site: Site) -> Callable[[float], list[Chunk]]:
    """Twenty seconds of five people with phones, in chunks for trackers of a cycle."""
    return cache(
        lambda cycle: World(site, seed=1, seconds=20.0, cameras=("west", "east")).chunks(period=period_of(cycle))
    )


@pytest.fixture
def chunks(request: pytest.FixtureRequest, recorded: Callable[[float], list[Chunk]]) -> list[Chunk]:
    used: list[str] = [name for name in ("tracker", "everybodys", "phones") if name in request.fixturenames]
    return recorded(request.getfixturevalue(used[0]).cycle)


def fresh(tracker: Tracker, view: AreaView) -> Tracker:
    return make_tracker(tracker.name, view, seed=3)


def run(tracker: Tracker, chunks: Sequence[Chunk]) -> list[TrackFrame]:
    return [tracker.step(one) for one in chunks]


def learned(view: AreaView, power: float = 4.0, located: tuple[str, ...] = ()) -> RadioModelFile:
    """A model whose access points are so much louder, stand elsewhere where located, and shade the hall's east."""
    radio = dataclasses.replace(
        view.filed,
        positions=view.filed.positions + np.array([0.5, -0.5, 0.0]),
        power_1m=view.filed.power_1m + power,
        exponent=view.filed.exponent + 0.2,
    )
    shade = np.broadcast_to(np.linspace(0.0, -3.0, 25), (len(radio.names), 15, 25)).copy()
    grid = ShadowingMap(radio.names, np.zeros(2), 1.0, shade, np.full_like(shade, 4.0))
    return pack_radio_model(RadioModel(view.site, radio, grid), located)


def walk_east(tracker: Tracker, seconds: float = 3.0, rate: float = 10.0, t0: float = 100.0) -> TrackFrame:
    """One person walks east at 1 m/s from (8, 7)."""
    for number in range(int(seconds * rate)):
        t = t0 + number / rate
        last = tracker.step(chunk(frame(t, [(8.0 + t - t0, 7.0)], seq=number)))
    return last


def test_the_same_chunks_give_the_same_bytes(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    once = b"\n".join(encode(tracks) for tracks in run(tracker, chunks))
    again = b"\n".join(encode(tracks) for tracks in run(fresh(tracker, view), chunks))
    assert once == again


def test_everybody_is_found(everybodys: Tracker, site: Site, chunks: list[Chunk]) -> None:
    world = World(site, seed=1, seconds=20.0)
    for tracks in run(everybodys, chunks)[60:]:
        found = np.column_stack([tracks.x, tracks.y])
        apart = np.linalg.norm(world.places(tracks.t)[:, None] - found[None], axis=2)
        assert (apart.min(axis=1) < 1.0).all()


def test_two_cameras_do_not_make_twins(everybodys: Tracker, chunks: list[Chunk]) -> None:
    for tracks in run(everybodys, chunks)[30:]:
        # A phone whose carrier is not known for sure may be told besides, as one that no camera sees.
        assert sum(state != "unseen" for state in tracks.state) <= 5
        assert len(set(tracks.track)) == len(tracks.track)


def test_the_order_of_detections_in_a_frame_means_nothing(
    tracker: Tracker, view: AreaView, chunks: list[Chunk]
) -> None:
    def reversed_frame(one: DetectionFrame) -> DetectionFrame:
        return msgspec.structs.replace(one, **{name: getattr(one, name)[::-1] for name in one.columns()})

    turned = [dataclasses.replace(one, frames=tuple(reversed_frame(f) for f in one.frames)) for one in chunks]
    for straight, backwards in zip(run(tracker, chunks), run(fresh(tracker, view), turned), strict=True):
        assert (straight.x, straight.y) == (backwards.x, backwards.y)


def test_empty_chunks_and_empty_frames_are_fine(tracker: Tracker) -> None:
    nothing = tracker.step(Chunk(1500, 100.0, 100.0 + 1 / 15))
    assert nothing.track == []
    assert nothing.chunk == 1500
    assert tracker.step(chunk(frame(100.2))).track == []


def test_an_empty_frame_is_a_miss_and_the_track_dies_in_the_end(everybodys: Tracker) -> None:
    walk_east(everybodys)
    states = []
    for number in range(40):
        tracks = everybodys.step(chunk(frame(103.0 + number * (everybodys.cycle or 0.1), seq=number)))
        states.append(tracks.state)
    assert states[0] == ["coasting"]
    assert states[-1] == []


def test_a_frame_every_other_second_still_misses_who_left(everybodys: Tracker) -> None:
    """Cameras on a poor network: people are found, they leave, and what never was anybody does not pile up."""
    rng = np.random.default_rng(7)
    for number in range(8):
        tracks = everybodys.step(chunk(frame(100.0 + 2.0 * number, [(12.0, 7.0)], seq=number)))
    assert len(tracks.track) == 1
    sizes = []
    for number in range(8, 100):
        places = rng.uniform([4, 3], [20, 11], (int(number < 90), 2))
        tracks = everybodys.step(chunk(frame(100.0 + 2.0 * number, places, seq=number)))
        sizes.append(len(everybodys.state()))
    assert tracks.track == []
    assert max(sizes[40:]) < 1.5 * max(sizes[:40])


def test_a_silent_camera_is_not_a_miss(everybodys: Tracker) -> None:
    before = walk_east(everybodys)
    # Three seconds of nothing at all, then the person is where the walk led.
    after = everybodys.step(chunk(frame(105.9, [(13.9, 7.0)])))
    assert after.track == before.track


def test_a_camera_that_does_not_see_the_place_misses_nobody(everybodys: Tracker, view: AreaView) -> None:
    depth = view.views["west"].depth_at(np.array([[12.0, 7.0], [12.0, 16.5]]))
    assert depth[0] > 1.0 > 0.0 > depth[1]


def test_two_frames_of_one_camera_in_a_chunk_are_one_person(everybodys: Tracker) -> None:
    for number in range(30):
        t = 100.0 + number / 15
        places = [(8.0 + t - 100.0, 7.0)]
        tracks = everybodys.step(chunk(frame(t, places, seq=2 * number), frame(t + 0.03, places, seq=2 * number + 1)))
    assert len(tracks.track) == 1


def test_a_late_frame_is_compared_with_the_past(everybodys: Tracker) -> None:
    walk_east(everybodys)
    # The east camera's picture of 0.3 s ago comes now; the person was 0.3 m back.
    tracks = everybodys.step(chunk(frame(103.0, [(11.0, 7.0)]), frame(102.7, [(10.7, 7.0)], camera="east")))
    assert len(tracks.track) == 1
    assert tracks.x[0] == pytest.approx(11.0, abs=0.12)
    assert tracks.sources[0][:2] == ["east", "west"]


def test_restored_in_mid_run_it_goes_on_byte_for_byte(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    for share in (0.1, 0.4, 0.8):
        cut = round(share * len(chunks))
        straight = fresh(tracker, view)
        run(straight, chunks[:cut])
        state = straight.state()
        other = fresh(tracker, view)
        other.restore(state)
        assert other.state() == state
        for one, same in zip(run(straight, chunks[cut:]), run(other, chunks[cut:]), strict=True):
            assert encode(one) == encode(same)


def test_the_same_radio_model_once_more_changes_nothing(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    half = len(chunks) // 2
    straight, swapped = tracker, fresh(tracker, view)
    assert isinstance(swapped, Retuning)
    for model in (None, learned(view)):
        under = under_model(view, model)
        for one in (straight, swapped):
            run(one, chunks[:half])
            one.retune(under)
        # Another object of the same content, as after a restart.
        swapped.retune(under_model(AreaView(**vars(view)), model))
        assert straight.state() == swapped.state()
        for one, same in zip(run(straight, chunks[half:]), run(swapped, chunks[half:]), strict=True):
            assert encode(one) == encode(same)
        straight, swapped = fresh(tracker, view), fresh(tracker, view)


def test_a_swap_of_the_radio_model_moves_and_renumbers_nobody(
    tracker: Tracker, view: AreaView, chunks: list[Chunk]
) -> None:
    half = 2 * len(chunks) // 3
    straight = fresh(tracker, view)
    before = run(tracker, chunks[:half])[-1]
    run(straight, chunks[:half])
    assert isinstance(tracker, Retuning)
    tracker.retune(under_model(view, learned(view, located=("ap-2",))))
    after, without = tracker.step(chunks[half]), straight.step(chunks[half])
    assert after.track == without.track
    assert len(set(before.track) & set(after.track)) >= 4
    apart = np.hypot(np.subtract(after.x, without.x), np.subtract(after.y, without.y))
    seen = np.array([state != "unseen" for state in after.state])
    assert (apart[seen] < 0.5).all()
    told, knew = (
        {device: track for device, track in zip(one.device, one.track, strict=True) if device}
        for one in (after, without)
    )
    assert told == knew


def test_after_a_swap_it_is_the_tracker_of_the_new_model(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    """A state taken after the swap goes on, to the byte, in a tracker that was made under the new model."""
    half, later = len(chunks) // 2, 3 * len(chunks) // 4
    under = under_model(view, learned(view, located=("ap-2",)))
    run(tracker, chunks[:half])
    assert isinstance(tracker, Retuning)
    tracker.retune(under)
    for cut in (half, later):
        run(tracker, chunks[half:cut])
        other = make_tracker(tracker.name, under, seed=3)
        other.restore(tracker.state())
        assert other.state() == tracker.state()
    for one, same in zip(run(tracker, chunks[later:]), run(other, chunks[later:]), strict=True):
        assert encode(one) == encode(same)


def test_a_true_radio_model_in_mid_run_keeps_phones_found(phones: Tracker, site: Site, view: AreaView) -> None:
    world = World(site, seed=1, seconds=60.0, cameras=("west", "east"))
    chunks = world.chunks(period=period_of(phones.cycle))
    half = len(chunks) // 2
    frames = run(phones, chunks[:half])
    truth = RadioWorld(site, world.seed)
    ground = [truth.access_points.index(name) for name in view.radio.names]
    radio = PathLoss(view.radio.names, view.radio.positions, truth.power_1m[ground], truth.exponent[ground])
    flat = np.zeros((len(ground), 2, 2))
    model = RadioModel(site.site, radio, ShadowingMap(radio.names, np.zeros(2), 10.0, flat, flat + 9.0))
    assert isinstance(phones, Retuning)
    phones.retune(under_model(view, pack_radio_model(model)))
    frames += run(phones, chunks[half:])
    assert world.located_share(frames, after=30.0) > 0.6


def test_a_snapshot_encoded_later_is_of_the_moment_it_was_taken(tracker: Tracker, chunks: list[Chunk]) -> None:
    half = len(chunks) // 2
    run(tracker, chunks[:half])
    state, snapshot = tracker.state(), tracker.snapshot()
    run(tracker, chunks[half:])
    assert snapshot() == state != tracker.state()


@pytest.mark.parametrize("state", [b"", b"{}", b"[1]", b'{"tracker": "another"}', b'{"tracker": "%s"}'])
def test_a_broken_state_is_refused_and_changes_nothing(tracker: Tracker, chunks: list[Chunk], state: bytes) -> None:
    run(tracker, chunks[:30])
    before = tracker.state()
    with pytest.raises(TrackerStateError):
        tracker.restore(state.replace(b"%s", tracker.name.encode()))
    assert tracker.state() == before


def test_no_device_is_on_two_tracks_and_no_column_is_odd(tracker: Tracker, chunks: list[Chunk]) -> None:
    for tracks in run(tracker, chunks):
        named = [device for device in tracks.device if device is not None]
        assert len(named) == len(set(named))
        assert tracks.tracker == tracker.name
        for device, rival in zip(tracks.device, tracks.runner_up, strict=True):
            assert device is None or device != rival
        assert all(0.0 <= value <= 1.0 for value in (*tracks.probability, *tracks.quality))
        assert all(xx > 0.0 and xx * yy > xy * xy for xx, xy, yy in tracks.covariance)


def withdrawal(after: Chunk, *devices: str) -> Chunk:
    """A chunk in which these withdraw, and no camera speaks."""
    told = tuple(Erasure(t=after.t_end, device=device) for device in devices)
    return Chunk(after.index + 1, after.t_end, 2.0 * after.t_end - after.t_start, erasures=told)


def values(state: Any, path: str = "", found: dict[str, set[str]] | None = None) -> dict[str, set[str]]:
    """Return the different numbers and words of a state by where they stand, rows and numbered keys being alike."""
    found = {} if found is None else found
    if isinstance(state, dict) and state.keys() == {"type", "shape", "data"}:
        found.setdefault(path, set()).update(map(str, unpack(state).ravel().tolist()))
    elif isinstance(state, dict):
        for key, value in state.items():
            number = key.isdigit()
            found.setdefault(f"{path}.keys", set()).add(key)
            values(value, f"{path}.*" if number else f"{path}.{key}", found)
    elif isinstance(state, list):
        for value in state:
            values(value, f"{path}.*", found)
    else:
        found.setdefault(path, set()).add(str(state))
    return found


OF_ALL = (".identity.calibration", ".constants", ".generator", ".ignored")
"""What a tracker may keep of those who withdrew, for it is nobody's: constants of the radio, and counts."""


def test_who_withdrew_leaves_nothing_behind(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    """No name, no row, no walk, no chain: the state is as full as one of a tracker that never heard a phone.

    A free row may hold a fresh one's values, which are all the same: one value more than without the row.
    """
    names = [f"phone of {number}" for number in range(5)]
    deaf = fresh(tracker, view)
    for one in chunks:
        scans = tuple(msgspec.structs.replace(scan, device=names[int(scan.device)]) for scan in one.scans)
        motions = tuple(msgspec.structs.replace(batch, device=names[int(batch.device)]) for batch in one.motions)
        tracker.step(dataclasses.replace(one, scans=scans, motions=motions))
        deaf.step(dataclasses.replace(one, scans=(), motions=()))
    frame_after = tracker.step(withdrawal(chunks[-1], *names))
    deaf.step(withdrawal(chunks[-1]))
    assert not set(frame_after.device) & set(names)
    assert "phone of" not in tracker.state().decode()
    left, without = (values(msgspec.json.decode(one.state())) for one in (tracker, deaf))
    more = {
        path: found
        for path, found in left.items()
        if len(found - {"None"}) > len(without.get(path, set()) - {"None"}) + 1 and not path.startswith(OF_ALL)
    }
    assert more == {}


def test_others_stay_where_they_are_while_somebody_withdraws(tracker: Tracker, chunks: list[Chunk]) -> None:
    before = run(tracker, chunks)[-1]
    assert len(before.track) >= 5
    stranger = tracker.step(withdrawal(chunks[-1], "a stranger"))
    assert (stranger.track, stranger.x, stranger.device) == (before.track, before.x, before.device)
    after = tracker.step(withdrawal(chunks[-1], "0"))
    assert "0" not in after.device
    rows = zip(before.track, before.device, before.state, strict=True)
    others = {
        track
        for track, device, state in rows
        if device != "0" or (tracker.name not in PHONES_ONLY and state != "unseen")
    }
    assert others == set(after.track)


def test_nonsense_is_ignored_and_nothing_raises(tracker: Tracker) -> None:
    nan, inf = float("nan"), float("inf")
    walk_east(tracker)
    odd = [
        frame(103.0, [(1e9, 7.0), (nan, 2.0), (inf, 0.0)]),
        frame(103.1, [(11.0, 7.0)], camera="nobody-knows"),
        frame(103.2, [(11.2, 7.0)], floor="first"),
        msgspec.structs.replace(frame(103.3, [(11.3, 7.0)]), covariance=[(0.0, 0.0, 0.0)]),
        msgspec.structs.replace(frame(103.4, [(11.4, 7.0)]), covariance=[(0.1, 5.0, 0.1)]),
    ]
    scans = [
        RadioScan(t=103.0, device="a", seq=0, access_point=["unknown"], rssi=[-50.0]),
        RadioScan(t=103.0, device="a", seq=1),
        RadioScan(t=103.0, device="a", seq=2, access_point=["ap-1", "ap-1"], rssi=[-50.0, nan]),
        RadioScan(t=1e12, device="a", seq=3, access_point=["ap-1"], rssi=[-50.0]),
        RadioScan(t=-1e12, device="a", seq=4, access_point=["ap-1"], rssi=[-50.0]),
        RadioScan(t=nan, device="a", seq=5, access_point=["ap-1"], rssi=[-50.0]),
        RadioScan(t=103.0, device="b", seq=0, access_point=["ap-2"], rssi=[1e30]),
    ]
    motions = [
        MotionBatch(t=103.0, t_start=102.0, device="never-heard", seq=0, activity="still"),
        MotionBatch(t=102.0, t_start=103.0, device="a", seq=0, activity="still"),
        MotionBatch(t=nan, t_start=nan, device="a", seq=1, activity="still"),
        MotionBatch(
            t=103.0, t_start=102.0, device="a", seq=2, activity="walking", step_t=[nan], length=[1e9],
            length_variance=[nan], heading=[nan], heading_variance=[-1.0],
        ),
    ]  # fmt: skip
    for one in odd:
        tracks = tracker.step(chunk(one, scans=scans, motions=motions))
        encode(tracks)
    tracks = tracker.step(chunk(frame(103.5, [(11.5, 7.0)])))
    encode(tracks)
    assert sum(tracker.ignored().values()) > 0
    if tracker.name not in PHONES_ONLY:
        assert np.hypot(tracks.x[0] - 11.5, tracks.y[0] - 7.0) < 0.3


def test_ellipses_that_are_lines_once_rounded_stop_nobody(tracker: Tracker) -> None:
    flat = float(np.nextafter(1.0, 0.0))
    for number in range(40):
        both = [(1.0, flat, 1.0), (1.0, -flat if number % 2 else flat, 1.0)]
        places = [(12.0, 7.0), (12.5, 7.2)]
        frames = [
            msgspec.structs.replace(frame(100.0 + number / 10, places, camera), covariance=both)
            for camera in ("west", "east")
        ]
        encode(tracker.step(chunk(*frames)))
    assert sum(tracker.ignored().values()) == 160


def test_a_clock_set_back_starts_anew_instead_of_stopping(everybodys: Tracker) -> None:
    walk_east(everybodys, t0=100_000.0)
    assert len(walk_east(everybodys, t0=100.0).track) == 1


def test_memory_stays_bounded_however_long_it_runs(tracker: Tracker) -> None:
    """Many people and phones come and go; the state does not grow with the number of those who left."""
    rng = np.random.default_rng(5)
    sizes = []
    pace = 1.0 if tracker.cycle else 1 / 7
    for visit in range(60):
        for number in range(2 if tracker.cycle else 12):
            t = 1000.0 + 20.0 * visit + number * pace
            places = np.array([[4.0 + 2 * visit % 16 + number / 7, 5.0], [20.0 - number / 7, 9.0]])
            scans = [
                RadioScan(
                    t=t,
                    device=f"phone-{visit}-{who}",
                    seq=number,
                    access_point=["ap-1", "ap-2", "ap-3"],
                    rssi=np.round(rng.normal(-60, 5, 3)).tolist(),
                )
                for who in range(2)
            ]
            motions = [
                MotionBatch(
                    t=t,
                    t_start=t - 1.0,
                    device=scan.device,
                    seq=number,
                    activity="walking",
                    step_t=[t - 0.5, t],
                    length=[0.6, 0.6],
                    length_variance=[0.01, 0.01],
                    heading=rng.uniform(-3.0, 3.0, 2).tolist(),
                    heading_variance=[0.05, 0.05],
                )
                for scan in scans
            ]
            told = (scans, motions) if number % 7 < 2 else ((), ())
            tracker.step(chunk(frame(t, places, seq=number), scans=told[0], motions=told[1]))
        sizes.append(len(tracker.state()))
    assert max(sizes[30:]) <= 1.3 * max(sizes[10:30])


def place_of(device: str, tracks: TrackFrame) -> tuple[float, float] | None:
    found = [(x, y) for name, x, y in zip(tracks.device, tracks.x, tracks.y, strict=True) if name == device]
    return found[0] if found else None


def test_phones_are_found_among_people(phones: Tracker, site: Site) -> None:
    world = World(site, seed=1, seconds=60.0, cameras=("west", "east"))
    share = world.located_share(run(phones, world.chunks(period=period_of(phones.cycle))), after=30.0)
    assert share > 0.6


@pytest.mark.parametrize("name", sorted(PHONES_ONLY))
def test_a_late_phone_is_left_to_history(name: str, view: AreaView, site: Site) -> None:
    """What comes far too late neither moves a device nor makes it known."""
    phones = make_tracker(name, view, seed=3)
    world = World(site, seed=1, seconds=20.0)
    late = [
        dataclasses.replace(
            one,
            scans=tuple(msgspec.structs.replace(scan, late=scan.device == "0") for scan in one.scans),
            motions=tuple(msgspec.structs.replace(batch, late=batch.device == "0") for batch in one.motions),
        )
        for one in world.chunks(period=period_of(phones.cycle))
    ]
    for tracks in run(phones, late):
        assert place_of("0", tracks) is None


def test_ids_go_on_after_a_restart(tracker: Tracker, view: AreaView, chunks: list[Chunk]) -> None:
    half = len(chunks) // 2
    before = run(tracker, chunks[:half])[-1]
    other = fresh(tracker, view)
    other.restore(tracker.state())
    after = other.step(chunks[half])
    assert set(before.track) & set(after.track)
    assert len(set(after.track)) == len(after.track)


def test_covariances_are_honest(tracker: Tracker, site: Site) -> None:
    """Normalised estimation errors of who is where (nearest person: identity is another question) are chi-square."""
    world = World(site, seed=4, people=1, seconds=60.0, cameras=("west", "east"))
    errors = []
    for tracks in run(tracker, world.chunks(period=period_of(tracker.cycle))):
        if tracks.t < world.t0 + 15.0 or not tracks.track:
            continue
        apart = np.array([tracks.x[0], tracks.y[0]]) - world.places(tracks.t)[0]
        xx, xy, yy = tracks.covariance[0]
        errors.append(float(apart @ np.linalg.solve(np.array([[xx, xy], [xy, yy]]), apart)))
    # Errors of neighbouring frames are alike: about one in ten counts. Caution is no lie, but it must say something.
    count = max(len(errors) // 10, 4)
    assert 0.2 < np.mean(errors) < scipy.stats.chi2.ppf(0.999, 2 * count) / count
