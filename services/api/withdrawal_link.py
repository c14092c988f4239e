"""Asking the gateway over the bus to end a phone's consent; every refusal is a problem in plain words."""

from __future__ import annotations

from collections.abc import Callable

import msgspec
import structlog

from services.api.problems import Problem, ProblemError, unknown
from shared.keys import Keys
from shared.withdrawal import WithdrawalAnswer, WithdrawalOrder

__all__ = ["withdraw"]

log = structlog.get_logger(__name__)

PATIENCE = 10.0
"""Seconds the gateway has: it writes into its database and closes streams."""

Ask = Callable[[str, float, bytes | None], bytes | None]


def withdraw(keys: Keys, ask: Ask, device: str, by: str) -> float:
    """Have a device's consent ended, once however often it is asked; return when it ended, s.

    Args:
        keys: of the site.
        ask: sends a query over the bus, and waits; returns the first answer, None if there was none.
        device: whose.
        by: who of the staff, for the gateway's log.

    Raises:
        ProblemError: 404 where the gateway never enrolled it, 503 where it does not answer or cannot now.
    """
    order = WithdrawalOrder(device=device, by=by)
    told = ask(keys.withdrawal(), PATIENCE, msgspec.json.encode(order))
    if told is None:
        raise _away("the gateway is not running or does not answer; ask again to be sure that the phone is erased")
    try:
        answer = msgspec.json.decode(told, type=WithdrawalAnswer)
    except msgspec.MsgspecError as error:
        log.warning("the gateway's answer was not understood", error=str(error))
        raise _away("the gateway's answer was not understood: do both services have the same version?") from error
    if answer.outcome == "unknown":
        raise unknown("device", device)
    if answer.outcome != "withdrawn":
        raise _away(answer.words or "the gateway could not do it and did not say why")
    return answer.t


def _away(words: str) -> ProblemError:
    problem = Problem(type="urn:atrium:not-erased", title="Not erased yet", status=503, detail=words)
    return ProblemError(problem, {"Retry-After": "5"})
