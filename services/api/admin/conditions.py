"""Lost updates: whoever changes a thing may say which state of it they saw (RFC 9110, ``ETag`` and ``If-Match``)."""

from __future__ import annotations

from hashlib import blake2b

from services.api.problems import Problem, ProblemError

__all__ = ["check_match", "check_none_match", "etag_of"]


def etag_of(body: bytes) -> str:
    """Return the strong tag of a content: the same content always has the same."""
    return f'"{blake2b(body, digest_size=9).hexdigest()}"'


def check_match(if_match: str | None, etag: str) -> None:
    """Let a change go on whose ``If-Match`` names the present state; without one nothing is asked.

    Raises:
        ProblemError: somebody else changed it meanwhile.
    """
    if if_match is None or if_match.strip() == "*" or etag in [part.strip() for part in if_match.split(",")]:
        return
    raise ProblemError(
        Problem(
            type="urn:atrium:changed-meanwhile",
            title="Changed meanwhile",
            status=412,
            detail="somebody changed it since you read it: read it again, and change that",
            field="If-Match",
            found=if_match[:100],
            allowed=etag,
        ),
        {"ETag": etag},
    )


def check_none_match(if_none_match: str | None, etag: str) -> None:
    """Refuse a change that is wanted only where nothing is, or where it is not what somebody has already.

    Raises:
        ProblemError: it is there.
    """
    if if_none_match is None:
        return
    if if_none_match.strip() == "*" or etag in [part.strip() for part in if_none_match.split(",")]:
        raise ProblemError(
            Problem(
                type="urn:atrium:there-already",
                title="There already",
                status=412,
                detail="it is there already, and you asked not to replace it",
                field="If-None-Match",
                found=if_none_match[:100],
                allowed="no If-None-Match, or another tag",
            )
        )
