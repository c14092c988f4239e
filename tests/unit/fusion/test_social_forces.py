"""Forces of people, walls and obstacles on predictions, against plain loops and finite differences."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.fusion.forces import ForceSettings, Obstacles, displacement
from services.fusion.forces.obstacles import REACH

Array = NDArray[np.float64]

NOTHING = Obstacles.build()
AT_ONCE = ForceSettings(substeps=1)


def oracle(
    positions: Array,
    alive: NDArray[np.bool_],
    heading: Array,
    discs: Array,
    walls: list[tuple[Array, Array]],
    s: ForceSettings,
    walk: Array,
) -> tuple[Array, Array]:
    """Equations 4.7 to 4.13 pair by pair; walls are straight, apart from each other and not reached by any step."""
    shift, jacobian = np.zeros_like(positions), np.zeros((*alive.shape, 2, 2))
    scale = s.dt**2 / (2.0 * s.mass)
    for particle in range(alive.shape[0]):
        for i in range(alive.shape[1]):
            jacobian[particle, i] = np.eye(2)
            if not alive[particle, i]:
                continue
            angle = heading[particle, i]
            wish = np.zeros(2) if math.isnan(angle) else np.array([math.cos(angle), math.sin(angle)])
            pushed, turned = np.zeros(2), np.zeros((2, 2))
            for j in range(alive.shape[1]):
                if j != i and alive[particle, j]:
                    f, g = _pair(positions[particle, i], positions[particle, j], 2 * s.radius, True, 0.0, wish, s)
                    pushed, turned = pushed + f, turned + g
            at = positions[particle, i].copy()
            for _ in range(s.substeps):
                force, slope = pushed.copy(), np.zeros((2, 2))
                for x, y, radius in discs:
                    f, g = _pair(at, np.array([x, y]), s.radius + radius, True, s.contact, wish, s, REACH + radius)
                    force, slope = force + f, slope + g
                for a, b in walls:
                    share = float(np.clip((at - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0))
                    f, g = _pair(at, a + share * (b - a), s.radius, share in (0.0, 1.0), s.contact, wish, s)
                    force, slope = force + f, slope + g
                step = scale / s.substeps
                jacobian[particle, i] = jacobian[particle, i] + step * (turned + slope @ jacobian[particle, i])
                at = at + walk[particle, i] / s.substeps + step * force
            shift[particle, i] = at - positions[particle, i] - walk[particle, i]
    return shift, jacobian


def _pair(
    at: Array, other: Array, r: float, bends: bool, contact: float, wish: Array, s: ForceSettings, reach: float = REACH
) -> tuple[Array, Array]:
    d = float(np.linalg.norm(at - other))
    if d > reach:
        return np.zeros(2), np.zeros((2, 2))
    n = (at - other) / d
    gamma = s.behind + (1 - s.behind) * (1 + float(-n @ wish)) / 2
    push = s.push * math.exp((r - d) / s.range)
    curve = 1.0 / max(d, s.radius) if bends else 0.0
    flat = np.outer(n, n)
    side = np.eye(2) - flat
    force = (push * gamma + contact * max(r - d, 0.0)) * n
    slope = push * (gamma * (-flat / s.range + curve * side) - (1 - s.behind) / 2 * curve * np.outer(n, side @ wish))
    if r > d:
        slope = slope + contact * (-flat + (r - d) * curve * side)
    return force, slope


def alone(x: float, y: float, heading: float = math.nan) -> tuple[Array, NDArray[np.bool_], Array]:
    return np.array([[[x, y]]]), np.ones((1, 1), np.bool_), np.array([[heading]])


@pytest.mark.parametrize("seed", range(4))
def test_agrees_with_plain_loops(seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.uniform(0.0, 6.0, (3, 5, 2))
    alive = rng.random((3, 5)) < 0.8
    heading = np.where(rng.random((3, 5)) < 0.7, rng.uniform(-3.0, 3.0, (3, 5)), np.nan)
    walk = rng.normal(0.0, 0.2, (3, 5, 2))
    discs = np.column_stack([rng.uniform(0.0, 6.0, (3, 2)), rng.uniform(0.1, 0.5, 3)])
    walls = [(np.array([-1.0, -0.8]), np.array([7.0, -1.2])), (np.array([-1.0, 7.0]), np.array([2.0, 6.8]))]
    obstacles = Obstacles.build(walls=shapely.MultiLineString([np.array(wall) for wall in walls]), discs=discs)
    strengths = ForceSettings(substeps=seed + 1)
    shift, jacobian = displacement(positions, alive, heading, obstacles, strengths, walk)
    expected_shift, expected_jacobian = oracle(positions, alive, heading, discs, walls, strengths, walk)
    assert np.abs(expected_shift).max() > 0.1
    np.testing.assert_allclose(shift, expected_shift, atol=1e-9)
    np.testing.assert_allclose(jacobian, expected_jacobian, atol=1e-9)


@pytest.mark.parametrize(("gap", "metres"), [(0.0, 0.36), (0.5, 0.13), (1.0, 0.05), (-0.2, 0.53 + 0.36)])
def test_one_disc_pushes_as_far_as_the_sheet_says(gap: float, metres: float) -> None:
    """At touch 0.36 m, at half a metre 0.13 m; an overlap of 0.2 m adds 0.36 m to what the push is there."""
    place, alive, heading = alone(-(0.5 + gap), 0.0, heading=0.0)
    shift, _ = displacement(place, alive, heading, Obstacles.build(discs=np.array([[0.0, 0.0, 0.3]])), AT_ONCE)
    assert shift[0, 0] == pytest.approx([-metres, 0.0], abs=0.006)


def test_what_lies_behind_pushes_half_as_much() -> None:
    disc = Obstacles.build(discs=np.array([[0.0, 0.0, 0.3]]))
    ahead, behind, unknown = (
        displacement(*alone(-1.0, 0.0, heading), disc, AT_ONCE)[0][0, 0, 0] for heading in (0.0, math.pi, math.nan)
    )
    assert behind == pytest.approx(0.5 * ahead)
    assert unknown == pytest.approx(0.75 * ahead)


@settings(max_examples=30, deadline=None)
@given(
    gap=st.floats(0.03, 1.2),
    bearing=st.floats(-3.1, 3.1),
    heading=st.floats(-3.1, 3.1),
    apart=st.floats(0.5, 1.2),
    wall=st.floats(0.3, 1.5),
    speed=st.floats(0.0, 0.2),
)
def test_the_jacobian_is_the_derivative(
    gap: float, bearing: float, heading: float, apart: float, wall: float, speed: float
) -> None:
    """Of people, a disc at touch or not, and a straight wall, over several sub-steps."""
    disc = np.array([[0.0, 0.0, 0.2]])
    start = (0.4 + gap) * np.array([math.cos(bearing), math.sin(bearing)])
    line = shapely.LineString([(-9.0, start[1] - wall), (9.0, start[1] - wall)])
    obstacles = Obstacles.build(walls=line, discs=disc)
    positions = np.array([[start, start + np.array([apart, 0.3])]])
    alive, angles = np.ones((1, 2), np.bool_), np.array([[heading, 0.0]])
    walk = np.zeros((1, 2, 2))
    walk[0, 0] = speed * np.array([math.cos(heading), math.sin(heading)])
    strengths = ForceSettings(substeps=3, contact=0.0)

    def moved(place: Array) -> Array:
        places = positions.copy()
        places[0, 0] = place
        result: Array = place + displacement(places, alive, angles, obstacles, strengths, walk)[0][0, 0]
        return result

    _, jacobian = displacement(positions, alive, angles, obstacles, strengths, walk)
    small = 1e-6
    columns = [(moved(start + small * axis) - moved(start - small * axis)) / (2 * small) for axis in np.eye(2)]
    np.testing.assert_allclose(jacobian[0, 0], np.column_stack(columns), atol=2e-5)


def test_the_jacobian_is_the_derivative_in_contact() -> None:
    obstacles = Obstacles.build(discs=np.array([[0.0, 0.0, 0.3]]))
    start = np.array([0.3, -0.25])

    def moved(place: Array) -> Array:
        result: Array = place + displacement(place[None, None], *alone(0, 0, 1.0)[1:], obstacles, AT_ONCE)[0][0, 0]
        return result

    _, jacobian = displacement(start[None, None], *alone(0, 0, 1.0)[1:], obstacles, AT_ONCE)
    columns = [(moved(start + 1e-6 * axis) - moved(start - 1e-6 * axis)) / 2e-6 for axis in np.eye(2)]
    np.testing.assert_allclose(jacobian[0, 0], np.column_stack(columns), atol=1e-6)


def test_people_touch_only_where_asked_to() -> None:
    positions, alive, heading = np.array([[[0.0, 0.0], [0.3, 0.0]]]), np.ones((1, 2), np.bool_), np.zeros((1, 2))
    apart, _ = displacement(positions, alive, heading, NOTHING, AT_ONCE)
    touching, _ = displacement(positions, alive, heading, NOTHING, replace(AT_ONCE, people_contact=250.0))
    assert apart[0, 0, 0] - touching[0, 0, 0] == pytest.approx(250.0 * 0.1 / 140.0)


def test_who_is_not_there_neither_pushes_nor_moves() -> None:
    positions, heading = np.array([[[0.0, 0.0], [0.5, 0.0]]]), np.zeros((1, 2))
    shift, jacobian = displacement(positions, np.array([[True, False]]), heading, NOTHING, ForceSettings())
    assert not shift.any()
    assert (jacobian == np.eye(2)).all()


def test_one_particle_does_not_see_the_people_of_another() -> None:
    rng = np.random.default_rng(3)
    positions, alive, heading = rng.uniform(0, 3, (4, 3, 2)), np.ones((4, 3), np.bool_), rng.uniform(-3, 3, (4, 3))
    together, _ = displacement(positions, alive, heading, NOTHING, ForceSettings())
    for number in range(4):
        one = slice(number, number + 1)
        single, _ = displacement(positions[one], alive[one], heading[one], NOTHING, ForceSettings())
        np.testing.assert_array_equal(together[one], single)


def test_nobody_is_no_error() -> None:
    shift, jacobian = displacement(np.zeros((5, 0, 2)), np.zeros((5, 0), np.bool_), np.zeros((5, 0)), NOTHING, AT_ONCE)
    assert shift.shape == (5, 0, 2)
    assert jacobian.shape == (5, 0, 2, 2)
