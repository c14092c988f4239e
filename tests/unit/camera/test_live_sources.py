"""Streams and devices: the newest picture wins, failures are sentences, passwords stay secret."""

import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from mjpeg_server import MjpegServer
from numpy.typing import NDArray
from waiting import wait_until

from services.camera.frames import Frame, SourceError
from services.camera.live import LiveSource


def picture(number: int) -> NDArray[np.uint8]:
    return np.full((120, 160, 3), number % 200 + 20, np.uint8)


@pytest.fixture
def server(free_port: int) -> Iterator[MjpegServer]:
    server = MjpegServer(free_port, picture, rate=50.0)
    yield server
    server.close()


def test_mjpeg_over_http_gives_pictures_in_order_with_their_arrival(server: MjpegServer) -> None:
    stopping = threading.Event()
    frames: list[Frame] = []
    for frame in LiveSource(server.url, latency=0.25).frames(stopping):
        frames.append(frame)
        if len(frames) == 10:
            stopping.set()
    assert [frame.seq for frame in frames] == list(range(10))
    assert np.all(np.diff([frame.t for frame in frames]) > 0.0)
    assert frames[5].t == pytest.approx(frames[5].arrived - 0.25, abs=0.05)
    assert {frame.pass_origin for frame in frames} == {frames[0].t}


@pytest.mark.parametrize("step", [-3600.0, -0.4, 3600.0])
def test_a_clock_that_is_set_neither_stops_time_nor_lets_it_jitter(
    server: MjpegServer, monkeypatch: pytest.MonkeyPatch, step: float
) -> None:
    stopping = threading.Event()
    shift = 0.0
    monkeypatch.setattr("services.camera.live.time", SimpleNamespace(time=lambda: time.time() + shift))
    frames: list[Frame] = []
    for frame in LiveSource(server.url, latency=0.25).frames(stopping):
        frames.append(frame)
        if len(frames) == 10:
            shift = step
        elif len(frames) == 60:
            stopping.set()
    times = np.array([frame.t for frame in frames])
    told = times[-1] - times[20]
    if abs(step) > 1.0:
        assert told == pytest.approx(frames[-1].arrived - frames[20].arrived, abs=1e-6)
        assert times[-1] == pytest.approx(time.time() + step, abs=5.0)
    else:
        assert np.all(np.diff(times) > 0.0)


def test_a_slow_reader_gets_the_newest_picture_and_the_overtaken_are_counted(server: MjpegServer) -> None:
    stopping = threading.Event()
    source = LiveSource(server.url)
    frames = source.frames(stopping)
    first = next(frames)
    pause = threading.Event()
    pause.wait(1.0)  # a detector that needs a second
    second, third = next(frames), next(frames)
    assert source.overtaken >= 10
    assert third.arrived - second.arrived < 1.0
    assert second.arrived - first.arrived > 0.5
    stopping.set()
    assert next(frames, None) is None


def test_a_stream_that_dies_is_an_error_and_can_be_opened_again(free_port: int) -> None:
    server = MjpegServer(free_port, picture)
    source = LiveSource(server.url)
    frames = source.frames(threading.Event())
    next(frames)
    server.close()
    with pytest.raises(SourceError, match="stopped sending pictures"):
        wait_until(lambda: next(frames) is None, 20.0, "the failure")
    again = MjpegServer(free_port, picture)
    assert next(source.frames(threading.Event())).seq == 0
    again.close()


def test_an_unreachable_stream_is_told_without_its_password(free_port: int) -> None:
    source = LiveSource(f"http://admin:topsecret@127.0.0.1:{free_port}/stream")
    with pytest.raises(SourceError, match="gives no video") as error:
        next(source.frames(threading.Event()))
    assert "topsecret" not in str(error.value)
    assert f"127.0.0.1:{free_port}" in str(error.value)
    assert error.value.retry


def test_an_unreachable_rtsp_camera_is_told_too(free_port: int) -> None:
    with pytest.raises(SourceError, match="gives no video"):
        next(LiveSource(f"rtsp://127.0.0.1:{free_port}/h264").frames(threading.Event()))


def test_a_missing_device_is_told(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="no camera device 57"):
        next(LiveSource(57).frames(threading.Event()))
