"""Asking the learning service over the bus, so that any number of readers ask it once in a while together."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import msgspec
import structlog

from services.api.problems import Problem, ProblemError
from shared.keys import Keys
from shared.learning_command import LearningAnswer, LearningCommand, MapKind
from shared.learning_report import LearningReport

__all__ = ["LearningLink"]

log = structlog.get_logger(__name__)

KEPT = 1.5
"""Seconds an answer is told to everybody; also that there was none."""
MAP_KEPT = 5.0
"""Seconds of a map: it changes slowly and costs more."""
MAPS_KEPT = 64
PATIENCE = 5.0
"""Seconds learning has to answer …"""
IMPORT_PATIENCE = 60.0
"""… and to bring in a bundle, which may be large: it is carried out whether anybody waits or not."""

Ask = Callable[[str, float, bytes | None], bytes | None]
"""Key, seconds to wait and payload of a query; returns the first answer, None if there was none."""


class LearningLink:
    """May be used from any thread; a question waits for its answer.

    Args:
        keys: of the site.
        ask: sends a query over the bus.
    """

    def __init__(self, keys: Keys, ask: Ask) -> None:
        self._keys = keys
        self._ask = ask
        self._lock = threading.Lock()
        self._asked = -KEPT
        self._report: LearningReport | ProblemError | None = None
        self._erasures = 0
        self._maps: dict[tuple[str, MapKind, str | None], tuple[float, LearningAnswer]] = {}

    def report(self) -> LearningReport:
        """Return what learning tells of itself, at most ``KEPT`` seconds old.

        Raises:
            ProblemError: it does not answer, or something else does.
        """
        with self._lock:
            told = self._report
            if time.monotonic() - self._asked >= KEPT or told is None:
                erasures = self._erasures
                self._report = told = self._fetch()
                self._asked = time.monotonic()
                if erasures != self._erasures:
                    self._report = None
            if isinstance(told, ProblemError):
                raise ProblemError(told.problem, told.headers)
            return told

    def forget(self) -> None:
        """Keep no report that may name a phone whose owner just withdrew consent; waits for nobody."""
        self._erasures += 1
        self._report = None

    def tell(self, command: LearningCommand) -> LearningAnswer:
        """Return the answer to an order.

        Raises:
            ProblemError: learning does not answer, or something else does.
        """
        answer = self._send(command)
        with self._lock:
            self._asked = -KEPT  # what was done shows at once
        return answer

    def history(self, command: LearningCommand) -> LearningAnswer:
        """Return one page of decisions; nothing is kept of it.

        Raises:
            ProblemError: learning does not answer, cannot read its decisions, or something else answers.
        """
        answer = self._send(command)
        if not answer.done:
            raise ProblemError(
                Problem(
                    type="urn:atrium:no-history",
                    title="Learning cannot tell its decisions",
                    status=503,
                    detail=answer.words or "learning did not say why",
                ),
                {"Retry-After": "5"},
            )
        return answer

    def map(self, area: str, kind: MapKind, access_point: str | None) -> LearningAnswer:
        """Return the answer to an order for a map, at most ``MAP_KEPT`` seconds old.

        Raises:
            ProblemError: see ``tell``.
        """
        with self._lock:
            kept = self._maps.get((area, kind, access_point))
        if kept is not None and time.monotonic() - kept[0] < MAP_KEPT:
            return kept[1]
        answer = self._send(LearningCommand(do="map", area=area, map=kind, access_point=access_point))
        with self._lock:
            self._maps.pop((area, kind, access_point), None)
            while len(self._maps) >= MAPS_KEPT:
                del self._maps[next(iter(self._maps))]
            self._maps[area, kind, access_point] = (time.monotonic(), answer)
        return answer

    def _send(self, command: LearningCommand) -> LearningAnswer:
        patience = IMPORT_PATIENCE if command.do == "import" else PATIENCE
        answer = self._ask(self._keys.learning_command(), patience, msgspec.json.encode(command))
        if answer is None:
            raise _silent()
        try:
            return msgspec.json.decode(answer, type=LearningAnswer)
        except msgspec.MsgspecError as error:
            raise _strange(error) from error

    def _fetch(self) -> LearningReport | ProblemError:
        answer = self._ask(self._keys.learning_report(), PATIENCE, None)
        if answer is None:
            return _silent()
        try:
            return msgspec.json.decode(answer, type=LearningReport)
        except msgspec.MsgspecError as error:
            return _strange(error)


def _silent() -> ProblemError:
    return ProblemError(
        Problem(
            type="urn:atrium:learning-not-running",
            title="Learning does not answer",
            status=503,
            detail="the learning service is not running or does not answer; positions do not depend on it",
        ),
        {"Retry-After": "5"},
    )


def _strange(error: Exception) -> ProblemError:
    log.warning("learning's answer was not understood", error=str(error))
    return ProblemError(
        Problem(
            type="urn:atrium:learning-not-understood",
            title="Learning's answer was not understood",
            status=503,
            detail="the learning service answered in a way this version does not understand: "
            "do both have the same version?",
        ),
        {"Retry-After": "5"},
    )
