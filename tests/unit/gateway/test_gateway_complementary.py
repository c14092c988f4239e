"""The thesis' filter, sample by sample, beside the one that takes a hop of all phones at once."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from turned_phone import EARTH, apart, followed, held, hops_of

from services.gateway.reckoning.complementary import ComplementaryFilter, angles, cosine_matrix, measured_angles
from services.gateway.reckoning.hops import HOP, RATE, Hops

DEGREE = st.floats(-1.4, 1.4)


def renormalised(matrix: np.ndarray) -> np.ndarray:
    """Premerlani and Bizard."""
    x, y, _ = matrix
    error = x @ y
    x, y = x - 0.5 * error * y, y - 0.5 * error * x
    rows = np.stack([x, y, np.cross(x, y)])
    return rows * 0.5 * (3.0 - np.sum(rows**2, axis=1, keepdims=True))


def literal(hops: list[Hops], share: float = 0.98) -> np.ndarray:
    """Eqs. 3.5-3.17 as printed, for the first phone."""
    fused: np.ndarray | None = None
    path = []
    for hop in hops:
        for a, w, m in zip(hop.acceleration[0], hop.rotation[0] / RATE, hop.field[0], strict=True):
            measured = cosine_matrix(measured_angles(a, m))
            beta, gamma, alpha = w
            step = np.array([[1.0, -alpha, gamma], [alpha, 1.0, -beta], [-gamma, beta, 1.0]])
            fused = renormalised(share * (measured if fused is None else fused) @ step + (1.0 - share) * measured)
            path.append(fused)
    return np.array(path)


def walk(seconds: float) -> list[Hops]:
    """To the north, a left turn after half of the time; nodding, swaying, with noise."""
    rng = np.random.default_rng(4)
    t = np.arange(int(seconds * RATE)) / RATE
    step = 2 * np.pi * 1.9 * t
    compass = -0.5 * np.pi * np.clip(t - 0.5 * seconds, 0.0, 1.5) / 1.5 + 0.08 * np.sin(0.5 * step)
    push = np.stack([0.5 * np.sin(0.5 * step), 1.0 * np.cos(step), 2.0 * np.sin(step)], axis=1)
    field = EARTH + rng.normal(0.0, 1.0, (len(t), 3))
    return hops_of(held(compass, 0.5 + 0.05 * np.sin(step)), push + rng.normal(0.0, 0.2, push.shape), field)


def test_agrees_with_the_thesis_recursion_to_a_degree_in_a_walk() -> None:
    hops = walk(30.0)
    mine = followed(ComplementaryFilter(level_tau=0.98, compass_tau=0.98), hops)[0]
    off = apart(mine, literal(hops))[4 * HOP :]
    assert np.median(off) < 1.0
    yaw = np.degrees(angles(mine)[:, 0] - angles(literal(hops))[:, 0])[4 * HOP :]
    assert np.abs(np.median(np.remainder(yaw + 180.0, 360.0) - 180.0)) < 1.0


def test_agrees_with_the_thesis_recursion_closely_where_measurements_agree() -> None:
    t = np.arange(20 * HOP) / RATE
    hops = hops_of(held(0.5 * np.sin(0.6 * t), 0.3 * np.sin(0.9 * t)))
    mine = followed(ComplementaryFilter(level_tau=0.98, compass_tau=0.98), hops)[0]
    assert apart(mine, literal(hops)).max() < 0.2


@given(DEGREE, DEGREE, DEGREE)
def test_angles_and_matrices_are_the_same_thing(alpha: float, beta: float, gamma: float) -> None:
    np.testing.assert_allclose(angles(cosine_matrix(np.array([alpha, beta, gamma]))), [alpha, beta, gamma], atol=1e-9)


@given(DEGREE, DEGREE, DEGREE)
def test_gravity_and_field_tell_the_angles(alpha: float, beta: float, gamma: float) -> None:
    """Equations 3.5-3.7 invert 3.13."""
    to_earth = cosine_matrix(np.array([alpha, beta, gamma]))
    found = measured_angles(to_earth.T @ [0.0, 0.0, 9.81], to_earth.T @ EARTH)
    np.testing.assert_allclose(found, [alpha, beta, gamma], atol=1e-9)


@pytest.mark.parametrize(("alpha", "top"), [(0.0, (0.0, 1.0)), (90.0, (-1.0, 0.0)), (180.0, (0.0, -1.0))])
def test_alpha_counts_counter_clockwise_from_north(alpha: float, top: tuple[float, float]) -> None:
    matrix = cosine_matrix(np.radians([alpha, 0.0, 0.0]))
    np.testing.assert_allclose(matrix @ [0.0, 1.0, 0.0], [*top, 0.0], atol=1e-12)
