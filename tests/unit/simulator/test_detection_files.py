"""Detections read from files arrive where the camera's geometry puts them, and mistakes in files are named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from services.simulator.cameras.detection_files import DetectionFileError, FileDetectionParameters, FileDetections
from shared.messages import covariances, positions
from shared.site import Camera, Source
from shared.site.site_file import PoseGeometry

CAMERA = Camera(
    id="view",
    area="hall",
    source=Source(url="http://camera.invalid/"),
    geometry=PoseGeometry(
        kind="pose", image_size=(960, 720), position=(10, -3, 6), look_at=(10, 8, 0), horizontal_fov=70
    ),
)


def detections(tmp_path: Path, text: str, camera: Camera = CAMERA, **options: Any) -> FileDetections:
    file = tmp_path / "det.txt"
    file.write_text(text)
    parameters = FileDetectionParameters(frames_per_s=10.0, **options)
    return FileDetections(camera, "ground", file, parameters)


def test_mot_boxes_stand_where_their_feet_are_and_count_from_one(tmp_path: Path) -> None:
    geometry = CAMERA.geometry.build()
    u, v = geometry.to_image(np.array([[9.0, 7.0, 0.0]]))[0]
    text = f"1,-1,{u - 20 + 1},{v - 100 + 1},40,100,50\n3,-1,{u - 20 + 1},{v - 100 + 1},40,100,10\n"
    frames = detections(tmp_path, text, least_confidence=20, full_confidence=100).frames(None, 0.0, 0.5)
    assert [frame.seq for frame in frames] == [0, 1, 2, 3, 4]
    assert [len(frame.x) for frame in frames] == [1, 0, 0, 0, 0]
    np.testing.assert_allclose(positions(frames[0]), [[9.0, 7.0]], atol=1e-6)
    assert frames[0].confidence == [0.5]
    np.testing.assert_allclose(frames[0].box, [(u - 20, v - 100, 40, 100)])
    expected = geometry.ground_covariance(np.array([[u, v]]), (5.0, 5.0), 0.1)
    np.testing.assert_allclose(covariances(frames[0]), expected, rtol=1e-6)


def test_csv_places_are_kept_and_blocks_fit_together(tmp_path: Path) -> None:
    text = "t, x, y, confidence\n0.0,9,7,0.9\n0.52,10,8,0.8\n0.5,11,9,0.7\n0.9,10,9,0.1\n"
    source = detections(tmp_path, text, format="csv", least_confidence=0.5)
    frames = [*source.frames(None, 0.0, 0.5), *source.frames(None, 0.5, 1.0)]
    assert [frame.seq for frame in frames] == list(range(10))
    np.testing.assert_allclose(positions(frames[5]), [[10.0, 8.0], [11.0, 9.0]], atol=1e-6)
    assert [len(frame.x) for frame in frames] == [1, 0, 0, 0, 0, 2, 0, 0, 0, 0]


def test_an_empty_file_gives_empty_frames(tmp_path: Path) -> None:
    assert [len(frame.x) for frame in detections(tmp_path, "").frames(None, 0.0, 0.3)] == [0, 0, 0]


def test_feet_outside_the_area_of_interest_are_dropped(tmp_path: Path) -> None:
    left = CAMERA.model_copy(update={"area_of_interest": [(0, 0), (480, 0), (480, 720), (0, 720)]})
    source = detections(tmp_path, "t,x,y\n0,9,7\n0,11,7\n", left, format="csv")
    assert [round(x) for x in source.frames(None, 0.0, 0.1)[0].x] == [9]


@pytest.mark.parametrize(
    ("text", "options", "message"),
    [
        ("1,-1,3,4\n", {}, "line 1: 4 columns; needed: frame, id"),
        ("1,-1,3,4,5,6,7\n1,-1,3,x,5,6,7\n", {}, "line 2: 'x' is not a number"),
        ("0,-1,3,4,5,6,7\n", {}, "line 1: frame 0"),
        ("1,-1,3,4,0,6,7\n", {}, "box 0 x 6"),
        ("t,x\n1,2\n", {"format": "csv"}, "column y is missing"),
        ("t,x,y\n1,2,nan\n", {"format": "csv"}, "line 2: 'nan' is not a number"),
        ("t,x,y\n1,2,3\n-1,2,3\n", {"format": "csv"}, "line 3: t -1; allowed: 0 and above"),
    ],
)
def test_mistakes_in_files_are_named(tmp_path: Path, text: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(DetectionFileError, match=message):
        detections(tmp_path, text, **options)


def test_a_file_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(DetectionFileError, match=r"none\.txt: cannot be read"):
        FileDetections(CAMERA, "ground", tmp_path / "none.txt", FileDetectionParameters())
