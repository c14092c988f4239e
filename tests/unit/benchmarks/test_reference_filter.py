"""The method sheet's small site can be run again: its traps cost what it says, and the shipped filter passes them."""

from __future__ import annotations

import numpy as np

from benchmarks.baselines.literal_rbmcda import LiteralParameters, LiteralRbmcda
from benchmarks.reference_filter import EXTENT, PUBLISHED, Row, errors_of, rows
from benchmarks.reference_world import ReferenceWorld
from services.fusion.rbmcda.unscented import radio_update

SEED = 5
BY_NAME = {row.name: row for row in rows()}


def mean_error(row: Row, runs: int = 2) -> float:
    return float(np.mean(np.concatenate([errors_of(row, number, SEED)[0] for number in range(runs)])))


def test_every_published_row_is_run_and_no_two_have_one_name() -> None:
    assert len(BY_NAME) == len(rows())
    assert set(PUBLISHED) <= set(BY_NAME)


def test_the_literal_filter_hears_as_the_shipped_bank_does() -> None:
    record = ReferenceWorld().record(SEED)
    filter_ = LiteralRbmcda(record.radio, EXTENT, 5, LiteralParameters(particles=4), SEED)
    rng = np.random.default_rng(SEED)
    filter_.mean = rng.uniform(1.0, 8.0, filter_.mean.shape)
    filter_.covariance = filter_.covariance * rng.uniform(0.1, 2.0, (4, 5, 1, 1))
    mean, covariance, evidence = filter_._heard(record.reading[0].T)

    state, spread = np.zeros((8, 20)), np.zeros((8, 8, 20))
    state[:2], spread[:2, :2] = filter_.mean.reshape(20, 2).T, filter_.covariance.reshape(20, 2, 2).transpose(1, 2, 0)
    noise = np.full(record.reading[0].shape, 16.0)
    told = radio_update(state, spread, record.radio.rssi, record.reading[0], noise, np.tile(np.arange(5), 4))

    np.testing.assert_allclose(evidence.ravel(), told, atol=1e-9)
    np.testing.assert_allclose(mean.reshape(20, 2).T, state[:2], atol=1e-9)
    np.testing.assert_allclose(covariance.reshape(20, 2, 2).transpose(1, 2, 0), spread[:2, :2], atol=1e-9)


def test_without_a_density_of_the_radio_everything_is_clutter_and_nobody_is_born() -> None:
    assert errors_of(BY_NAME["area_aps_6"], 0, SEED)[1] == 0.0


def test_both_filters_are_where_the_sheet_says() -> None:
    mean, _ = PUBLISHED["once_aps_6"]
    assert mean_error(BY_NAME["once_aps_6"]) < 1.5 * mean
    assert mean_error(BY_NAME["shipped_once_aps_6"]) < 1.5 * mean


def test_uniform_clutter_in_a_wide_box_makes_the_same_people_much_harder_to_follow() -> None:
    assert mean_error(BY_NAME["box70_aps_6"]) > 1.5 * mean_error(BY_NAME["radio_aps_6"])
