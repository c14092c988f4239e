"""What is learned of the radio is what a plain Gaussian process says, and never surer than it may be."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import cho_factor

from shared.radio import PathLoss, RadioLearner, RadioPrior, device_offsets, novelty, radio_learning

Array = NDArray[np.float64]
LOWER, UPPER = np.zeros(2), np.array([12.0, 8.0])
GUESS = PathLoss(
    names=("a", "b"),
    positions=np.array([[0.0, 0.0, 2.5], [12.0, 8.0, 2.5]]),
    power_1m=np.array([-40.0, -45.0]),
    exponent=np.array([2.2, 2.0]),
)


def learner(cell: float = 1.0, prior: RadioPrior | None = None) -> RadioLearner:
    return RadioLearner.over(GUESS, LOWER, UPPER, cell, prior)


def readings(rng: np.random.Generator, count: int) -> tuple[Array, Array, NDArray[np.int64], Array]:
    places = rng.uniform(LOWER, UPPER, (count, 2))
    return places, np.full(count, 0.2), rng.integers(0, 2, count), rng.normal(0.0, 5.0, count)


def teach(one: RadioLearner, many: tuple[Array, Array, NDArray[np.int64], Array]) -> RadioLearner:
    one.learn(*many, np.ones(len(many[0])))
    return one


def before(one: RadioLearner) -> Array:
    """Variance (2, rows, columns) before any reading."""
    prior, distance = one.prior, GUESS.log_distance(one.centres())
    variance: Array = prior.shadowing**2 + prior.power**2 + prior.exponent**2 * distance.T**2
    return variance.reshape(2, *one.shape)


def test_mean_and_variance_are_those_of_a_plain_gaussian_process() -> None:
    rng = np.random.default_rng(1)
    # One reading in the middle of a cell each, so that gathering in cells loses nothing.
    one = learner()
    places = one.centres()[rng.permutation(len(one.centres()))[:30]]
    residual = rng.normal(0.0, 5.0, 30)
    model = teach(one, (places, np.full(30, 0.3), np.zeros(30, np.int64), residual)).solve()
    prior = one.prior
    noise = prior.white**2 + 2.0 * prior.shadowing**2 * (1.0 - np.exp(-0.3 / prior.shadowing_range))

    def kernel(p: Array, q: Array) -> float:
        d, e = GUESS.log_distance(p[None])[0, 0], GUESS.log_distance(q[None])[0, 0]
        correlated = prior.shadowing**2 * np.exp(-np.linalg.norm(p - q) / prior.shadowing_range)
        return float(correlated + prior.power**2 + prior.exponent**2 * d * e)

    known = np.array([[kernel(p, q) for q in places] for p in places]) + noise * np.eye(30)
    centres = one.centres()
    total = model.path_loss.rssi(centres)[:, 0] + model.shadowing.mean[0].ravel() - GUESS.rssi(centres)[:, 0]
    for number in range(0, len(centres), 7):
        cross = np.array([kernel(centres[number], q) for q in places])
        weights = np.linalg.solve(known, cross)
        assert total[number] == pytest.approx(weights @ residual, abs=1e-8)
        expected = kernel(centres[number], centres[number]) - weights @ cross
        assert model.shadowing.variance[0].ravel()[number] == pytest.approx(expected, abs=1e-8)


def test_before_any_reading_the_model_is_the_guess_and_the_prior() -> None:
    one = learner()
    model = one.solve("here")
    np.testing.assert_allclose(model.shadowing.mean, 0.0)
    np.testing.assert_allclose(model.shadowing.variance, before(one))
    np.testing.assert_array_equal(model.path_loss.power_1m, GUESS.power_1m)
    assert model.site == "here"


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 10**6), count=st.integers(1, 60))
def test_readings_only_ever_add_to_what_is_known(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    one = teach(learner(), readings(rng, count))
    some = one.solve().shadowing.variance
    assert (some <= before(one) + 1e-9).all()
    assert (some >= 0.0).all()
    # The same places again: the weighted mean place of no cell moves.
    one.weight, one.level, one.place = 2.0 * one.weight, 2.0 * one.level, 2.0 * one.place
    assert (one.solve().shadowing.variance <= some + 1e-9).all()


def test_far_from_all_readings_only_the_constants_are_better_known() -> None:
    prior = RadioPrior(power=0.0, exponent=0.0, shadowing_range=0.5)
    one = learner(prior=prior)
    teach(one, (np.full((50, 2), 0.5), np.full(50, 0.1), np.zeros(50, np.int64), np.full(50, 8.0)))
    model = one.solve()
    assert model.shadowing.variance[0, -1, -1] == pytest.approx(prior.shadowing**2, rel=1e-6)
    assert model.shadowing.mean[0, -1, -1] == pytest.approx(0.0, abs=1e-3)
    assert model.shadowing.variance[0, 0, 0] < 0.2 * prior.shadowing**2
    assert model.shadowing.mean[0, 0, 0] == pytest.approx(8.0, abs=0.5)


def test_constants_and_shadowing_of_a_made_world_are_found() -> None:
    rng = np.random.default_rng(3)
    places = rng.uniform(LOWER, UPPER, (1500, 2))
    distance = GUESS.log_distance(places)[:, 0]
    bump = 5.0 * np.sin(places[:, 0]) * np.cos(places[:, 1])
    heard = 6.0 - 0.3 * distance + bump + rng.normal(0.0, 2.5, 1500)
    one = teach(learner(), (places, np.full(1500, 0.05), np.zeros(1500, np.int64), heard))
    model = one.solve()
    spots = rng.uniform(LOWER + 1.0, UPPER - 1.0, (200, 2))
    truth = 6.0 - 0.3 * GUESS.log_distance(spots)[:, 0] + 5.0 * np.sin(spots[:, 0]) * np.cos(spots[:, 1])
    found = model.path_loss.rssi(spots)[:, 0] + model.shadowing.at(spots)[0][:, 0] - GUESS.rssi(spots)[:, 0]
    assert float(np.sqrt(np.mean((found - truth) ** 2))) < 1.2
    assert model.path_loss.power_1m[0] > GUESS.power_1m[0] + 2.0, "a good part of what all places share is power"


def test_readings_in_two_parts_are_those_at_once_and_what_fades_is_forgotten() -> None:
    rng = np.random.default_rng(4)
    many = readings(rng, 80)
    at_once = teach(learner(), many).solve()
    parts = learner()
    for part in (slice(0, 30), slice(30, 80)):
        teach(parts, tuple(column[part] for column in many))  # type: ignore[arg-type]
    np.testing.assert_allclose(parts.solve().shadowing.mean, at_once.shadowing.mean, atol=1e-9)
    parts.fade(0.1)
    assert (parts.solve().shadowing.variance >= at_once.shadowing.variance - 1e-9).all()
    parts.fade(0.0)
    np.testing.assert_allclose(parts.solve().shadowing.variance, before(parts))


def test_fading_moves_no_reading_from_its_place() -> None:
    """One reading off its cell's centre: once half faded, the most is still known right there."""
    prior = RadioPrior(power=0.0, exponent=0.0, shadowing_range=1.0)
    one = learner(prior=prior)
    teach(one, (np.array([[3.8, 2.7]]), np.full(1, 0.1), np.zeros(1, np.int64), np.array([8.0])))
    places = one.place[0, one.weight[0] > 0.0] / one.weight[0, one.weight[0] > 0.0][:, None]
    one.fade(0.5)
    after = one.place[0, one.weight[0] > 0.0] / one.weight[0, one.weight[0] > 0.0][:, None]
    np.testing.assert_allclose(after, places)
    mean = one.solve().shadowing.mean[0]
    row, column = np.unravel_index(np.argmax(mean), mean.shape)
    assert (int(column), int(row)) == (3, 2)


@pytest.mark.parametrize("wrong", ["x", "spread", "residual", "share"])
def test_what_is_no_number_teaches_nothing(wrong: str) -> None:
    rng = np.random.default_rng(6)
    places, spread, point, residual = readings(rng, 20)
    share = np.ones(20)
    one, other = learner(), learner()
    other.learn(places[1:], spread[1:], point[1:], residual[1:], share[1:])
    column = {"x": places[:, 0], "spread": spread, "residual": residual, "share": share}[wrong]
    column[0] = np.nan
    one.learn(places, spread, point, residual, share)
    for name in ("weight", "level", "place"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_many_phones_on_a_large_floor_are_solved_in_bounded_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """Beyond a cap cells get coarser; what phones read too much is still found."""
    sizes = []

    def watched(covariance: Array, lower: bool) -> object:
        sizes.append(len(covariance))
        return cho_factor(covariance, lower=lower)

    monkeypatch.setattr(radio_learning, "MOST_PAIRS", 200)
    monkeypatch.setattr(radio_learning, "cho_factor", watched)
    rng = np.random.default_rng(8)
    count, true = 4000, rng.normal(0.0, 4.0, 8)
    device, places = rng.integers(0, 8, count), rng.uniform(LOWER, UPPER, (count, 2))
    residual = true[device] + 3.0 * np.sin(places[:, 0]) + rng.normal(0.0, 2.5, count)
    point, variance = np.zeros(count, np.int64), np.full(count, 6.25)
    found = device_offsets(GUESS, RadioPrior(), device, places, point, residual, variance)
    np.testing.assert_allclose(found - found.mean(), true - true.mean(), atol=0.7)
    assert max(sizes) <= 200


def test_more_phones_than_the_cap_are_each_one_cell(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(radio_learning, "MOST_PAIRS", 5)
    rng = np.random.default_rng(9)
    device = np.arange(200) % 20
    zero = np.zeros(200, np.int64)
    places = rng.uniform(-UPPER, UPPER, (200, 2))  # the floor's zero lies within
    found = device_offsets(GUESS, RadioPrior(), device, places, zero, device.astype(np.float64), np.full(200, 6.25))
    assert np.corrcoef(found, np.arange(20.0))[0, 1] > 0.9


def test_a_phone_at_rest_tells_little_more_than_once() -> None:
    still = novelty(np.zeros((50, 2)))
    walking = novelty(np.column_stack([np.arange(50.0), np.zeros(50)]))
    assert still.sum() < 6.0
    assert walking.sum() == 50.0
    assert novelty(np.zeros((0, 2))).shape == (0,)


def test_a_place_known_badly_teaches_less() -> None:
    prior = RadioPrior()
    noise = prior.noise(np.array([0.0, 0.5, 5.0]))
    assert noise[0] == pytest.approx(prior.white**2)
    assert noise[0] < noise[1] < noise[2] < prior.white**2 + 2.0 * prior.shadowing**2


def test_what_phones_read_too_much_is_found_where_they_met_the_same_shadowing() -> None:
    rng = np.random.default_rng(5)
    count, true = 900, np.array([4.0, -3.0, 0.5])
    device, point = rng.integers(0, 3, count), rng.integers(0, 2, count)
    places = rng.uniform(LOWER, UPPER, (count, 2))
    residual = true[device] + 5.0 * np.sin(places[:, 0] + 2.0 * point) + rng.normal(0.0, 2.5, count)
    found = device_offsets(GUESS, RadioPrior(), device, places, point, residual, np.full(count, 6.25))
    # What all phones have in common cannot be told from the access points' power.
    np.testing.assert_allclose(found - found.mean(), true - true.mean(), atol=0.7)


def test_a_large_floor_gets_larger_cells() -> None:
    large = RadioLearner.over(GUESS, np.zeros(2), np.array([400.0, 300.0]))
    assert large.weight.shape[1] < 4200
    assert large.cell > 5.0
