"""What every detector must do, run on every one: the built-in ones and one loaded by its import path."""

import math
from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from services.camera.detector import Detections, Detector, DetectorError, check_detector
from services.camera.foreground import ForegroundDetector, ForegroundOptions
from shared.site import CameraGeometry

SIZE = (480, 360)
GEOMETRY = CameraGeometry.from_pose(SIZE, (0.0, 0.0, 5.0), (0.0, 12.0, 0.0), math.radians(60))
RATE = 10.0
Image = NDArray[np.uint8]


@pytest.fixture(params=["foreground", "tiny_detector:BrightDetector"])
def make(request: pytest.FixtureRequest) -> Callable[[], Detector]:
    kind, options = check_detector(request.param, {})
    return lambda: kind(GEOMETRY, options)


def background(seed: int = 0) -> Image:
    rng = np.random.default_rng(seed)
    coarse = rng.integers(40, 130, (24, 32, 3), dtype=np.uint8)
    picture = cv2.resize(coarse, SIZE, interpolation=cv2.INTER_CUBIC).astype(int) + rng.integers(-12, 12, (360, 480, 1))
    return np.clip(picture, 20, 160).astype(np.uint8)


SCENE = background()


def picture(number: int, people: list[tuple[float, float]] = (), light: float = 1.0) -> Image:  # type: ignore[assignment]
    """The scene with noise, people as white upright rectangles of 1.75 x 0.45 m, and a change of light."""
    image = SCENE.copy()
    for x, y in sorted(people, key=lambda place: -place[1]):
        (u0, v0), (u1, v1) = GEOMETRY.to_image(np.array([[x - 0.225, y, 1.75], [x + 0.225, y, 0.0]]))
        shade = 215 + 20 * ((number + np.arange(round(v1) - round(v0))) // 8 % 2)
        image[round(v0) : round(v1), round(u0) : round(u1)] = shade[:, None, None]
    noise = np.random.default_rng(number).normal(0.0, 2.0, image.shape)
    return np.clip(light * image + noise, 0, 255).astype(np.uint8)


def watch(detector: Detector, pictures: list[Image], start: int = 0) -> list[Detections]:
    return [detector.detect(image, 1000.0 + (start + n) / RATE) for n, image in enumerate(pictures)]


def walk(count: int, *starts: tuple[float, float], first: int = 0) -> list[Image]:
    """People who walk sideways at 1 m/s."""
    return [picture(first + n, [(x + n / RATE, y) for x, y in starts]) for n in range(count)]


def places(found: Detections) -> NDArray[np.float64]:
    return GEOMETRY.to_ground(found.feet)


def test_arrays_are_parallel_and_confidence_is_a_probability(make: Callable[[], Detector]) -> None:
    for found in watch(make(), [picture(n) for n in range(30)] + walk(10, (-2.0, 9.0), (1.0, 12.0), first=30)):
        assert found.feet.shape == (len(found), 2)
        assert found.boxes.shape == (len(found), 4)
        assert found.confidence.shape == (len(found),)
        assert np.all((found.confidence >= 0.0) & (found.confidence <= 1.0))
        assert np.all(found.boxes[:, 2:] > 0.0)
        assert np.isfinite(found.feet).all()


def test_an_empty_scene_is_empty(make: Callable[[], Detector]) -> None:
    assert sum(len(found) for found in watch(make(), [picture(n) for n in range(60)])) == 0


def test_a_person_is_found_where_they_stand(make: Callable[[], Detector]) -> None:
    detector = make()
    watch(detector, [picture(n) for n in range(60)])
    for n, found in enumerate(watch(detector, walk(20, (-2.0, 9.0), first=60), start=60)):
        assert len(found) == 1
        assert np.linalg.norm(places(found)[0] - (-2.0 + n / RATE, 9.0)) < 0.35


def test_two_people_are_two(make: Callable[[], Detector]) -> None:
    detector = make()
    watch(detector, [picture(n) for n in range(60)])
    for found in watch(detector, walk(20, (-2.0, 9.0), (1.0, 12.0), first=60), start=60):
        assert len(found) == 2


def test_the_same_pictures_give_the_same_detections_also_after_a_reset(make: Callable[[], Detector]) -> None:
    film = [picture(n) for n in range(20)] + walk(15, (-1.0, 9.0), first=20)
    detector = make()
    runs = [watch(detector, film)]
    detector.reset()
    runs += [watch(detector, film), watch(make(), film)]
    assert sum(map(len, runs[0])) > 0
    for other in runs[1:]:
        for a, b in zip(runs[0], other, strict=True):
            assert np.array_equal(a.feet, b.feet)
            assert np.array_equal(a.boxes, b.boxes)
            assert np.array_equal(a.confidence, b.confidence)


def test_the_given_picture_is_left_as_it_is(make: Callable[[], Detector]) -> None:
    image = picture(0, [(0.0, 9.0)])
    before = image.copy()
    make().detect(image, 1.0)
    assert np.array_equal(image, before)


def test_it_says_whether_it_is_ready(make: Callable[[], Detector]) -> None:
    detector = make()
    assert isinstance(detector, Detector)
    watch(detector, [picture(n) for n in range(60)])
    assert detector.state == "ready"


def foreground() -> ForegroundDetector:
    detector = ForegroundDetector(GEOMETRY)
    assert detector.state == "learning"
    watch(detector, [picture(n) for n in range(60)])
    return detector


def test_people_whose_blobs_merge_are_two() -> None:
    for found in watch(foreground(), walk(15, (-1.0, 9.0), (-0.5, 9.0), first=60), start=60):
        assert len(found) == 2
        assert np.ptp(places(found)[:, 0]) == pytest.approx(0.5, abs=0.25)


@pytest.mark.parametrize("light", [0.6, 0.85, 1.2, 1.5])
def test_a_step_in_the_light_does_not_flood_the_picture(light: float) -> None:
    detector = foreground()
    found = watch(detector, [picture(60 + n, light=light) for n in range(20)], start=60)
    assert sum(map(len, found)) == 0
    assert len(detector.detect(picture(80, [(0.0, 9.0)], light=light), 1008.0)) == 1


def test_a_shaken_camera_gives_no_crowd_and_is_learned_afresh() -> None:
    detector = foreground()
    strange = background(seed=9)
    watch(detector, [strange] * 40, start=60)
    assert len(detector.detect(strange, 1011.0)) == 0


def test_a_soft_shadow_is_nobody() -> None:
    detector = foreground()
    for n in range(20):
        image = picture(60 + n)
        image[150:330, 200 + 8 * n : 260 + 8 * n] = (0.75 * image[150:330, 200 + 8 * n : 260 + 8 * n]).astype(np.uint8)
        assert len(detector.detect(image, 1006.0 + n / RATE)) == 0


@pytest.mark.parametrize("rate", [5, 20])
def test_the_frame_rate_does_not_decide_when_people_who_stand_are_forgotten(rate: int) -> None:
    size = (320, 240)
    detector = ForegroundDetector(GEOMETRY.scaled_to(*size), ForegroundOptions(learning_rate=0.1))
    empty, standing = (cv2.resize(picture(0, people), size) for people in ([], [(0.0, 9.0)]))
    for n in range(15 * rate):
        assert len(detector.detect(empty, n / rate)) == 0
    seen = [len(detector.detect(standing, 15.0 + n / rate)) for n in range(10 * rate)]
    assert sum(seen) / rate == pytest.approx(4.9, abs=0.5)  # ln(1 / 0.6) / 0.1, less MOG2's pruning of rare colours


def test_a_wider_picture_gives_the_same_places() -> None:
    large = (1440, 1080)
    detector = ForegroundDetector(GEOMETRY.scaled_to(*large))
    film = [picture(n) for n in range(20)] + walk(5, (-1.0, 9.0), first=20)
    for n, image in enumerate(film):
        found = detector.detect(cv2.resize(image, large, interpolation=cv2.INTER_NEAREST), n / RATE)
    place = GEOMETRY.scaled_to(*large).to_ground(found.feet)
    assert place == pytest.approx(np.array([[-0.6, 9.0]]), abs=0.35)


@pytest.mark.parametrize(
    ("name", "options", "told"),
    [
        ("hog", {}, "allowed: foreground or package.module:Class"),
        ("no_such_module:Thing", {}, "cannot be imported"),
        ("math:nothing", {}, "cannot be imported"),
        ("math:floor", {}, "lacks Options"),
        ("foreground", {"learning_rate": -1}, "detector_options.learning_rate"),
        ("foreground", {"learning_rat": 0.1}, "detector_options.learning_rat"),
        ("tiny_detector:BrightDetector", {"threshold": "high"}, "detector_options.threshold"),
    ],
)
def test_a_wrong_detector_or_option_is_named(name: str, options: dict[str, object], told: str) -> None:
    with pytest.raises(DetectorError, match="detector") as error:
        check_detector(name, options)
    assert told in str(error.value)


def test_a_clock_set_back_by_an_hour_makes_no_detector_learn_for_an_hour(make: Callable[[], Detector]) -> None:
    detector = make()
    watch(detector, [picture(n) for n in range(60)])
    assert detector.state == "ready"
    for n, image in enumerate(walk(20, (-2.0, 9.0), first=60)):
        found = detector.detect(image, 1000.0 - 3600.0 + n / RATE)
        assert detector.state == "ready"
        assert len(found) == 1
