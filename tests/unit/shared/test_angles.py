"""Angles of any size, brought to one turn."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from shared.angles import wrap


def test_half_a_turn_to_either_side_is_the_same_half_turn() -> None:
    assert wrap(np.array([np.pi, -np.pi])).tolist() == [np.pi, np.pi]


@given(st.floats(-1e3, 1e3))
def test_an_angle_points_where_it_pointed(angle: float) -> None:
    (found,) = wrap(np.array([angle]))
    assert -np.pi < found <= np.pi
    np.testing.assert_allclose([np.cos(found), np.sin(found)], [np.cos(angle), np.sin(angle)], atol=1e-9)
