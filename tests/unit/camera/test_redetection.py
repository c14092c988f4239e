"""Other options on the kept pictures: the same answer the camera would have given, or a clear refusal."""

import dataclasses
import math

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from services.camera.detector import DetectorError
from services.camera.foreground import ForegroundDetector
from services.camera.frame_ring import FrameRing, KeptFrame, unpack
from services.camera.pipeline import Pipeline
from services.camera.redetection import Job, RedetectError, read_question, redetect, reported
from shared.site import Camera

CAMERA = Camera.model_validate(
    {
        "id": "door",
        "area": "hall",
        "source": {"device": 0},
        "geometry": {
            "kind": "pose",
            "image_size": [640, 480],
            "position": [0, 0, 5],
            "look_at": [0, 12, 0],
            "horizontal_fov": 60,
        },
    }
)
GEOMETRY = CAMERA.geometry.build().scaled_to(200, 150)
SCENE = cv2.resize(
    np.random.default_rng(3).integers(60, 120, (30, 40, 3), np.uint8), (200, 150), interpolation=cv2.INTER_CUBIC
)


def picture(t: float) -> NDArray[np.uint8]:
    """The scene; from 10 s on somebody white walks up and down."""
    image = np.clip(SCENE + np.random.default_rng(round(8 * t)).normal(0.0, 2.0, SCENE.shape), 0, 255).astype(np.uint8)
    if t >= 10.0:
        x = 2.0 * math.sin(0.5 * t)
        (u0, v0), (u1, v1) = GEOMETRY.to_image(np.array([[x - 0.2, 9.0, 1.75], [x + 0.2, 9.0, 0.0]]))
        image[round(v0) : round(v1), round(u0) : round(u1)] = 240
    return image


@pytest.fixture(scope="module")
def kept() -> tuple[KeptFrame, ...]:
    ring = FrameRing(16.0, 5.0, 4.0)
    for number in range(160):
        ring.offer(picture(number / 4.0), 1000.0 + number / 4.0)
    return tuple(ring.ask())


def job(options: dict[str, float], since: float = 0.0, until: float = math.inf, empty: bool = False) -> Job:
    reference = np.asarray(SCENE, np.uint8) if empty else None
    return Job(CAMERA, "ground", "foreground", options, (640, 480), reference, since, until)


def test_it_finds_what_a_live_detector_with_the_same_options_finds(kept: tuple[KeptFrame, ...]) -> None:
    kept = kept[:80]
    for options in ({}, {"learning_rate": 0.2, "sensitivity": 30.0}):
        live = Pipeline(CAMERA, "foreground", options)
        expected = [live.process(unpack(frame), frame.t) for frame in kept]
        told = redetect(job(options), kept)
        assert [frame.t for frame in told.frames] == [frame.t for frame in kept]
        for found, frame in zip(expected, told.frames, strict=True):
            assert frame.x == found.positions[:, 0].tolist()
            assert np.array(frame.box).reshape(-1, 4) == pytest.approx(3.2 * found.boxes)  # of the delivered picture
        assert sum(len(frame.x) for frame in told.frames) > 25
    assert told.rate == pytest.approx(4.0)


def test_only_the_asked_time_is_told_and_the_warm_up_never(kept: tuple[KeptFrame, ...]) -> None:
    since, until = reported(kept, None, None)
    assert since == pytest.approx(kept[0].t + (kept[-1].t - kept[0].t) / 3.0)
    assert until == kept[-1].t
    everything = redetect(job({}), kept)
    some = redetect(job({}, 1020.0, 1030.0), kept)
    assert [frame.t for frame in some.frames] == [t for f in kept if 1020.0 <= (t := f.t) <= 1030.0]
    told = {frame.t: frame.x for frame in everything.frames}
    assert all(told[frame.t] == frame.x for frame in some.frames)
    assert reported(kept, 1025.0, 2000.0) == (1025.0, kept[-1].t)


def test_people_are_put_where_the_learned_alignment_puts_them(kept: tuple[KeptFrame, ...]) -> None:
    homography = np.array([[1.0, 0.0, 3.0], [0.0, 1.0, -1.0], [0.0, 0.0, 1.0]])
    plain = redetect(job({}), kept[:80])
    moved = redetect(dataclasses.replace(job({}), homography=homography, alignment=4), kept[:80])
    assert (plain.alignment, moved.alignment) == (0, 4)
    assert sum(len(frame.x) for frame in plain.frames) > 25
    for before, after in zip(plain.frames, moved.frames, strict=True):
        assert after.x == pytest.approx([x + 3.0 for x in before.x])
        assert after.y == pytest.approx([y - 1.0 for y in before.y])


def test_a_scene_known_empty_leaves_no_ghost_of_who_stood_there_first(kept: tuple[KeptFrame, ...]) -> None:
    late = kept[50:]  # begins with somebody in the picture
    cold, primed = redetect(job({}), late), redetect(job({}, empty=True), late)
    assert sum(len(frame.x) == 1 for frame in primed.frames) > sum(len(frame.x) == 1 for frame in cold.frames)
    assert len(primed.frames[0].x) == 1


@pytest.mark.parametrize(
    ("question", "told"),
    [
        (b"nonsense", "malformed"),
        (b'{"options": {"learning_rate": 0}}', "learning_rate"),
        (b'{"options": {"magic": 1}}', "magic"),
        (b'{"options": {"learning_rate": "fast"}}', "float"),
        (b'{"rate": 1}', "rate"),
        (b'{"since": 5, "until": 4}', "until: found 4"),
    ],
)
def test_what_cannot_be_asked_is_named(question: bytes, told: str) -> None:
    with pytest.raises(RedetectError, match=told):
        read_question(question, "foreground", {})


def test_configured_options_stay_where_none_is_asked_for() -> None:
    options, since, until = read_question(b'{"options": {"learning_rate": 0.1}}', "foreground", {"sensitivity": 20.0})
    assert (options, since, until) == ({"sensitivity": 20.0, "learning_rate": 0.1}, None, None)
    assert read_question(b"", "foreground", {"sensitivity": 20.0})[0] == {"sensitivity": 20.0}


def test_too_little_kept_is_told(kept: tuple[KeptFrame, ...]) -> None:
    with pytest.raises(RedetectError, match="has just begun"):
        reported((), None, None)
    with pytest.raises(RedetectError, match="5 s or more"):
        reported(kept, None, kept[0].t + 1.0)
    with pytest.raises(RedetectError, match="5 s or more"):
        reported(kept[:12], None, None)


def test_adopted_settings_keep_the_background_where_they_can() -> None:
    pipeline = Pipeline(CAMERA, "foreground", {"sensitivity": 20.0})
    film = [(picture(k / 4.0), 1000.0 + k / 4.0) for k in range(60)]
    for image, t in film[:45]:
        pipeline.process(image, t)
    pipeline.adopt({"learning_rate": 0.05, "least_gain": 0.2})
    assert pipeline.state == "ready"
    assert len(pipeline.process(*film[45]).positions) == 1
    detector = pipeline._detector
    assert isinstance(detector, ForegroundDetector)
    assert (detector._options.learning_rate, detector._options.sensitivity) == (0.05, 20.0)
    pipeline.adopt({})  # as configured
    assert detector._options.learning_rate == 0.01
    with pytest.raises(DetectorError, match="least_gain"):
        pipeline.adopt({"least_gain": 5.0})
    assert len(pipeline.process(*film[46]).positions) == 1
    pipeline.adopt({"height_scale": 0.9, "height_scale_down": 0.1, "width_scale": 0.9})  # other templates only
    assert pipeline.state == "ready"
    assert len(pipeline.process(*film[47]).positions) == 1
    pipeline.adopt({"person_height": 1.9})  # sizes are held against it: it begins anew
    assert pipeline.state == "learning"


def test_an_adopted_sensitivity_decides_what_is_foreground() -> None:
    pipeline = Pipeline(CAMERA, "foreground")
    for number in range(30):
        pipeline.process(picture(number / 4.0), 1000.0 + number / 4.0)
    faint = picture(7.75)
    faint[60:92, 95:104] += np.uint8(7)
    assert len(pipeline.process(faint, 1007.75).positions) == 0
    pipeline.adopt({"sensitivity": 4.0})
    assert len(pipeline.process(faint, 1008.0).positions) == 1
