"""Asks a camera process for a still over the bus; every refusal is a problem in the camera's own words."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import msgspec

from services.api.problems import Problem, ProblemError
from shared.camera_still import Refusal, StillAnswer, StillQuestion
from shared.keys import Keys

__all__ = ["CameraLink"]

PATIENCE = 10.0
"""Seconds: a large picture is coded, or searched for a board, on a machine that watches people meanwhile."""

Ask = Callable[[str, float, bytes | None], bytes | None]

_REFUSALS: dict[Refusal, tuple[int, str]] = {
    "off": (403, "Stills are switched off"),
    "closed": (409, "Stills are not open"),
    "busy": (429, "Too often"),
    "no-picture": (503, "No picture yet"),
    "no-board": (404, "No checkerboard"),
    "not-understood": (422, "Not understood"),
}


class CameraLink:
    """May be used from any thread; a question waits for its answer.

    Args:
        keys: of the site.
        ask: sends a query over the bus; returns the first answer, None if there was none.
    """

    def __init__(self, keys: Keys, ask: Ask) -> None:
        self._keys = keys
        self._ask = ask

    def ask(
        self, camera: str, do: Literal["open", "look", "board"], by: str, columns: int = 0, rows: int = 0
    ) -> StillAnswer:
        """Return what the camera answers.

        Raises:
            ProblemError: it does not answer, or refuses.
        """
        question = StillQuestion(do=do, by=by, columns=columns, rows=rows)
        told = self._ask(self._keys.still(camera), PATIENCE, msgspec.json.encode(question))
        if told is None:
            raise _problem(503, "Camera does not answer", f"the process of camera {camera} does not run or answer")
        try:
            answer = msgspec.json.decode(told, type=StillAnswer)
        except msgspec.MsgspecError as error:
            words = (
                f"camera {camera} answered in a way this version does not understand: do both have the same version?"
            )
            raise _problem(503, "Camera not understood", words) from error
        if answer.refusal:
            raise _problem(*_REFUSALS[answer.refusal], answer.words)
        return answer


def _problem(status: int, title: str, words: str) -> ProblemError:
    headers = {"Retry-After": "1" if status == 429 else "5"} if status in (429, 503) else None
    return ProblemError(
        Problem(type="urn:atrium:" + title.lower().replace(" ", "-"), title=title, status=status, detail=words), headers
    )
