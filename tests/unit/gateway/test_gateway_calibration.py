"""Gyroscope's bias and phone's iron: told apart at rest and on the way, with their doubt until then."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.gait_walks import GARDEN, Walk, hops_of, twin_walk
from services.gateway.reckoning.calibration import Calibration
from services.gateway.reckoning.complementary import ComplementaryFilter
from services.gateway.reckoning.hops import HOP, RATE, Hops

EARTH = np.array([0.0, 30.0, -38.0])
IRON = np.array([-9.0, -7.0, 0.0])
BIAS = np.array([0.01, -0.02, 0.03])


def hops_of_a_turning_phone(heading: np.ndarray, pitch: float = 0.0, iron: np.ndarray = IRON) -> list[Hops]:
    """Of one phone that is turned to ``heading`` (n,) rad counter-clockwise, its top raised by ``pitch``."""
    attitude = Rotation.from_euler("z", heading[:, None]) * Rotation.from_euler("x", pitch)
    rate = np.vstack([(attitude[:-1].inv() * attitude[1:]).as_rotvec() * RATE, np.zeros(3)])
    rate = np.vstack([np.zeros(3), rate[:-1]])
    acceleration, field = attitude.inv().apply([0.0, 0.0, 9.81]), attitude.inv().apply(EARTH) + iron
    return [
        Hops(
            np.array([begin / RATE]),
            np.array([HOP]),
            np.array([begin == 0]),
            *(values[None, begin : begin + HOP] for values in (acceleration, rate, field)),
        )
        for begin in range(0, len(heading), HOP)
    ]


def there_and_back(seconds: int = 60) -> np.ndarray:
    """Straight, then a quarter turn every ten seconds."""
    t = np.arange(seconds * HOP) / RATE
    return np.interp(t, [9, 10, 19, 20, 29, 30, 39, 40], np.pi / 2 * np.array([0, 1, 1, 2, 2, 3, 3, 4]))


def still(rotation: np.ndarray, shake: float = 0.03, count: int = HOP) -> Hops:
    """A second without compass, by default at rest."""
    rng = np.random.default_rng(7)
    acceleration = np.array([0.0, 0.0, 9.81]) + rng.normal(0.0, shake, (1, HOP, 3))
    blind = np.full((1, HOP, 3), np.nan)
    return Hops(np.zeros(1), np.array([count]), np.array([False]), acceleration, rotation[None], blind)


def noise(mean: np.ndarray, sigma: float = 0.005) -> np.ndarray:
    return mean + np.random.default_rng(3).normal(0.0, sigma, (HOP, 3))


def advanced(hops: list[Hops], calibration: Calibration | None = None) -> tuple[Calibration, np.ndarray, Hops]:
    calibration = calibration or Calibration()
    state = np.zeros(1, calibration.STATE)
    for hop in hops:
        _, cleaned = calibration.advance(state, hop)
    return calibration, state, cleaned


def test_seconds_of_rest_tell_the_bias() -> None:
    calibration, state, _ = advanced([still(noise(BIAS))] * 3)
    np.testing.assert_allclose(state["bias"][0], BIAS, atol=0.003)
    rate, _ = calibration.advance(state, still(noise(BIAS)))
    assert np.abs(rate.mean(axis=1)).max() < 0.003


@pytest.mark.parametrize(
    "moving",
    [
        still(noise(BIAS), shake=1.0),  # walking
        still(noise(BIAS, sigma=0.2)),  # turning to and fro
        still(noise(BIAS + np.array([0.0, 0.0, 0.5]))),  # turning evenly, on a chair
        still(noise(BIAS), count=20),  # a hole
    ],
    ids=["walking", "shaking", "turning", "hole"],
)
def test_a_second_of_moving_is_not_taken_for_rest(moving: Hops) -> None:
    _, state, _ = advanced([moving])
    assert np.abs(state["bias"]).max() < 0.001


def test_it_follows_a_bias_that_wanders() -> None:
    hops = [still(noise(BIAS * (1.0 + second / 300))) for second in range(300)]
    np.testing.assert_allclose(advanced(hops)[1]["bias"][0], 2.0 * BIAS, rtol=0.15)


def test_a_random_walk_of_the_angle_stays_small_after_rest() -> None:
    """Without it a degree a second makes a minute's walk turn by sixty."""
    calibration, state, _ = advanced([still(noise(BIAS))] * 10)
    turned = sum(calibration.advance(state, still(noise(BIAS), shake=2.0))[0].sum(axis=1) / RATE for _ in range(60))
    assert np.degrees(np.abs(turned)).max() < 5.0


@pytest.mark.parametrize("bias", [np.zeros(3), np.array([0.008, -0.008, 0.01])])
@pytest.mark.parametrize("pitch", [0.0, 0.6])
def test_corners_tell_the_iron_but_for_what_is_upright_and_turns_no_compass(pitch: float, bias: np.ndarray) -> None:
    hops = [replace(hop, rotation=hop.rotation + bias) for hop in hops_of_a_turning_phone(there_and_back(), pitch)]
    _, state, cleaned = advanced(hops)
    upright = np.array([0.0, np.sin(pitch), np.cos(pitch)])
    for wrong in (state["iron"][0] - IRON, cleaned.field[0, 0] - (hops[-1].field[0, 0] - IRON)):
        assert np.linalg.norm(wrong - upright * (wrong @ upright)) < 2.0
    np.testing.assert_allclose(state["bias"][0], bias, atol=0.002)


def test_who_walks_straight_learns_nothing_of_iron_and_says_so() -> None:
    straight = hops_of_a_turning_phone(np.zeros(30 * HOP))
    calibration, state, _ = advanced(straight)
    assert np.abs(state["iron"]).max() < 0.1
    before = calibration.heading_variance(state)[0]
    assert before == pytest.approx((6.0 / np.hypot(*(EARTH + IRON)[:2])) ** 2, rel=0.1)
    for hop in hops_of_a_turning_phone(there_and_back())[1:]:
        calibration.advance(state, hop)
    assert calibration.heading_variance(state)[0] < 0.25 * before


def test_a_phone_without_iron_keeps_its_field() -> None:
    hops = hops_of_a_turning_phone(there_and_back(), iron=np.zeros(3))
    _, _, cleaned = advanced(hops)
    assert cleaned.field == pytest.approx(hops[-1].field, abs=0.2)


def test_iron_can_be_left_in() -> None:
    hops = hops_of_a_turning_phone(there_and_back())
    assert np.array_equal(advanced(hops, Calibration(iron_sigma=0.0))[2].field, hops[-1].field)


def test_bias_and_iron_are_kept_over_a_hole() -> None:
    biased = [replace(hop, rotation=hop.rotation + 0.01) for hop in hops_of_a_turning_phone(there_and_back())]
    calibration, state, _ = advanced(biased)
    iron, bias = state["iron"].copy(), state["bias"].copy()
    first = hops_of_a_turning_phone(np.full(HOP, 1.0))[0]
    first = replace(first, rotation=first.rotation + 0.01)
    _, cleaned = calibration.advance(state, first)
    assert state["iron"][0, :2] == pytest.approx(iron[0, :2], abs=2.0)
    assert state["bias"] == pytest.approx(bias, abs=0.001)
    assert np.abs(cleaned.field[..., :2] - (first.field - IRON)[..., :2]).max() < 3.0


def test_missing_and_impossible_fields_teach_nothing() -> None:
    for value in (np.nan, 500.0):
        hops = [replace(hop, field=np.full_like(hop.field, value)) for hop in hops_of_a_turning_phone(there_and_back())]
        calibration, state, cleaned = advanced(hops)
        assert np.array_equal(cleaned.field, hops[-1].field, equal_nan=True)
        assert np.isfinite(calibration.heading_variance(state)).all()


def test_phones_do_not_disturb_each_other() -> None:
    calibration = Calibration()
    one, two = hops_of_a_turning_phone(there_and_back()), hops_of_a_turning_phone(np.zeros(60 * HOP))
    both, alone = np.zeros(2, calibration.STATE), np.zeros(1, calibration.STATE)
    for a, b in zip(one, two, strict=True):
        joined = Hops(*(np.concatenate([getattr(a, n), getattr(b, n)]) for n in Hops.__dataclass_fields__))
        calibration.advance(both, joined)
        calibration.advance(alone, a)
    assert both["iron"][0] == pytest.approx(alone["iron"][0])
    assert both["bias"][0] == pytest.approx(alone["bias"][0])


def test_hours_of_anything_leave_it_finite_and_its_doubt_positive() -> None:
    calibration, rng = Calibration(), np.random.default_rng(5)
    state = np.zeros(3, calibration.STATE)
    for second in range(3600):
        size = rng.choice([0.01, 1.0, 30.0], size=(3, 1, 1))
        rotation = size * rng.normal(size=(3, HOP, 3))
        field = np.where(rng.random((3, 1, 1)) < 0.3, np.nan, rng.normal(0.0, 25.0, (3, 1, 3)) + np.zeros((3, HOP, 3)))
        acceleration = [0.0, 0.0, 9.81] + size * rng.normal(size=(3, HOP, 3))
        fresh = rng.random(3) < 0.01
        calibration.advance(
            state, Hops(np.full(3, float(second)), np.full(3, HOP), fresh, acceleration, rotation, field)
        )
    assert np.linalg.eigvalsh(state["covariance"]).min() > -1e-9
    assert np.abs(state["bias"]).max() <= Calibration.LARGEST_BIAS
    assert np.isfinite(state["iron"]).all()
    np.testing.assert_allclose(
        state["frame"] @ np.swapaxes(state["frame"], 1, 2), np.eye(3) + np.zeros((3, 3, 3)), atol=1e-6
    )


def yaw_errors(walk: Walk) -> np.ndarray:
    """Return by how many degrees the compass of the gateway is off, second by second."""
    calibration, attitude = Calibration(), ComplementaryFilter()
    states = np.zeros(1, calibration.STATE), np.zeros(1, attitude.STATE)
    off = []
    for second, hop in enumerate(hops_of([walk])):
        rate, hops = calibration.advance(states[0], hop)
        found = attitude.advance(states[1], hops, rate)[0, -1]
        turn = found @ walk.truth[(second + 1) * HOP - 1].T
        off.append(np.degrees(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1])))
    return np.abs(off)


@pytest.mark.parametrize("carrying", ["hand", "pocket"])
def test_a_phone_that_never_rests_keeps_its_heading(carrying: Literal["hand", "pocket"]) -> None:
    """A hundredth of a radian a second, about each axis, on top of what the twin's phones are off by."""
    errors = []
    for seed in (3, 4):
        walk = twin_walk(seed, GARDEN, carrying=carrying)
        errors.append(yaw_errors(replace(walk, rate=walk.rate + 0.01)))
    assert max(np.median(one[60:]) for one in errors) < 2.5
    assert max(np.quantile(one[120:], 0.9) for one in errors) < 4.0
