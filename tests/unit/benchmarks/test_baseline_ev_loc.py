"""Both sensors joined in the obvious way: EV-Loc; and the table of all plain methods."""

from dataclasses import replace

import numpy as np
import pytest
from baseline_world import VIEW, SmallWorld, make_site, sighted
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.baselines.ev_loc import EvLocParameters, locate, trilaterate
from benchmarks.baselines.figures import baseline_figures, baseline_window_errors
from benchmarks.world_record import Truth, WorldRecord
from shared.messages import RadioScan
from shared.radio import PathLoss

SITE = make_site(4)
MODEL = PathLoss.of(SITE.access_points)


def record_of(t, people, devices, radio_of=None, sigma=0.0, seed=0):
    """People (n, p, 2), NaN while unseen; each device hears what is heard at the place of a person."""
    rng = np.random.default_rng(seed)
    frames = [sighted(float(now), [place for place in row if np.isfinite(place).all()]) for now, row in
              zip(t, people, strict=True)]  # fmt: skip
    scans = {}
    for person, device in enumerate(devices):
        if device is None:
            continue
        places = (people if radio_of is None else radio_of)[:, person]
        power = MODEL.rssi(places) + rng.normal(0.0, sigma, (len(t), 4))
        scans[device] = [
            RadioScan(t=float(now), device=device, seq=i, access_point=list(MODEL.names), rssi=row.tolist())
            for i, (now, row) in enumerate(zip(t, power, strict=True))
        ]
    in_view = np.ones(people.shape[:2], bool)
    truth = Truth(t, [f"p{i}" for i in range(len(devices))], devices, people, in_view)
    return WorldRecord(SITE, "yard", [], frames, scans, {}, truth, VIEW)


def three_people(t):
    """Three who walk up and down apart from each other."""
    phase = np.abs((t / 20.0) % 2.0 - 1.0)
    return np.stack(
        [
            np.stack([1.0 + 8.0 * phase, np.full(len(t), 1.5)], axis=1),
            np.stack([9.0 - 8.0 * phase, np.full(len(t), 4.5)], axis=1),
            np.stack([1.0 + 8.0 * phase, np.full(len(t), 7.5)], axis=1),
        ],
        axis=1,
    )


T = np.arange(0.0, 60.0, 0.5)


@pytest.mark.parametrize("fuse", ["positions", "distances"])
def test_clean_radio_finds_who_is_who(fuse):
    record = record_of(T, three_people(T), [None, "b", "c"])
    located = locate(record, MODEL, T, EvLocParameters(fuse=fuse))
    for device, person in (("b", 1), ("c", 2)):
        error = np.linalg.norm(located[device] - record.truth.position[:, person], axis=1)
        assert np.isnan(error[:2]).all()  # before the track is believed
        assert error[2:].max() < 0.6
        assert error[2:].mean() < 0.2


def test_noisy_radio_is_averaged_over_the_window():
    record = record_of(T, three_people(T), ["a", "b", "c"], sigma=5.0)
    located = locate(record, MODEL, T)
    for device, person in (("a", 0), ("b", 1), ("c", 2)):
        assert np.nanmean(np.linalg.norm(located[device] - record.truth.position[:, person], axis=1)) < 1.2


def test_exchanged_radio_exchanges_the_people_so_it_is_the_radio_that_decides():
    people = three_people(T)
    record = record_of(T, people, ["a", "b", "c"], radio_of=people[:, [2, 1, 0]])
    located = locate(record, MODEL, T, EvLocParameters(seen=1.0))
    assert np.nanmean(np.linalg.norm(located["a"] - people[:, 2], axis=1)) < 0.3
    assert np.nanmean(np.linalg.norm(located["b"] - people[:, 1], axis=1)) < 0.3


def test_seven_parts_sight_and_three_parts_radio():
    person = three_people(T)[:, :1]
    # The phone is heard two metres north of where its owner is seen.
    heard = person + np.array([0.0, 2.0])
    record = record_of(T, person, ["a"], radio_of=heard)
    seen_only = locate(record, MODEL, T, EvLocParameters(seen=1.0))["a"]
    fused = locate(record, MODEL, T)["a"]
    heard_only = locate(record, MODEL, T, EvLocParameters(seen=0.0))["a"]
    np.testing.assert_allclose(heard_only[2:], heard[2:, 0], atol=0.25)
    np.testing.assert_allclose(fused, 0.7 * seen_only + 0.3 * heard_only, atol=1e-9)


def test_a_short_false_track_in_the_middle_does_not_beat_the_right_one():
    people = three_people(T)[:, :1]
    false = np.full_like(people, np.nan)
    false[20:30] = [5.0, 3.0]
    both = np.concatenate([people, false], axis=1)
    record = record_of(T, both, ["a", None], radio_of=np.nan_to_num(both), sigma=5.0)
    located = locate(record, MODEL, T)["a"]
    assert np.isfinite(located[2:]).all()
    assert np.linalg.norm(located[2:] - people[2:, 0], axis=1).mean() < 1.2


def test_each_minute_is_decided_by_itself():
    t = np.arange(0.0, 120.0, 0.5)
    people = three_people(t)
    swapped = people.copy()
    swapped[120:] = people[120:][:, [2, 1, 0]]
    located = locate(record_of(t, people, ["a", None, None], radio_of=swapped), MODEL, t, EvLocParameters(seen=1.0))
    assert np.nanmax(np.linalg.norm(located["a"] - swapped[:, 0], axis=1)) < 0.6


def test_nobody_in_sight_or_nothing_heard_is_no_place():
    people = three_people(T)
    hidden = people.copy()
    hidden[60:] = np.nan
    located = locate(record_of(T, hidden[:, :1], ["a"], radio_of=people), MODEL, T)["a"]
    assert np.isfinite(located[2:60]).all()
    assert np.isnan(located[66:]).all()
    deaf = replace(record_of(T, people, ["a", None, None]), scans={"a": []})
    assert np.isnan(locate(deaf, MODEL, T)["a"]).all()
    empty = replace(record_of(T, people, ["a", None, None]), frames=[])
    assert np.isnan(locate(empty, MODEL, T)["a"]).all()
    assert locate(empty, MODEL, np.zeros(0))["a"].shape == (0, 2)


def test_access_points_that_were_not_heard_are_left_out():
    record = record_of(T, three_people(T), ["a", "b", "c"])
    weak = {
        device: [
            RadioScan(t=scan.t, device=device, seq=scan.seq, access_point=scan.access_point[:3], rssi=scan.rssi[:3])
            if i % 2
            else scan
            for i, scan in enumerate(scans)
        ]
        for device, scans in record.scans.items()
    }
    located = locate(replace(record, scans=weak), MODEL, T)
    assert np.nanmean(np.linalg.norm(located["c"] - record.truth.position[:, 2], axis=1)) < 0.3


@settings(max_examples=60, deadline=None)
@given(st.floats(0.2, 10.8), st.floats(0.2, 8.8), st.floats(0.5, 10.5), st.floats(0.5, 8.5))
def test_distances_lead_back_to_the_place_they_were_taken_at(x, y, guess_x, guess_y):
    place = np.array([[x, y]])
    distances = 10.0 ** (MODEL.log_distance(place) / 10.0)
    found = trilaterate(distances, MODEL, np.array([[guess_x, guess_y]]), VIEW)
    np.testing.assert_allclose(found, place, atol=0.05)
    distances[0, 1:3] = np.nan
    assert np.isnan(trilaterate(distances, MODEL, place, VIEW)).all()


def test_settings_without_a_meaning_are_refused():
    with pytest.raises(ValueError, match=r"seen: 1\.5"):
        EvLocParameters(seen=1.5)
    with pytest.raises(ValueError, match="window: 0"):
        EvLocParameters(window=0.0)
    with pytest.raises(ValueError, match="fuse: 'both'"):
        EvLocParameters(fuse="both")


def test_the_table_has_every_method_of_the_sensors_there_are():
    world = SmallWorld(seed=9, duration=180.0)
    record = world.record()
    figures = baseline_figures(record, world.survey())
    methods = ("radio", "vision", "cv", "evloc")
    assert sorted(figures) == sorted(f"p{share}_{method}" for share in (50, 70, 90) for method in methods)
    for method in methods:
        low, middle, high = (figures[f"p{share}_{method}"] for share in (50, 70, 90))
        assert 0.1 < low <= middle <= high < 6.0
    assert {name.split("_")[1] for name in baseline_figures(record, None)} == {"vision", "cv"}
    assert {name.split("_")[1] for name in baseline_figures(replace(record, frames=[]), world.survey())} == {"radio"}
    assert baseline_window_errors(record, world.survey())["evloc"].shape == (3, 5)


def test_more_noise_and_more_misses_make_every_method_worse():
    easy = SmallWorld(seed=3, duration=180.0, radio_sigma=1.0, detected=(0.99, 0.99), false_per_frame=0.0, bystanders=0)
    hard = replace(easy, radio_sigma=8.0, detected=(0.6, 0.2), false_per_frame=1.5, bystanders=5)
    gentle, harsh = (baseline_figures(world.record(), world.survey()) for world in (easy, hard))
    for method in ("radio", "vision", "cv", "evloc"):
        assert gentle[f"p50_{method}"] < 0.8 * harsh[f"p50_{method}"]
