"""The heading trap: compasses count clockwise from north, plans counter-clockwise from +x."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.gateway.reckoning.heading import UNKNOWN_VARIANCE, HeadingFilter, plan_heading
from services.gateway.reckoning.resampling import RATE

EARTH = np.array([0.0, 20.0, -43.0])  # east, north, up; µT


def phone_axes(compass: np.ndarray, pitch: float = 0.0, roll: float = 0.0) -> np.ndarray:
    """(n, 3, 3): rows are the phone's x, y, z in (east, north, up), its top pointing along ``compass``."""
    east, north = np.sin(compass), np.cos(compass)
    zero, one = np.zeros_like(east), np.ones_like(east)
    y = np.stack([east * math.cos(pitch), north * math.cos(pitch), one * math.sin(pitch)], axis=1)
    flat_x = np.stack([north, -east, zero], axis=1)
    flat_z = np.cross(flat_x, y)
    x = flat_x * math.cos(roll) - flat_z * math.sin(roll)
    return np.stack([x, y, np.cross(x, y)], axis=1)


def sensors(compass: np.ndarray, pitch: float = 0.0, roll: float = 0.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    axes = phone_axes(compass, pitch, roll)
    acceleration = axes @ np.array([0.0, 0.0, 9.81])
    turning = -np.gradient(compass) * RATE  # counter-clockwise seen from above
    rotation = axes @ np.array([0.0, 0.0, 1.0]) * turning[:, None]
    return acceleration, rotation, axes @ EARTH


def test_a_walk_north_leads_north_on_the_plan() -> None:
    north_is_plus_y = math.pi / 2
    acceleration, rotation, field = sensors(np.zeros(100))
    headings = HeadingFilter().push(acceleration, rotation, field)
    heading = plan_heading(headings.heading[-1:], north_is_plus_y)[0]
    assert (math.cos(heading), math.sin(heading)) == pytest.approx((0.0, 1.0), abs=1e-6)


@pytest.mark.parametrize(
    ("compass", "north", "expected"),
    [
        (0.0, 90.0, 90.0),  # north is up: walking north goes up
        (90.0, 90.0, 0.0),  # east goes along +x
        (180.0, 90.0, -90.0),
        (270.0, 90.0, 180.0),
        (0.0, 0.0, 0.0),  # a plan turned so that north is +x
        (90.0, 0.0, -90.0),
        (45.0, 120.0, 75.0),
    ],
)
def test_compass_headings_become_plan_headings(compass: float, north: float, expected: float) -> None:
    found = plan_heading(np.array([math.radians(compass)]), math.radians(north))[0]
    assert math.degrees(found) == pytest.approx(expected)


@given(st.floats(-50, 50), st.floats(-6.3, 6.3))
def test_plan_headings_lie_in_one_turn(compass: float, north: float) -> None:
    found = float(plan_heading(np.array([compass]), north)[0])
    assert -math.pi < found <= math.pi + 1e-12
    assert math.cos(found - (north - compass)) == pytest.approx(1.0)


@given(
    compass=st.floats(-math.pi, math.pi),
    pitch=st.floats(-0.7, 0.7),
    roll=st.floats(-0.7, 0.7),
)
def test_a_tilted_phone_at_rest_knows_its_heading(compass: float, pitch: float, roll: float) -> None:
    headings = HeadingFilter().push(*sensors(np.full(60, compass), pitch, roll))
    assert math.cos(headings.heading[-1] - compass) == pytest.approx(1.0, abs=1e-6)


def test_a_phone_held_upright_points_away_from_its_screen() -> None:
    headings = HeadingFilter().push(*sensors(np.full(60, 0.5), pitch=math.radians(80)))
    assert math.cos(headings.heading[-1] - 0.5) == pytest.approx(1.0, abs=1e-6)


def test_turns_are_followed_at_once_and_in_any_number_of_pushes() -> None:
    compass = np.concatenate([np.zeros(200), np.linspace(0, 5 * math.pi, 400), np.full(200, 5 * math.pi)])
    acceleration, rotation, field = sensors(compass)
    whole = HeadingFilter().push(acceleration, rotation, field).heading
    assert np.abs(np.angle(np.exp(1j * (whole - compass)))).max() < math.radians(3)
    heading_filter = HeadingFilter()
    cuts = np.array_split(np.arange(800), 13)
    parts = [heading_filter.push(acceleration[cut], rotation[cut], field[cut]).heading for cut in cuts]
    assert np.abs(np.angle(np.exp(1j * (np.concatenate(parts) - whole)))).max() < 1e-9


def test_a_magnet_nearby_does_not_turn_the_heading_and_a_missing_compass_is_admitted() -> None:
    acceleration, rotation, field = sensors(np.zeros(600))
    field[300:350] = [150.0, 0.0, 0.0]
    disturbed = HeadingFilter().push(acceleration, rotation, field)
    assert np.abs(disturbed.heading).max() < 1e-6
    assert np.all(HeadingFilter().push(acceleration, rotation, None).variance == UNKNOWN_VARIANCE)


def test_a_compass_that_disagrees_with_the_gyroscope_is_trusted_less() -> None:
    acceleration, rotation, field = sensors(np.zeros(600))
    calm = HeadingFilter().push(acceleration, rotation, field).variance[-1]
    field[300:] = sensors(np.full(300, 1.0))[2]  # the field turns, the phone does not
    assert HeadingFilter().push(acceleration, rotation, field).variance[-1] > 2 * calm
