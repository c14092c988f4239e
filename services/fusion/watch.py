"""Is anything wrong with what fusion is fed? Silent cameras and phones, and reasons counted too often, in plain words.

Pure but for the health it tells: time comes in as an argument.
"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable, Mapping, Sequence

from services.fusion.reasons import coarse, explain
from shared.runner import Health

__all__ = ["Watch"]

WINDOW = 60.0
"""Seconds over which reasons are counted …"""
SAMPLE = 5.0
"""… in steps of so many."""


class Watch:
    """Tells one area's health.

    Args:
        health: told.
        cameras: ids of the area's cameras.
        camera_silence: seconds after which a silent camera is a problem.
        phones_silence: seconds after which it is a problem that no phone at all is heard, while people are tracked.
        now: monotonic, s.
    """

    def __init__(
        self, health: Health, cameras: Iterable[str], camera_silence: float, phones_silence: float, now: float
    ) -> None:
        self._health = health
        self._camera_silence = camera_silence
        self._phones_silence = phones_silence
        self._frames = dict.fromkeys(sorted(cameras), now)
        self._last_phone: float | None = None
        self._counts: deque[tuple[float, Counter[str]]] = deque([(now, Counter())])
        self._explained: set[str] = set()

    def camera_spoke(self, camera: str, now: float) -> None:
        """Note a frame."""
        self._frames[camera] = now

    def phone_spoke(self, now: float) -> None:
        """Note radio or motion of any device."""
        self._last_phone = now

    def phone_known(self, now: float) -> None:
        """Note that somebody bears a phone's name: after a restart, phones did speak before this process began."""
        if self._last_phone is None:
            self._last_phone = now

    def look(self, counted: Mapping[str, int], complaints: Sequence[str], people: int, now: float) -> None:
        """Tell what is wrong now.

        Args:
            counted: how often each reason was counted since the service began.
            complaints: what the tracker finds wrong with its sensors.
            people: how many people are tracked now.
            now: monotonic, s.
        """
        for camera, seen in self._frames.items():
            silent = now - seen
            self._tell(
                f"camera {camera}",
                f"no frames from camera {camera} for {coarse(silent)} s or more: nobody is seen there; is it running, "
                "and its camera service?",
                silent >= self._camera_silence,
            )
        self._look_at_phones(people, now)
        self._tell("sensors", "; ".join(complaints), bool(complaints))
        if now - self._counts[-1][0] >= SAMPLE:
            self._look_at_counts(Counter(counted), now)

    def _look_at_phones(self, people: int, now: float) -> None:
        # One phone falls silent whenever somebody leaves. All of them at once, people still there, is another thing.
        silent = 0.0 if self._last_phone is None else now - self._last_phone
        self._tell(
            "phones",
            f"no phone has told anything for {coarse(silent)} s or more, though phones did before and people are here: "
            "nobody gets a name; is the gateway running, and can phones reach it?",
            silent >= self._phones_silence and people > 0,
        )

    def _look_at_counts(self, counted: Counter[str], now: float) -> None:
        self._counts.append((now, counted))
        while len(self._counts) > 2 and self._counts[1][0] <= now - WINDOW:
            self._counts.popleft()
        told = set()
        for reason, count in (counted - self._counts[0][1]).items():
            words = explain(reason, count)
            if words is not None:
                self._health.degraded(reason, words)
                told.add(reason)
        for reason in self._explained - told:
            self._health.well(reason)
        self._explained = told

    def _tell(self, topic: str, words: str, bad: bool) -> None:
        if bad:
            self._health.degraded(topic, words)
        else:
            self._health.well(topic)
