"""Rendered cameras over real HTTP, read as the camera service reads a network camera."""

import threading
from collections.abc import Iterator

import cv2
import httpx
import numpy as np
import pytest
from waiting import wait_until

from services.simulator.video.video_server import FrameFeed, video_app
from shared.http_server import serve


def jpeg(level: int) -> bytes:
    good, data = cv2.imencode(".jpg", np.full((48, 64, 3), level, np.uint8))
    assert good
    return data.tobytes()


@pytest.fixture
def camera(free_port: int) -> Iterator[tuple[str, FrameFeed]]:
    """A camera whose grey level counts up by four with each picture, fifty pictures a second while watched."""
    feed, stopping = FrameFeed(), threading.Event()

    def render() -> None:
        number = 0
        while not stopping.wait(0.02):
            if feed.someone_watches.is_set():
                feed.publish(jpeg(number * 4 % 256), 1000.0 + number)
                number += 1

    threads = [
        threading.Thread(target=render, daemon=True),
        threading.Thread(target=serve, args=(video_app({"east": feed}), "127.0.0.1", free_port, stopping), daemon=True),
    ]
    for thread in threads:
        thread.start()
    url = f"http://127.0.0.1:{free_port}"

    def listening() -> bool:
        try:
            return httpx.get(url + "/cameras").status_code == 200
        except httpx.TransportError:
            return False

    wait_until(listening, 10, "the video server")
    yield url, feed
    stopping.set()
    feed.close()
    for thread in threads:
        thread.join(timeout=6)
        assert not thread.is_alive()


def test_opencv_reads_the_stream_and_two_readers_do_not_disturb_each_other(camera: tuple[str, FrameFeed]) -> None:
    url, _ = camera
    readers = [cv2.VideoCapture(f"{url}/cameras/east.mjpeg") for _ in range(2)]
    try:
        for reader in readers:
            assert reader.isOpened()
            levels = []
            for _ in range(12):
                good, picture = reader.read()
                assert good
                assert picture.shape == (48, 64, 3)
                levels.append(int(picture.mean()))
            assert len(set(levels)) > 6
    finally:
        for reader in readers:
            reader.release()


def test_a_still_is_one_picture_with_its_time(camera: tuple[str, FrameFeed]) -> None:
    url, _ = camera
    answer = httpx.get(url + "/cameras/east.jpg")
    assert answer.headers["content-type"] == "image/jpeg"
    assert float(answer.headers["x-timestamp"]) >= 1000.0
    assert cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_COLOR).shape == (48, 64, 3)


def test_nobody_watches_nothing_is_rendered(camera: tuple[str, FrameFeed]) -> None:
    url, feed = camera
    with httpx.stream("GET", f"{url}/cameras/east.mjpeg") as stream:
        pictures = stream.iter_bytes()  # kept: what is thrown away closes the stream
        next(pictures)
        assert feed.someone_watches.is_set()
    wait_until(lambda: not feed.someone_watches.is_set(), 10, "the reader to be noticed gone")


def test_an_unknown_camera_is_named_with_those_there_are(camera: tuple[str, FrameFeed]) -> None:
    url, _ = camera
    answer = httpx.get(url + "/cameras/west.mjpeg")
    assert answer.status_code == 404
    assert "'west'; there are: east" in answer.json()["detail"]


def test_closing_ends_the_streams(camera: tuple[str, FrameFeed]) -> None:
    url, feed = camera
    with httpx.stream("GET", f"{url}/cameras/east.mjpeg", timeout=5) as stream:
        pieces = stream.iter_bytes()
        next(pieces)
        feed.close()
        for _ in pieces:
            pass
