"""What becomes of a trial that takes too long."""

import subprocess
import threading
from typing import Any

import msgspec
import numpy as np
import pytest
from test_redetection import CAMERA

from services.camera.frame_ring import FrameRing
from services.camera.redetect_desk import RedetectDesk


class Asked:
    """A question, and the answer it got."""

    payload: bytes | None = b"{}"

    def __init__(self) -> None:
        self.answered = threading.Event()
        self.told: dict[str, Any] = {}

    def answer(self, payload: bytes) -> None:
        self.told = msgspec.json.decode(payload)
        self.answered.set()


def test_a_trial_that_takes_too_long_says_so_however_quickly_it_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    ring = FrameRing(16.0, 5.0, 4.0)
    for number in range(60):
        ring.offer(np.full((150, 200, 3), 100, np.uint8), 1000.0 + number / 4.0)
    unit = (np.eye(3), 0)
    desk = RedetectDesk(
        lambda: CAMERA, "ground", "foreground", {}, ring, lambda: None, lambda: unit, dict, lambda: "", 0.05
    )
    asked, kill = Asked(), subprocess.Popen.kill

    def slow(process: "subprocess.Popen[bytes]") -> None:
        kill(process)
        asked.answered.wait(10.0)  # whoever waits for the process is told of its end first

    monkeypatch.setattr(subprocess.Popen, "kill", slow)
    desk.take(asked)  # type: ignore[arg-type]
    assert asked.answered.wait(20.0)
    assert "took more than 0.05 s" in asked.told["error"]
    desk.close()
