"""Who saw or changed what: the one place through which reads of pictures and changes of the set-up are told."""

from __future__ import annotations

import structlog
from fastapi import Request

from services.api.auth import Holder

__all__ = ["audit"]

log = structlog.get_logger(__name__)


def audit(request: Request, action: str, subject: str, outcome: str, **facts: object) -> None:
    """Note that the holder of a key did something worth remembering.

    Args:
        request: carries whose key it was.
        action: what was done, such as ``camera still``.
        subject: to what.
        outcome: ``done``, or why not.
        facts: further plain values.
    """
    holder: Holder = request.state.holder
    log.warning("audit", action=action, subject=subject, outcome=outcome, by=holder.name, **facts)
