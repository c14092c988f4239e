"""Files and folders: their own clock, their own pace, passes, and one clear sentence for everything that is wrong."""

import threading
import time
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from waiting import wait_until

from services.camera.frames import Frame, SourceError
from services.camera.recorded import FolderSource, VideoFile
from services.camera.sources import open_source
from shared.site import load_site

COUNT = 12


def drawn(number: int) -> np.ndarray:
    return np.full((48, 64, 3), 20 * number, np.uint8)


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for number in range(COUNT):
        writer.write(drawn(number))
    writer.release()
    return path


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "pictures"
    path.mkdir()
    for number in range(COUNT):
        cv2.imwrite(str(path / f"view{number}.png"), drawn(number))
    (path / "notes.txt").write_text("not a picture")
    return path


def play(source: VideoFile | FolderSource, limit: int = 1000) -> list[Frame]:
    stopping = threading.Event()
    frames = []
    for frame in source.frames(stopping):
        frames.append(frame)
        if len(frames) == limit:
            stopping.set()
    return frames


def brightness(frames: list[Frame]) -> list[int]:
    return [round(float(frame.image.mean()) / 20) for frame in frames]


def test_a_file_gives_every_picture_once_in_order(video: Path) -> None:
    frames = play(VideoFile(video, pace="fast"))
    assert brightness(frames) == list(range(COUNT))
    assert [frame.seq for frame in frames] == list(range(COUNT))


def test_the_site_files_frame_rate_wins_over_a_header_that_lies(video: Path) -> None:
    for rate, expected in ((None, 10.0), (7.0, 7.0)):
        frames = play(VideoFile(video, pace="fast", frames_per_s=rate))
        assert [frame.t - frame.pass_origin for frame in frames] == pytest.approx(
            [n / expected for n in range(COUNT)], abs=1e-6
        )


def test_a_file_at_its_own_pace_keeps_to_the_clock(video: Path) -> None:
    before = time.time()
    frames = play(VideoFile(video, frames_per_s=40.0))
    assert before <= frames[0].pass_origin <= before + 1.0
    assert time.time() - before >= (COUNT - 1) / 40.0
    assert all(frame.arrived >= frame.t - 1e-3 for frame in frames)


@pytest.mark.parametrize("step", [-3600.0, 3600.0])
def test_a_clock_that_is_set_changes_neither_the_pace_nor_the_times_of_a_file(
    video: Path, monkeypatch: pytest.MonkeyPatch, step: float
) -> None:
    begun = time.monotonic()
    clock = SimpleNamespace(
        time=lambda: time.time() + (step if time.monotonic() - begun > 0.15 else 0.0), monotonic=time.monotonic
    )
    monkeypatch.setattr("services.camera.recorded.time", clock)
    stopping = threading.Event()
    # Without this, a file that waits for the old time to come again would hold the tests up for an hour.
    threading.Timer(5.0, stopping.set).start()
    frames = list(VideoFile(video, frames_per_s=20.0).frames(stopping))
    assert [frame.t - frame.pass_origin for frame in frames] == pytest.approx([n / 20.0 for n in range(COUNT)])
    assert 0.5 < time.monotonic() - begun < 3.0


def test_as_fast_as_possible_does_not_wait(video: Path) -> None:
    before = time.monotonic()
    frames = play(VideoFile(video, pace="fast", frames_per_s=0.1))
    assert time.monotonic() - before < 10.0
    assert frames[-1].t - frames[0].t == pytest.approx((COUNT - 1) / 0.1)


def test_a_loop_begins_again_and_time_never_runs_backwards(video: Path) -> None:
    frames = play(VideoFile(video, pace="fast", loop=True), limit=3 * COUNT)
    assert brightness(frames) == 3 * list(range(COUNT))
    assert len({frame.pass_origin for frame in frames}) == 3
    assert np.all(np.diff([frame.t for frame in frames]) > 0.09)
    assert [frame.t for frame in frames[::COUNT]] == [frame.pass_origin for frame in frames[::COUNT]]


def test_a_folder_plays_in_the_order_of_its_numbers(folder: Path) -> None:
    frames = play(FolderSource(folder, pace="fast", frames_per_s=5.0))
    assert brightness(frames) == list(range(COUNT))
    assert frames[-1].t - frames[0].t == pytest.approx((COUNT - 1) / 5.0)


def test_stopping_ends_the_wait_for_a_slow_picture(video: Path) -> None:
    stopping = threading.Event()
    frames = VideoFile(video, frames_per_s=0.01).frames(stopping)
    next(frames)
    threading.Timer(0.1, stopping.set).start()
    before = time.monotonic()
    assert next(frames, None) is None
    assert time.monotonic() - before < 5.0


def complaint(source: VideoFile | FolderSource) -> SourceError:
    with pytest.raises(SourceError) as error:
        play(source)
    return error.value


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    assert str(complaint(VideoFile(tmp_path / "no.avi"))) == f"the video file {tmp_path / 'no.avi'} does not exist"


@pytest.mark.parametrize("content", [b"", b"this is no video", bytes(range(256)) * 200])
def test_a_corrupt_file_is_named(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "broken.avi"
    path.write_bytes(content)
    assert "damaged" in str(complaint(VideoFile(path)))
    assert str(path) in str(complaint(VideoFile(path)))


def test_a_file_cut_off_in_the_middle_plays_its_beginning_and_is_then_called_damaged(
    tmp_path: Path,
) -> None:
    cut = tmp_path / "cut.avi"
    writer = cv2.VideoWriter(str(cut), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (320, 240))
    for number in range(COUNT):
        writer.write(np.random.default_rng(number).integers(0, 255, (240, 320, 3), np.uint8))
    writer.release()
    whole = cut.read_bytes()
    cut.write_bytes(whole[: len(whole) // 2])
    frames = VideoFile(cut, pace="fast").frames(threading.Event())
    assert next(frames).seq == 0
    with pytest.raises(SourceError, match="damaged: it ends after") as error:
        wait_until(lambda: next(frames) is None, 20.0, "the damage")
    assert not error.value.retry


def test_a_damaged_picture_an_empty_and_a_missing_folder_are_named(folder: Path, tmp_path: Path) -> None:
    (folder / "view3.png").write_bytes(b"broken")
    assert "view3.png" in str(complaint(FolderSource(folder, pace="fast", frames_per_s=5.0)))
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "holds no pictures" in str(complaint(FolderSource(empty, frames_per_s=5.0)))
    assert "cannot be read" in str(complaint(FolderSource(tmp_path / "nowhere", frames_per_s=5.0)))


def test_the_clip_of_the_site_plays_at_seven_frames_per_second(
    project: Path, data_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATRIUM_DATA", str(data_folder))
    camera = load_site(project / "deploy/sites/pets09/site.yaml").camera("view1")
    frames = open_source(camera, "fast").frames(threading.Event())
    first, second = next(frames), next(frames)
    assert second.t - first.t == pytest.approx(1 / 7, abs=1e-6)
    assert first.image.shape == (360, 480, 3)
