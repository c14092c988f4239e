"""The plan on Earth: there and back, and held against what is known of the ellipsoid."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from shared.site.geographic import PlanOnEarth

metres = st.floats(-7000.0, 7000.0)
earths = st.builds(
    PlanOnEarth,
    latitude=st.floats(-85.0, 85.0),
    longitude=st.floats(-180.0, 180.0),
    north=st.floats(-2.0 * math.pi, 2.0 * math.pi),
)


@given(earths, metres, metres)
def test_there_and_back_is_the_same_place(earth: PlanOnEarth, x: float, y: float) -> None:
    there = earth.to_wgs84(np.array([[x, y]]))
    assert abs(there[0, 0]) <= 180.0
    np.testing.assert_allclose(earth.to_plan(there), [[x, y]], atol=1e-3)


@given(earths, metres, metres)
def test_lengths_are_those_of_the_ellipsoid(earth: PlanOnEarth, x: float, y: float) -> None:
    """Oracle: radii of curvature at the middle latitude, good to metres in ten kilometres."""
    longitude, latitude = np.radians(earth.to_wgs84(np.array([[x, y]]))[0])
    start = math.radians(earth.latitude)
    middle = (latitude + start) / 2.0
    e2 = 0.00669437999014
    w = math.sqrt(1.0 - e2 * math.sin(middle) ** 2)
    turn = math.remainder(longitude - math.radians(earth.longitude), 2.0 * math.pi)
    north = (latitude - start) * 6378137.0 * (1.0 - e2) / w**3
    east = turn * math.cos(middle) * 6378137.0 / w
    assert math.hypot(north, east) == pytest.approx(math.hypot(x, y), rel=2e-4, abs=0.01)


def test_north_up_on_the_plan_is_north_on_earth_and_a_turned_plan_turns() -> None:
    up = PlanOnEarth(48.86, 2.33, math.radians(90.0)).to_wgs84(np.array([[0.0, 0.0], [0.0, 100.0], [100.0, 0.0]]))
    assert up[1, 1] > up[0, 1]
    assert up[1, 0] == pytest.approx(up[0, 0], abs=1e-12)
    assert up[2, 0] > up[0, 0]
    right = PlanOnEarth(48.86, 2.33, 0.0).to_wgs84(np.array([[100.0, 0.0]]))
    np.testing.assert_allclose(right[0], up[1], atol=1e-12)


@pytest.mark.parametrize("place", [[2.33, 49.86], [-177.67, -48.86], [2.33, math.nan], [182.33, 48.86]])
def test_places_far_from_the_site_are_refused(place: list[float]) -> None:
    with pytest.raises(ValueError, match="10 km"):
        PlanOnEarth(48.86, 2.33, 1.0).to_plan(np.array([place]))
