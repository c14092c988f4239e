"""People who walk in circles, told on the bus as fusion tells it."""

import math
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

from shared.bus import Bus
from shared.keys import Keys
from shared.messages import TrackFrame

DEVICES = ["d-7f3a11c1b07", None, "d-11c0a5520e4", None, "d-90b2e1177aa", None]
"""What the six people in the hall carry; the one in the gallery carries nothing."""
UNSEEN = DEVICES[4]
"""Whom no camera sees, and whose phone alone tells where."""


@contextmanager
def walking(bus: Bus, keys: Keys) -> Iterator[None]:
    """Six people walk in the hall and one in the gallery, as fusion would tell it."""
    stopping = threading.Event()

    def walk() -> None:
        areas = {
            "hall": (bus.publisher(keys.tracks("hall"), TrackFrame, newest=True), "ground", DEVICES),
            "gallery": (bus.publisher(keys.tracks("gallery"), TrackFrame, newest=True), "gallery", [None]),
        }
        chunk = 0
        while not stopping.wait(1 / 15):
            now = time.time()
            chunk += 1
            for area, (publisher, floor, devices) in areas.items():
                publisher.publish(_frame(area, floor, chunk, now, devices))

    thread = threading.Thread(target=walk, daemon=True)
    thread.start()
    try:
        yield
    finally:
        stopping.set()
        thread.join(5)


def _frame(area: str, floor: str, chunk: int, now: float, devices: list[str | None]) -> TrackFrame:
    count = len(devices)
    middle, radii = (10.0, 5.5) if area == "hall" else (5.0, 5.0), (7.0, 4.0) if area == "hall" else (3.0, 3.0)
    angles = [0.16 * now + 2 * math.pi * n / count for n in range(count)]
    return TrackFrame(
        t=now,
        area=area,
        chunk=chunk,
        tracker="test",
        track=list(range(1, count + 1)),
        floor=[floor] * count,
        x=[middle[0] + radii[0] * math.cos(a) for a in angles],
        y=[middle[1] + radii[1] * math.sin(a) for a in angles],
        covariance=[(0.5, 0.2, 0.8) if device and device == UNSEEN else (0.04, 0.0, 0.04) for device in devices],
        vx=[-0.16 * radii[0] * math.sin(a) for a in angles],
        vy=[0.16 * radii[1] * math.cos(a) for a in angles],
        state=["unseen" if device and device == UNSEEN else "confirmed" for device in devices],
        device=devices,
        probability=[0.97] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[]] * count,
        sources=[["hall-east"]] * count,
        quality=[0.9] * count,
    )
