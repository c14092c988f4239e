"""A lens from a clip of a moving checkerboard: drawn with a known lens, found again; bad clips are refused."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from rich.console import Console

from services.camera.lens_clip import LensClipError, calibrate_lens, collect_views
from services.cli.calibrate_lens import calibrate_lens as command

SIZE = (480, 360)
COLUMNS, ROWS = 7, 5
MATRIX = np.array([[420.0, 0, 242.0], [0, 424.0, 177.0], [0, 0, 1]])
BENT = np.array([-0.25, 0.06, 0.0, 0.0, 0.0])


def drawn(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """A picture of the board through the bent lens: its squares as polygons with bent edges."""
    picture = np.full((SIZE[1] * 2, SIZE[0] * 2, 3), 200, np.uint8)
    edge = np.linspace(0, 1, 8)
    sides = np.concatenate(
        [
            np.column_stack([edge, 0 * edge]),
            np.column_stack([0 * edge + 1, edge]),
            np.column_stack([1 - edge, 0 * edge + 1]),
            np.column_stack([0 * edge, 1 - edge]),
        ]
    )

    def fill(corners: np.ndarray, shade: int) -> None:
        solid = np.column_stack([corners, np.zeros(len(corners))])
        pixels, _ = cv2.projectPoints(solid, rotation, translation, MATRIX, BENT)
        twice = (pixels.reshape(-1, 2) + 0.5) * 2 - 0.5
        cv2.fillPoly(picture, [np.round(twice * 16).astype(np.int32)], (shade,) * 3, cv2.LINE_AA, 4)

    fill(sides * [COLUMNS + 3, ROWS + 3] - 2, 245)
    for row in range(-1, ROWS):
        for column in range(-1, COLUMNS):
            if (row + column) % 2:
                fill(sides + np.array([column, row]), 25)
    return np.asarray(cv2.resize(picture, SIZE, interpolation=cv2.INTER_AREA))


def clip(count: int = 20, reach: float = 1.0) -> Iterator[np.ndarray]:
    generator = np.random.default_rng(4)
    for number in range(count):
        rotation = generator.uniform(-0.45, 0.45, 3) * [1, 1, 0.4]
        away = generator.uniform(13, 20)
        aside = reach * np.array([(-1, -1), (1, -1), (1, 1), (-1, 1), (0, 0)][number % 5]) * [0.22, 0.16] * away
        yield drawn(rotation, np.array([*(aside - [(COLUMNS - 1) / 2, (ROWS - 1) / 2]), away]))


def test_a_bent_lens_is_found_again() -> None:
    views, size = collect_views(clip(), COLUMNS, ROWS)
    assert size == SIZE
    fit = calibrate_lens(views, size, COLUMNS, ROWS)
    assert fit.error < 0.3
    assert fit.error < 0.6 * fit.straight_error
    assert fit.lens.k1 == pytest.approx(-0.25, abs=0.06)
    assert fit.lens.focal == pytest.approx((420, 424), rel=0.03)
    assert fit.lens.centre == pytest.approx((242, 177), abs=8)


def test_a_clip_in_which_the_board_stays_in_the_middle_or_is_never_seen_is_refused() -> None:
    views, size = collect_views(clip(reach=0.0), COLUMNS, ROWS)
    with pytest.raises(LensClipError, match=r"differ; at least 8|of the picture's width"):
        calibrate_lens(views, size, COLUMNS, ROWS)
    views, _ = collect_views([np.full((360, 480, 3), 128, np.uint8)] * 3, COLUMNS, ROWS)
    with pytest.raises(LensClipError, match="seen whole in 0 views that differ; at least 8 are needed"):
        calibrate_lens(views, SIZE, COLUMNS, ROWS)
    with pytest.raises(LensClipError, match="no picture"):
        collect_views([], COLUMNS, ROWS)
    with pytest.raises(LensClipError, match="changes its size"):
        collect_views([np.zeros((360, 480, 3), np.uint8), np.zeros((36, 48, 3), np.uint8)], COLUMNS, ROWS)


def test_the_command_keeps_the_lens_beside_the_site_file(project: Path, tmp_path: Path) -> None:
    site = yaml.safe_load((project / "deploy/sites/hall/site.yaml").read_text(encoding="utf-8"))
    site_file = tmp_path / "site.yaml"
    site_file.write_text(yaml.safe_dump(site))
    video = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(video), cv2.VideoWriter.fourcc(*"MJPG"), 5.0, SIZE)
    for picture in clip():
        writer.write(picture)
    writer.release()
    camera, console = site["cameras"][0]["id"], Console(record=True, width=200)
    assert command(video, "7x5", str(site_file), camera, console) == 0
    kept = yaml.safe_load((tmp_path / "site.setup.yaml").read_text(encoding="utf-8"))
    assert kept["cameras"][camera]["lens"]["k1"] == pytest.approx(-0.25, abs=0.08)
    assert command(video, "7by5", None, None, console) == 2
    assert command(video, "7x5", str(site_file), "nowhere", console) == 2
    assert command(tmp_path / "none.avi", "7x5", None, None, console) == 2
    said = console.export_text()
    assert "such as 9x6" in said
    assert "has no camera of this name" in said
    assert "does not exist" in said
