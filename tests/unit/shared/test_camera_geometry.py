"""Camera geometry: the floor under a pixel, the pixel over a place, and every way to calibrate."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import Phase, assume, given, settings
from hypothesis import strategies as st

from shared.site import CameraGeometry
from shared.site.camera_geometry import GeometryError

SIZE = (960, 720)
FITTING = settings(max_examples=25, deadline=None, phases=[Phase.explicit, Phase.generate])


@st.composite
def poses(draw: st.DrawFn, steepest: float = 90.0, flattest: float = 20.0) -> CameraGeometry:
    """A camera 2 to 12 m up, looking down by ``flattest`` to ``steepest`` degrees in any direction."""
    height = draw(st.floats(2.0, 12.0))
    down = math.radians(draw(st.floats(flattest, steepest)))
    azimuth = draw(st.floats(-math.pi, math.pi))
    fov = math.radians(draw(st.floats(35.0, 100.0)))
    place = np.array([draw(st.floats(-30, 30)), draw(st.floats(-30, 30)), height])
    reach = height / math.tan(down)
    look_at = (place[0] + reach * math.cos(azimuth), place[1] + reach * math.sin(azimuth), 0.0)
    return CameraGeometry.from_pose(SIZE, (place[0], place[1], place[2]), look_at, fov)


def seen_floor(camera: CameraGeometry, seed: int, count: int = 40, reach: float = 60.0) -> np.ndarray:
    """Pixels (n, 2) that see a floor point no farther than ``reach`` metres."""
    pixels = np.random.default_rng(seed).uniform([0, 0], [SIZE[0] - 1, SIZE[1] - 1], (count, 2))
    away = np.linalg.norm(camera.to_ground(pixels) - camera.position[:2], axis=1)
    seen: np.ndarray = pixels[np.isfinite(away) & (away < reach)]
    return seen


def lifted(plan: np.ndarray, height: float = 0.0) -> np.ndarray:
    return np.column_stack([plan, np.full(len(plan), height)])


def with_distortion(camera: CameraGeometry, distortion: float) -> CameraGeometry:
    return CameraGeometry(
        camera.image_size, camera.focal, camera.centre, camera.rotation, camera.translation, distortion
    )


@given(poses(), st.floats(-0.05, 0.1), st.integers(0, 99), st.floats(0.0, 1.5))
def test_a_floor_point_seen_and_projected_back_is_the_same_pixel(
    camera: CameraGeometry, distortion: float, seed: int, height: float
) -> None:
    camera = with_distortion(camera, distortion)
    pixels = seen_floor(camera, seed)
    ground = camera.to_ground(pixels, height)
    seen = np.isfinite(ground).all(axis=1)
    assert np.allclose(camera.to_image(lifted(ground[seen], height)), pixels[seen], atol=1e-4)


@given(poses())
def test_a_mounted_camera_hangs_where_it_was_mounted_and_stands_upright(camera: CameraGeometry) -> None:
    assert np.allclose(camera.rotation @ camera.rotation.T, np.eye(3), atol=1e-9)
    assert math.isclose(np.linalg.det(camera.rotation), 1.0, abs_tol=1e-9)
    middle = camera.to_ground(np.array([camera.centre]))
    below, above = camera.to_image(np.vstack([lifted(middle, 0.0), lifted(middle, 0.5)]))
    assert above[1] <= below[1] + 1e-6  # heads are above feet
    assert abs(above[0] - below[0]) < 1e-6  # and the horizon is level


@given(st.floats(1e-4, 0.2), st.floats(-math.pi, math.pi))
def test_tilting_to_straight_down_does_not_turn_the_picture(tilt: float, azimuth: float) -> None:
    """The top of the picture keeps pointing to where the camera looks, until it looks nowhere but down."""
    height = 5.0
    ahead = height * math.tan(tilt)
    direction = np.array([math.cos(azimuth), math.sin(azimuth)])
    look_at = (ahead * direction[0], ahead * direction[1], 0.0)
    camera = CameraGeometry.from_pose(SIZE, (0.0, 0.0, height), look_at, math.radians(80))
    top = camera.to_ground(np.array([[camera.centre[0], camera.centre[1] - 50]]))[0] - np.array(look_at[:2])
    assert np.allclose(top / np.linalg.norm(top), direction, atol=1e-3)


def test_straight_down_the_top_of_the_picture_is_the_plans_y() -> None:
    camera = CameraGeometry.from_pose(SIZE, (3.0, 4.0, 5.0), (3.0, 4.0, 0.0), math.radians(80))
    middle, top, right = camera.to_ground(np.array([[479.5, 359.5], [479.5, 0.0], [959.0, 359.5]]))
    assert np.allclose(middle, [3.0, 4.0])
    assert math.isclose(top[0], 3.0, abs_tol=1e-9)
    assert top[1] > 4.0
    assert right[0] > 3.0
    assert math.isclose(right[1], 4.0, abs_tol=1e-9)


def test_a_camera_cannot_look_at_itself() -> None:
    with pytest.raises(GeometryError, match="look_at"):
        CameraGeometry.from_pose(SIZE, (1.0, 1.0, 3.0), (1.0, 1.0, 3.0), 1.0)


def test_a_pixel_at_or_above_the_horizon_sees_no_floor() -> None:
    camera = CameraGeometry.from_pose(SIZE, (0.0, 0.0, 3.0), (10.0, 0.0, 3.0), math.radians(60))
    ground = camera.to_ground(np.array([[480.0, 0.0], [480.0, camera.centre[1]], [480.0, 700.0]]))
    assert np.isnan(ground[:2]).all()
    assert np.isfinite(ground[2]).all()


def test_a_place_behind_the_camera_is_in_no_picture() -> None:
    camera = CameraGeometry.from_pose(SIZE, (0.0, 0.0, 3.0), (10.0, 0.0, 0.0), math.radians(60))
    assert np.isnan(camera.to_image(np.array([[-5.0, 0.0, 0.0]]))).all()


@FITTING
@given(poses(steepest=75.0), st.integers(0, 99), st.integers(4, 12))
def test_point_pairs_give_back_the_camera_that_made_them(camera: CameraGeometry, seed: int, count: int) -> None:
    pixels = spread_pixels(camera, seed, count)
    plan = camera.to_ground(pixels)
    found = CameraGeometry.from_points(SIZE, pixels, plan)
    check = seen_floor(camera, seed + 1, reach=30.0)
    assert np.allclose(found.to_ground(check), camera.to_ground(check), atol=0.02)
    assert np.allclose(found.position, camera.position, atol=0.1)
    feet = camera.to_ground(check)
    head, found_head = (each.to_image(lifted(feet, 1.75)) for each in (camera, found))
    assert np.nanmax(np.abs(head - found_head), initial=0.0) < 3.0  # how tall a person appears


@FITTING
@given(poses(steepest=65.0, flattest=25.0), st.integers(0, 99))
def test_point_pairs_clicked_a_pixel_off_still_give_the_floor(camera: CameraGeometry, seed: int) -> None:
    pixels = spread_pixels(camera, seed, 10)
    plan = camera.to_ground(pixels)
    clicked = pixels + np.random.default_rng(seed).normal(0.0, 1.0, pixels.shape)
    found = CameraGeometry.from_points(SIZE, clicked, plan)
    middle = pixels.mean(axis=0, keepdims=True)
    footprint = np.linalg.norm(camera.ground_jacobian(middle)[0], 2)  # metres one pixel spans there
    assert np.linalg.norm(found.to_ground(middle) - camera.to_ground(middle)) < 4.0 * footprint


@settings(FITTING, max_examples=5)  # slow: nothing tells the fit which of many equal cameras to take
@given(st.floats(0.0, 0.01), st.integers(0, 20))
def test_point_pairs_seen_from_straight_above_give_the_floor_though_not_the_lens(tilt: float, seed: int) -> None:
    """Face on, distance and focal length cannot be told apart: the floor is right all the same."""
    camera = CameraGeometry.from_pose(SIZE, (0.0, 0.0, 6.0), (6.0 * tilt, 0.0, 0.0), math.radians(70))
    pixels = spread_pixels(camera, seed, 8)
    found = CameraGeometry.from_points(SIZE, pixels, camera.to_ground(pixels))
    assert np.allclose(found.to_ground(pixels), camera.to_ground(pixels), atol=0.02)


def spread_pixels(camera: CameraGeometry, seed: int, count: int) -> np.ndarray:
    """Pixels as an operator would choose them: near, far, left and right, none on one line with its neighbours."""
    generator = np.random.default_rng(seed)
    rows = np.linspace(0, SIZE[1] - 1, 60)
    middle = np.column_stack([np.full(60, camera.centre[0]), rows])
    away = np.linalg.norm(camera.to_ground(middle) - camera.position[:2], axis=1)
    usable = rows[np.isfinite(away) & (away < 35.0)]
    assume(len(usable) > 10)
    top, bottom = usable[0], usable[-1]
    corners = np.array([[60.0, bottom], [900.0, bottom], [200.0, top], [760.0, top]])
    corners += generator.uniform(-30, 30, corners.shape) * [1.0, 0.0]
    extra = np.column_stack([generator.uniform(60, 900, count), generator.uniform(top, bottom, count)])
    pixels: np.ndarray = np.vstack([corners, extra])[:count]
    assume(np.isfinite(camera.to_ground(pixels)).all())
    return pixels


LINE = np.array([[0.0, 0.0], [1.0, 1.0], [2.0, 2.0], [3.0, 3.0]])
BOX = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
PIXELS = np.array([[100.0, 700.0], [800.0, 700.0], [600.0, 300.0], [300.0, 300.0]])


@pytest.mark.parametrize(
    ("image", "plan", "reason"),
    [
        (PIXELS[:3], BOX[:3], "3 points: at least 4"),
        (PIXELS, BOX[:3], "4 image points but 3 plan points"),
        (PIXELS, LINE, "plan points lie on one line"),
        (LINE * 100, BOX, "image points lie on one line"),
        (np.full((4, 2), 300.0), BOX, "image points lie on one line"),
        (PIXELS, np.zeros((4, 2)), "plan points lie on one line"),
        (PIXELS, BOX[[0, 2, 1, 3]], "no camera above the floor"),  # two pairs swapped
        (PIXELS[[0, 0, 1, 2]], BOX[[0, 1, 2, 3]], "no camera|on one line"),  # one pixel for two places
        (np.array([[100.0, 700.0], [400.0, 700.0], [800.0, 700.0], [300.0, 300.0]]), BOX, "no camera|on one line"),
    ],
)
def test_pairs_that_no_camera_fits_are_refused_with_the_reason(
    image: np.ndarray, plan: np.ndarray, reason: str
) -> None:
    with pytest.raises(GeometryError, match=reason):
        CameraGeometry.from_points(SIZE, image, plan)


@given(poses(), st.integers(0, 99), st.sampled_from([(480, 360), (1920, 1440), (320, 180)]))
def test_a_picture_of_another_size_sees_the_same_floor(
    camera: CameraGeometry, seed: int, size: tuple[int, int]
) -> None:
    pixels = seen_floor(camera, seed)
    scale = np.array(size) / np.array(SIZE)
    scaled = camera.scaled_to(*size)
    assert scaled.image_size == size
    assert np.allclose(scaled.to_ground((pixels + 0.5) * scale - 0.5), camera.to_ground(pixels), atol=1e-6)


@FITTING
@given(poses(flattest=30.0), st.integers(0, 99))
def test_the_covariance_on_the_floor_is_that_of_a_thousand_noisy_feet(camera: CameraGeometry, seed: int) -> None:
    pixels = seen_floor(camera, seed, reach=15.0)[:1]
    assume(len(pixels))
    generator = np.random.default_rng(seed)
    sigma, floor_sigma = (1.5, 3.0), 0.1
    noisy = camera.to_ground(pixels + generator.normal(size=(20_000, 2)) * sigma)
    noisy += generator.normal(size=noisy.shape) * floor_sigma
    expected = np.cov(noisy[np.isfinite(noisy).all(axis=1)].T)
    found = camera.ground_covariance(pixels, sigma, floor_sigma)[0]
    assert np.allclose(found, expected, atol=0.12 * np.trace(expected))
    assert np.linalg.eigvalsh(found).min() > 0.0


@pytest.mark.parametrize("text", ["", "<Camera/>", "not xml", '<Camera><Geometry width="x"/></Camera>'])
def test_a_file_that_is_no_calibration_is_named(tmp_path: Path, text: str) -> None:
    file = tmp_path / "broken.xml"
    file.write_text(text)
    with pytest.raises(GeometryError, match=r"broken\.xml: not a Tsai calibration"):
        CameraGeometry.from_tsai_file(file)


def test_a_calibration_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(GeometryError, match=r"gone\.xml: No such file"):
        CameraGeometry.from_tsai_file(tmp_path / "gone.xml")


def test_the_real_calibration_puts_the_true_feet_within_five_centimetres(data_folder: Path) -> None:
    camera = CameraGeometry.from_tsai_file(data_folder / "pets09-s2l1" / "maps" / "View_001.xml")
    truth = np.loadtxt(data_folder / "pets09-s2l1" / "gt" / "gt.txt", delimiter=",")
    left, top, width, height = truth[:, 2:6].T
    feet = np.column_stack([left + width / 2, top + height]) - 1.0  # the labels count pixels from 1
    inside = (feet >= 0).all(axis=1) & (feet < camera.image_size).all(axis=1)
    residual = np.linalg.norm(camera.to_ground(feet[inside]) - truth[inside, 7:9], axis=1)
    assert camera.image_size == (768, 576)
    assert camera.position[2] > 2.0
    assert np.median(residual) < 0.05
    assert np.percentile(residual, 95) < 0.15
