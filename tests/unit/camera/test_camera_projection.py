"""Feet to floor: right place, honest uncertainty, nothing outside the area of interest or above the horizon."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.camera.detector import Detections
from services.camera.projection import GroundDetections, Projection, aligned
from shared.site import CameraGeometry

GEOMETRY = CameraGeometry.from_pose((768, 576), (0.0, 0.0, 4.0), (0.0, 10.0, 0.0), math.radians(60))


def seen(geometry: CameraGeometry, places: list[tuple[float, float]]) -> Detections:
    """What a perfect detector finds of people 1.75 m tall."""
    ground = np.array(places, float).reshape(-1, 2)
    feet = geometry.to_image(np.column_stack([ground, np.zeros(len(ground))]))
    heads = geometry.to_image(np.column_stack([ground, np.full(len(ground), 1.75)]))
    height = np.abs(feet[:, 1] - heads[:, 1])
    boxes = np.column_stack([feet[:, 0] - 0.2 * height, heads[:, 1], 0.4 * height, height])
    return Detections(feet, boxes, np.full(len(ground), 0.8))


@settings(max_examples=50, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(6.0, 30.0), st.sampled_from([(768, 576), (480, 360), (384, 288), (1536, 1152)]))
def test_people_are_where_they_stand_at_every_picture_size(x: float, y: float, size: tuple[int, int]) -> None:
    found = Projection(GEOMETRY, size).to_floor(seen(GEOMETRY.scaled_to(*size), [(x, y)]))
    assert found.positions == pytest.approx(np.array([[x, y]]), abs=1e-6)


def test_covariance_grows_with_distance_and_stretches_along_the_line_of_sight() -> None:
    places = [(0.0, y) for y in (6.0, 10.0, 15.0, 20.0, 30.0)]
    found = Projection(GEOMETRY, (768, 576)).to_floor(seen(GEOMETRY, places))
    across, along = found.covariances[:, 0, 0], found.covariances[:, 1, 1]
    assert np.all(np.diff(along) > 0.0)
    assert np.all(along > across)
    assert np.all(np.linalg.eigvalsh(found.covariances) > 0.0)


def test_covariance_in_metres_does_not_depend_on_the_picture_size() -> None:
    large = Projection(GEOMETRY, (768, 576)).to_floor(seen(GEOMETRY, [(2.0, 12.0)]))
    small = Projection(GEOMETRY, (384, 288)).to_floor(seen(GEOMETRY.scaled_to(384, 288), [(2.0, 12.0)]))
    assert small.covariances == pytest.approx(large.covariances, rel=0.01)


def test_what_stands_above_the_horizon_or_outside_the_picture_is_dropped() -> None:
    feet = np.array([[384.0, 5.0], [384.0, 500.0], [-30.0, 500.0], [384.0, 600.0]])
    boxes = np.tile([300.0, 300.0, 50.0, 150.0], (4, 1))
    geometry = CameraGeometry.from_pose((768, 576), (0.0, 0.0, 4.0), (0.0, 20.0, 3.0), math.radians(60))
    found = Projection(geometry, (768, 576)).to_floor(Detections(feet, boxes, np.ones(4)))
    assert len(found.positions) == 1
    assert np.isfinite(found.covariances).all()


def test_the_area_of_interest_is_drawn_in_pixels_of_the_calibration_whatever_the_picture_size() -> None:
    interest = [(0.0, 288.0), (384.0, 288.0), (384.0, 576.0), (0.0, 576.0)]  # the lower left quarter
    people = [(-1.5, 7.0), (1.5, 7.0), (-3.0, 25.0)]

    def kept(size: tuple[int, int]) -> GroundDetections:
        return Projection(GEOMETRY, size, interest).to_floor(seen(GEOMETRY.scaled_to(*size), people))

    for size in ((768, 576), (480, 360)):
        assert kept(size).positions == pytest.approx(np.array([[-1.5, 7.0]]), abs=1e-6)


def test_nobody_is_no_trouble() -> None:
    found = Projection(GEOMETRY, (768, 576), [(0, 0), (100, 0), (0, 100)]).to_floor(Detections.none())
    assert found.positions.shape == (0, 2)
    assert found.covariances.shape == (0, 2, 2)


def test_a_learned_correction_moves_people_and_their_uncertainty_and_the_unit_matrix_takes_it_back() -> None:
    found = Projection(GEOMETRY, (768, 576)).to_floor(seen(GEOMETRY, [(0.0, 8.0), (1.5, 12.0)]))
    same = aligned(found, np.eye(3))
    assert same.positions == pytest.approx(found.positions)
    assert same.covariances == pytest.approx(found.covariances)
    turned = np.array([[0.0, -1.0, 2.0], [1.0, 0.0, 3.0], [0.0, 0.0, 1.0]])
    moved = aligned(found, turned)
    assert moved.positions == pytest.approx(np.column_stack([2.0 - found.positions[:, 1], 3.0 + found.positions[:, 0]]))
    assert moved.covariances[:, 0, 0] == pytest.approx(found.covariances[:, 1, 1])
    bent = np.array([[1.1, 0.05, 0.5], [-0.02, 0.95, -0.3], [0.004, 0.01, 1.0]])
    for place, spread, row in zip(found.positions, aligned(found, bent).covariances, range(2), strict=True):
        near = GroundDetections(
            place + 1e-5 * np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]),
            np.tile(np.eye(2), (4, 1, 1)), np.zeros((4, 4)), np.ones(4),
        )  # fmt: skip
        at = aligned(near, bent).positions
        jacobian = np.column_stack([at[0] - at[1], at[2] - at[3]]) / 2e-5
        assert spread == pytest.approx(jacobian @ found.covariances[row] @ jacobian.T, rel=1e-4)


def test_nobody_comes_to_stand_beyond_the_horizon_of_a_correction() -> None:
    found = Projection(GEOMETRY, (768, 576)).to_floor(seen(GEOMETRY, [(0.0, 8.0), (1.5, 25.0)]))
    kept = aligned(found, np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -0.05, 1.0]]))
    assert len(kept.positions) == len(kept.boxes) == len(kept.confidence) == len(kept.covariances) == 1
