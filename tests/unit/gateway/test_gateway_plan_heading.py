"""The heading trap: compasses count clockwise from north, plans counter-clockwise from +x."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.gateway.reckoning.plan_heading import plan_heading


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
        (0.0, 87.0, 87.0),  # true north is up and the compass points 3 degrees east of it
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
