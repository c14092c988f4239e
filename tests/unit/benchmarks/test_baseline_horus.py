"""Radio alone: Horus on a survey."""

from dataclasses import replace

import numpy as np
import pytest
from baseline_world import SmallWorld, make_site
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay
from scipy.stats import norm

from benchmarks.baselines.horus import HorusParameters, RadioMap, locate, locate_phone
from benchmarks.baselines.survey import Survey, readings_of, surveyed_path_loss
from benchmarks.position_error import window_rmse
from shared.messages import RadioScan
from shared.radio import PathLoss

CENTRE = np.array([5.5, 4.5])


@pytest.fixture(scope="module")
def world():
    return SmallWorld(seed=4, duration=240.0)


def rmse(record, located):
    estimate = np.stack([located[f"phone-{i}"] for i in range(5)], axis=1)
    return np.nanmedian(window_rmse(record.truth, estimate, CENTRE).rmse)


def test_radio_beats_the_guess_that_everybody_stands_in_the_middle_and_no_survey_tells_more_than_its_noise(world):
    record, survey = world.record(), world.survey()
    located = locate(record, survey, record.truth.t)
    by_radio = rmse(record, located)
    in_the_middle = rmse(record, {device: np.tile(CENTRE, (len(record.truth.t), 1)) for device in located})
    # A decibel of noise is a tenth of the distance: with 4 dB, 12 access points and people who walk while the average
    # is taken, less than half a metre would mean that truth leaks in.
    assert 0.5 < by_radio < 0.5 * in_the_middle


def test_more_noise_in_the_radio_is_more_error(world):
    errors = []
    for sigma in (2.0, 8.0):
        noisy = replace(world, radio_sigma=sigma)
        record = noisy.record()
        errors.append(rmse(record, locate(record, noisy.survey(), record.truth.t)))
    assert errors[0] < 0.8 * errors[1]


def test_probability_of_a_scan_is_the_product_over_access_points_with_missing_ones_counted():
    rng = np.random.default_rng(0)
    readings = rng.normal(-60.0, 5.0, (6, 9, 3))
    readings[rng.random(readings.shape) < 0.2] = np.nan
    radio_map = RadioMap(Survey(["a", "b", "c"], rng.uniform(0, 5, (6, 2)), readings), HorusParameters())
    scans = np.array([[-55.0, np.nan, -61.0], [-70.0, -58.0, -60.0]])
    expected = np.zeros((2, 6))
    for n, scan in enumerate(scans):
        for cell in range(6):
            for a, power in enumerate(scan):
                share = (np.isfinite(readings[cell, :, a]).sum() + 1) / 11
                missed = np.log(1 - share)
                heard = np.log(share) + norm.logpdf(power, radio_map.mean[cell, a], radio_map.sigma[cell, a])
                expected[n, cell] += missed if np.isnan(power) else heard
    np.testing.assert_allclose(radio_map.log_likelihood(scans), expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(radio_map.mean, np.nanmean(readings, axis=1))


def test_an_access_point_heard_only_in_the_west_says_west_when_heard_and_east_when_not():
    readings = np.full((2, 10, 2), -60.0)
    readings[1, :, 1] = np.nan
    radio_map = RadioMap(Survey(["both", "west"], np.array([[0.0, 0.0], [10.0, 0.0]]), readings), HorusParameters())
    places = radio_map.centre_of_mass(np.array([[-60.0, -60.0], [-60.0, np.nan]]), top_cells=6)
    assert places[0, 0] < 1.0
    assert places[1, 0] > 9.0


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(-100.0, -20.0), min_size=12, max_size=12), st.integers(1, 40))
def test_no_reading_however_odd_leads_out_of_the_survey(readings, top_cells):
    survey = SmallWorld(seed=4).survey(spacing=3.0, samples=4)
    radio_map = RadioMap(survey, HorusParameters())
    place = radio_map.centre_of_mass(np.array([readings]), top_cells)
    low, high = survey.position.min(axis=0) - 1e-9, survey.position.max(axis=0) + 1e-9
    assert np.isfinite(place).all()
    assert (place >= low).all()
    assert (place <= high).all()
    assert Delaunay(survey.position).find_simplex(np.clip(place, low + 1e-6, high - 1e-6))[0] >= 0


def test_what_is_heard_later_changes_nothing_before(world):
    record, survey = world.record(), world.survey()
    times = record.truth.t
    half = {device: [scan for scan in scans if scan.t <= 100.0] for device, scans in record.scans.items()}
    whole, first = locate(record, survey, times), locate(replace(record, scans=half), survey, times)
    before = times <= 100.0
    for device in whole:
        np.testing.assert_allclose(whole[device][before], first[device][before], rtol=0, atol=1e-9)
    assert not np.allclose(whole["phone-0"][~before], first["phone-0"][~before])


def test_average_spans_its_seconds_and_the_last_answer_is_kept_while_nothing_is_heard():
    survey = Survey(["a"], np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([[[-40.0] * 1], [[-80.0] * 1]]))
    radio_map = RadioMap(survey, HorusParameters())
    t = np.array([1.0, 2.0, 3.0, 4.0])
    readings = np.array([[-40.0], [-80.0], [-80.0], [np.nan]])
    times = np.array([0.9, 1.0, 2.5, 3.0, 4.5, 60.0])
    places = locate_phone(radio_map, t, readings, times, HorusParameters(average=2.0))[:, 0]
    # Nothing before the first scan; in (0.5, 2.5] two scans; at 3.0 the scan at 1.0 is just out; then the last answer.
    np.testing.assert_allclose(places, [np.nan, 0.0, 5.0, 10.0, 10.0, 10.0], atol=1e-3)


def test_unknown_access_points_and_phones_that_hear_nothing_are_no_trouble(world):
    record = world.record()
    odd = [RadioScan(t=1.0, device="odd", seq=0, access_point=["neighbour"], rssi=[-50.0])]
    located = locate(replace(record, scans={"odd": odd, "silent": []}), world.survey(), np.array([0.0, 5.0]))
    assert np.isnan(located["odd"]).all()
    assert np.isnan(located["silent"]).all()


def test_scans_become_a_table_in_the_order_of_time():
    scans = [
        RadioScan(t=2.0, device="d", seq=1, access_point=["b", "x"], rssi=[-50.0, -40.0]),
        RadioScan(t=1.0, device="d", seq=0, access_point=["a"], rssi=[-60.0]),
    ]
    t, readings = readings_of(scans, ["a", "b"])
    np.testing.assert_array_equal(t, [1.0, 2.0])
    np.testing.assert_array_equal(readings, [[-60.0, np.nan], [np.nan, -50.0]])


def test_the_surveyed_model_finds_the_world_s_constants_and_stays_physical():
    site = make_site(4)
    truth = PathLoss(
        names=tuple(point.id for point in site.access_points),
        positions=np.array([point.position for point in site.access_points]),
        power_1m=np.array([-64.0, -50.0, -41.0, -60.0]),
        exponent=np.array([2.2, 3.1, 1.8, 2.5]),
    )
    grid = np.stack(np.meshgrid(np.arange(0.5, 11), np.arange(0.5, 9)), axis=-1).reshape(-1, 2)
    readings = truth.rssi(grid)[:, None]
    readings[:, :, 3] = np.nan
    model = surveyed_path_loss(site, Survey([*truth.names[:3], "unplaced"], grid, readings), "ground")
    assert model.names == truth.names[:3]
    np.testing.assert_allclose(model.power_1m, truth.power_1m[:3], atol=1e-9)
    np.testing.assert_allclose(model.exponent, truth.exponent[:3], atol=1e-9)
    flipped = Survey(truth.names[:1], grid, -100.0 - truth.rssi(grid)[:, None, :1])
    upside_down = surveyed_path_loss(site, flipped, "ground")
    assert upside_down.exponent[0] == 1.0
    readings[2:, :, 0] = np.nan
    assert surveyed_path_loss(site, Survey(truth.names, grid, readings), "ground").names == truth.names[1:3]
    with pytest.raises(ValueError, match="three places"):
        surveyed_path_loss(site, Survey(truth.names[:1], grid, readings[:, :, :1]), "ground")
    with pytest.raises(ValueError, match="of floor 'first'"):
        surveyed_path_loss(site, flipped, "first")


@pytest.mark.parametrize(
    ("position", "readings", "named"),
    [
        (np.zeros((2, 3)), np.zeros((2, 1, 1)), "position"),
        (np.zeros((2, 2)), np.zeros((3, 1, 1)), "readings"),
        (np.zeros((2, 2)), np.full((2, 1, 1), np.nan), "heard"),
    ],
)
def test_a_survey_that_does_not_fit_together_is_refused(position, readings, named):
    with pytest.raises(ValueError, match=named):
        Survey(["a"], position, readings)


def test_settings_without_a_meaning_are_refused():
    with pytest.raises(ValueError, match="top_cells: 0"):
        HorusParameters(top_cells=0)
    with pytest.raises(ValueError, match=r"average: -1\.0"):
        HorusParameters(average=-1.0)
