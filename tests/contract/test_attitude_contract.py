"""What every attitude filter must keep to."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from turned_phone import EARTH, GRAVITY, apart, followed, held, hops_of, side_by_side

from services.gateway.reckoning.attitude import Attitude
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.gradient_descent import GradientDescentFilter
from services.gateway.reckoning.hops import HOP, RATE, Hops

FILTERS = {"complementary": ComplementaryFilter, "gradient-descent": GradientDescentFilter}

pytestmark = pytest.mark.parametrize("filter_", [make() for make in FILTERS.values()], ids=list(FILTERS))


def time(seconds: float) -> np.ndarray:
    return np.arange(int(seconds * RATE)) / RATE


def walk(seconds: float, compass: float = 0.0) -> list[Hops]:
    """Bouncing and swaying while the phone nods."""
    t = time(seconds)
    attitude = held(compass + 0.1 * np.sin(2 * np.pi * 0.95 * t), 0.5 + 0.05 * np.sin(2 * np.pi * 1.9 * t))
    push = np.stack(
        [0.8 * np.sin(2 * np.pi * 0.95 * t), 1.5 * np.cos(2 * np.pi * 1.9 * t), 2.5 * np.sin(2 * np.pi * 1.9 * t)],
        axis=1,
    )
    return hops_of(attitude, push)


@settings(max_examples=20, deadline=None)
@given(compass=st.floats(-3.1, 3.1), pitch=st.floats(-1.5, 1.5), roll=st.floats(-3.1, 3.1))
def test_a_phone_at_rest_is_seen_as_it_lies(filter_: Attitude, compass: float, pitch: float, roll: float) -> None:
    truth = held(np.full(2 * HOP, compass), pitch, roll)
    assert apart(followed(filter_, hops_of(truth))[0], truth).max() < 0.5


def test_turns_about_every_axis_are_followed_at_once(filter_: Attitude) -> None:
    t = time(20.0)
    truth = held(2.0 * np.sin(0.7 * t), 0.6 * np.sin(1.1 * t), 0.8 * np.sin(0.5 * t))
    assert apart(followed(filter_, hops_of(truth))[0], truth).max() < 2.5


def test_walking_does_not_shake_it_off(filter_: Attitude) -> None:
    hops = walk(30.0, compass=1.0)
    t = time(30.0)
    truth = held(1.0 + 0.1 * np.sin(2 * np.pi * 0.95 * t), 0.5 + 0.05 * np.sin(2 * np.pi * 1.9 * t))
    assert apart(followed(filter_, hops)[0], truth)[2 * HOP :].max() < 6.0


def test_a_gyroscope_that_is_off_leaves_a_bounded_error(filter_: Attitude) -> None:
    """A hundredth of a radian a second adds up to 69 degrees in two minutes; gravity and compass hold it."""
    truth = held(np.full(120 * HOP, 0.4), 0.3)
    state = np.zeros(1, filter_.STATE)
    for hop in hops_of(truth):
        found = filter_.advance(state, hop, hop.rotation + 0.01)
    assert apart(found[0], truth[:HOP]).max() < 20.0


def test_without_a_compass_it_is_level_and_turned_by_an_angle_that_stays(filter_: Attitude) -> None:
    t = time(20.0)
    truth = held(1.0 + np.sin(0.5 * t), 0.4, 0.2)
    found = followed(filter_, hops_of(truth, field=np.full((len(t), 3), np.nan)))[0]
    np.testing.assert_allclose(found[:, 2], truth[:, 2], atol=0.02)
    off = found @ np.swapaxes(truth, 1, 2)
    assert np.degrees(np.ptp(np.unwrap(np.arctan2(off[:, 1, 0], off[:, 0, 0])))) < 2.0


def test_a_field_that_cannot_be_the_earths_turns_nothing(filter_: Attitude) -> None:
    truth = held(np.full(20 * HOP, 0.4))
    field = np.tile(EARTH, (len(truth), 1))
    field[5 * HOP : 15 * HOP] = [150.0, 0.0, 0.0]
    assert apart(followed(filter_, hops_of(truth, field=field))[0], truth).max() < 1.0


def test_a_compass_that_is_silent_for_a_while_is_believed_again(filter_: Attitude) -> None:
    truth = held(np.full(100 * HOP, 0.4))
    field = np.tile(EARTH, (len(truth), 1))
    field[2 * HOP : 4 * HOP] = np.nan
    state = np.zeros(1, filter_.STATE)
    for number, hop in enumerate(hops_of(truth, field=field)):
        drift = np.array([0.0, 0.0, 0.3]) if 2 <= number < 4 else np.zeros(3)
        found = filter_.advance(state, hop, hop.rotation + drift)
    assert apart(found[0], truth[:HOP]).max() < 1.0


def test_what_was_not_measured_leads_to_nothing(filter_: Attitude) -> None:
    """A hop that ends in a hole repeats its last sample."""
    (hop,) = hops_of(held(np.full(HOP, 0.4)))
    short = Hops(hop.t, np.array([20]), hop.fresh, hop.acceleration.copy(), hop.rotation, hop.field.copy())
    short.acceleration[:, 20:] = [9.81, 0.0, 0.0]
    short.field[:, 20:] = [30.0, 0.0, 0.0]
    found = followed(filter_, [short])[0, :20]
    np.testing.assert_allclose(found, held(np.full(20, 0.4)), atol=0.01)


def test_phones_do_not_see_each_other(filter_: Attitude) -> None:
    blind = hops_of(held(np.full(10 * HOP, 2.0)), field=np.full((10 * HOP, 3), np.nan))
    phones = [walk(10.0), blind, walk(10.0, compass=2.0)]
    alone = [followed(filter_, phone)[0] for phone in phones]
    for order in ([0, 1, 2], [2, 0, 1]):
        together = followed(filter_, side_by_side([phones[row] for row in order]))
        for place, row in enumerate(order):
            np.testing.assert_allclose(together[place], alone[row], atol=1e-9)


def test_a_state_of_zeros_knows_nothing_of_before(filter_: Attitude) -> None:
    hops = walk(5.0)
    state = np.zeros(1, filter_.STATE)
    for hop in walk(8.0, compass=-2.0):
        filter_.advance(state, hop, hop.rotation)
    state[:] = np.zeros(1, filter_.STATE)
    again = np.concatenate([filter_.advance(state, hop, hop.rotation) for hop in hops], axis=1)
    np.testing.assert_array_equal(again, followed(filter_, hops))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_any_samples_give_rotations(filter_: Attitude, seed: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(3, 2 * HOP, 9)) * rng.choice([0.0, 1.0, 30.0], size=(1, 2 * HOP, 1))
    values[:, :, 6:][rng.random((3, 2 * HOP)) < 0.3] = np.nan
    hops = [
        Hops(np.zeros(3), np.full(3, HOP), np.zeros(3, bool), *np.split(values[:, part], 3, axis=2))
        for part in (slice(HOP), slice(HOP, None))
    ]
    found = followed(filter_, hops)
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found @ np.swapaxes(found, 2, 3), np.broadcast_to(np.eye(3), found.shape), atol=1e-6)
    np.testing.assert_allclose(np.linalg.det(found), 1.0, atol=1e-6)


def test_gravity_alone_is_up(filter_: Attitude) -> None:
    (hop,) = hops_of(np.eye(3)[None].repeat(HOP, axis=0))
    up = np.einsum("nij,nj->ni", followed(filter_, [hop])[0], hop.acceleration[0])
    np.testing.assert_allclose(up, np.broadcast_to(GRAVITY, (HOP, 3)), atol=0.03)
