"""What can go wrong, as the API says it: RFC 9457 problem details as exceptions."""

from __future__ import annotations

import httpx
import msgspec

__all__ = ["AtriumError", "Conflict", "NotAllowed", "NotFound", "TryLater", "error_of"]


class _Problem(msgspec.Struct):
    type: str = "about:blank"
    title: str = ""
    detail: str = ""
    field: str | None = None
    found: str | None = None
    allowed: str | None = None


class AtriumError(Exception):
    """The API refused.

    Attributes:
        status: of HTTP.
        type: a URN that names the kind of problem.
        field: what is to blame, where it is one thing.
        found: what it held.
        allowed: what it may hold.
        retry_after: seconds, where the API says so.
    """

    def __init__(self, status: int, problem: _Problem, retry_after: float | None = None) -> None:
        super().__init__(f"{status} {problem.title}: {problem.detail}")
        self.status = status
        self.type = problem.type
        self.field = problem.field
        self.found = problem.found
        self.allowed = problem.allowed
        self.retry_after = retry_after


class NotAllowed(AtriumError):  # noqa: N818 (reads as what it is)
    """No key, one that does not hold, or one that lacks the scope."""


class NotFound(AtriumError):  # noqa: N818
    """Nothing of that name, or nothing known of it yet."""


class Conflict(AtriumError):  # noqa: N818
    """Somebody else changed it meanwhile, or its name is taken."""


class TryLater(AtriumError):  # noqa: N818
    """Too many requests, or something the API needs is away: try again after ``retry_after`` seconds."""


_KINDS = {401: NotAllowed, 403: NotAllowed, 404: NotFound, 409: Conflict, 412: Conflict, 429: TryLater, 503: TryLater}


def error_of(response: httpx.Response) -> AtriumError:
    """Return the exception for an answer that has been read and is no success."""
    try:
        problem = msgspec.json.decode(response.content, type=_Problem)
    except msgspec.MsgspecError:  # a proxy's page
        problem = _Problem(title=response.reason_phrase, detail=response.text[:200])
    after = response.headers.get("Retry-After", "")
    kind = _KINDS.get(response.status_code, AtriumError)
    return kind(response.status_code, problem, float(after) if after.isdigit() else None)
