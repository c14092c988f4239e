"""What other services keep of one phone, asked for over the bus; only ever for the phone itself."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TypeVar

import msgspec

from services.gateway.protocol import OwnAlert, OwnKept, OwnLessons, OwnWay
from shared.bus import Bus
from shared.history_query import (
    LONGEST_TRAJECTORY,
    AskAlerts,
    AskTrajectory,
    DeviceAlerts,
    HistoryQuestion,
    Trajectory,
    decode_answer,
    numbers,
)
from shared.kept import rows_of
from shared.keys import Keys
from shared.learning_report import LearningReport
from shared.messages import Alert

__all__ = ["AwayError", "OwnPast"]

SOON, PATIENCE = 2.0, 60.0
"""Seconds services have to answer; history for two days of one phone."""
LONGEST = 366.0 * 86400.0
"""Seconds of the past that are asked for at most: as long as a token may be valid."""

A = TypeVar("A", Trajectory, DeviceAlerts)


class AwayError(RuntimeError):
    """A service does not answer, or not so that it is understood."""


class OwnPast:
    """Asks; from any thread, which waits for the answer.

    Args:
        bus: where services are asked.
        keys: of the site.
        told: returns an alert as the phone it is about is told of it.
    """

    def __init__(self, bus: Bus, keys: Keys, told: Callable[[Alert], OwnAlert]) -> None:
        self._bus = bus
        self._told = told
        self._keys = keys

    def kept(self) -> list[OwnKept]:
        """Return what each service that answers keeps of people; the same of two processes once."""
        rows, _ = rows_of(self._bus.ask(self._keys.kept(), SOON))
        told = (OwnKept(service=service, what=row.what, seconds=row.seconds, note=row.note) for service, row in rows)
        return list(dict.fromkeys(told))  # settings, in which rows may differ, are not told

    def learned(self, device: str) -> OwnLessons | None:
        """Return what was learned of a device, None where nothing was.

        Raises:
            AwayError: learning does not answer.
        """
        for _, payload in self._bus.ask(self._keys.learning_report(), SOON):
            try:
                report = msgspec.json.decode(payload, type=LearningReport)
            except msgspec.MsgspecError as error:
                raise AwayError(f"learning's answer was not understood: {error}") from error
            of = next((row for row in report.devices if row.device == device), None)
            return None if of is None else msgspec.convert(of, OwnLessons, from_attributes=True)
        raise AwayError("learning does not answer")

    def ways(self, device: str, since: float, until: float) -> Iterator[OwnWay]:
        """Yield where a device was and what was told of it, in portions that history answers, the oldest first.

        Raises:
            AwayError: history does not answer, or refuses.
        """
        begin = max(since, until - LONGEST)
        while begin < until:
            end = min(begin + LONGEST_TRAJECTORY, until)
            way = self._ask(AskTrajectory(device=device, since=begin, until=end), Trajectory)
            alerts = self._ask(AskAlerts(device=device, since=begin, until=end), DeviceAlerts).alerts
            yield OwnWay(
                since=begin,
                until=end,
                t=numbers(way.t).tolist(),
                floor=[way.floors[row] for row in numbers(way.floor, whole=True).tolist()],
                x=numbers(way.x).tolist(),
                y=numbers(way.y).tolist(),
                accuracy=numbers(way.accuracy).tolist(),
                alerts=[self._told(alert) for alert in alerts],
            )
            begin = end

    def _ask(self, question: HistoryQuestion, kind: type[A]) -> A:
        for _, payload in self._bus.ask(self._keys.history(), PATIENCE, msgspec.json.encode(question)):
            try:
                answer = decode_answer(payload)
            except msgspec.MsgspecError as error:
                raise AwayError(f"history's answer was not understood: {error}") from error
            if not isinstance(answer, kind):
                raise AwayError(f"history cannot answer: {getattr(answer, 'words', 'it told something else')}")
            return answer
        raise AwayError("history does not answer")
