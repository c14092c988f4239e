"""Splitting of blobs, against a slow and obvious oracle and on masks drawn from the geometry itself."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.camera.splitting import PersonTemplates, _integral, _sums
from shared.site import CameraGeometry

OBLIQUE = CameraGeometry.from_pose((480, 360), (0.0, 0.0, 5.0), (0.0, 12.0, 0.0), math.radians(60))
WIDE = CameraGeometry.from_pose((480, 360), (0.0, -3.0, 7.0), (0.0, 4.0, 0.0), math.radians(90))
ABOVE = CameraGeometry.from_pose((480, 360), (0.0, 0.0, 6.0), (0.0, 0.0, 0.0), math.radians(80))


@pytest.fixture(scope="module", params=["oblique", "wide", "above"])
def camera(request: pytest.FixtureRequest) -> tuple[CameraGeometry, PersonTemplates]:
    geometry = {"oblique": OBLIQUE, "wide": WIDE, "above": ABOVE}[request.param]
    return geometry, PersonTemplates.build(geometry, 1.75, 0.4, 0.3)


def silhouette(geometry: CameraGeometry, places: list[tuple[float, float]]) -> NDArray[np.uint8]:
    """The mask that upright cylinders of a person's size leave, drawn point by point."""
    width, height = geometry.image_size
    mask = np.zeros((height, width), np.uint8)
    angle, level, radius = np.meshgrid(
        np.linspace(0, 2 * np.pi, 60), np.linspace(0, 1.75, 120), np.linspace(0, 0.22, 12)
    )
    for x, y in places:
        points = np.column_stack(
            [(x + radius * np.cos(angle)).ravel(), (y + radius * np.sin(angle)).ravel(), level.ravel()]
        )
        u, v = np.rint(geometry.to_image(points)).astype(int).T
        inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
        mask[v[inside], u[inside]] = 1
    return mask


def positions(geometry: CameraGeometry, templates: PersonTemplates, mask: NDArray[np.uint8]) -> NDArray[np.float64]:
    return geometry.to_ground(templates.split(mask.copy(), 0.1).feet)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 2**32 - 1), st.floats(0.05, 0.95))
def test_the_four_look_ups_equal_counting_pixels(seed: int, share: float) -> None:
    templates = PersonTemplates.build(OBLIQUE.scaled_to(120, 90), 1.75, 0.4, 0.3)
    rng = np.random.default_rng(seed)
    mask = (rng.random((90, 120)) < share).astype(np.uint8)
    some = rng.choice(len(templates.feet), 20)
    clipped = np.clip(templates.slices[some], 0, [120, 90, 120, 90])
    counted = [sum(float(mask[y0:y1, x0:x1].sum()) for x0, y0, x1, y1 in slices) for slices in clipped]
    assert _sums(_integral(mask), templates.corners[some]).tolist() == counted


def test_one_person_is_found_where_they_stand(camera: tuple[CameraGeometry, PersonTemplates]) -> None:
    geometry, templates = camera
    for place in [(0.0, 3.0), (2.0, 2.5), (-2.5, 3.5)] if geometry is not OBLIQUE else [(0.0, 9.0), (3.0, 14.0)]:
        found = positions(geometry, templates, silhouette(geometry, [place]))
        assert len(found) == 1
        assert np.linalg.norm(found[0] - place) < (0.5 if geometry is ABOVE else 0.35)


def test_two_people_who_make_one_blob_are_two(camera: tuple[CameraGeometry, PersonTemplates]) -> None:
    geometry, templates = camera
    y = 9.0 if geometry is OBLIQUE else 3.0
    places = [(0.0, y), (0.55, y)]
    found = positions(geometry, templates, silhouette(geometry, places))
    assert len(found) == 2
    assert np.abs(found[np.argsort(found[:, 0])] - places).max() < 0.4


def test_somebody_behind_somebody_is_not_merged_with_the_nearer_one() -> None:
    templates = PersonTemplates.build(OBLIQUE, 1.75, 0.4, 0.3)
    places = [(0.0, 9.0), (0.1, 11.5)]  # the nearer one hides the other's legs
    found = positions(OBLIQUE, templates, silhouette(OBLIQUE, places))
    assert len(found) == 2
    found = found[np.argsort(found[:, 1])]
    assert np.linalg.norm(found[0] - places[0]) < 0.4
    assert 10.5 < found[1][1] < 15.0  # only the head and shoulders are seen: too far rather than lost


def test_specks_and_an_empty_mask_are_nobody(camera: tuple[CameraGeometry, PersonTemplates]) -> None:
    _, templates = camera
    mask = np.zeros((360, 480), np.uint8)
    assert len(templates.split(mask.copy(), 0.1)) == 0
    rng = np.random.default_rng(1)
    mask[rng.integers(0, 360, 1500), rng.integers(0, 480, 1500)] = 1
    assert len(templates.split(mask, 0.1)) == 0


def test_a_full_mask_ends_and_gives_people_no_nearer_than_they_can_stand() -> None:
    templates = PersonTemplates.build(OBLIQUE, 1.75, 0.4, 0.3)
    found = templates.split(np.ones((360, 480), np.uint8), 0.1)
    assert 0 < len(found) < 1000
    assert np.isfinite(found.feet).all()


def test_a_camera_that_sees_no_floor_up_close_finds_nobody() -> None:
    sky = CameraGeometry.from_pose((480, 360), (0.0, 0.0, 5.0), (0.0, 10.0, 9.0), math.radians(30))
    assert len(PersonTemplates.build(sky, 1.75, 0.4, 0.3).split(np.ones((360, 480), np.uint8), 0.1)) == 0
