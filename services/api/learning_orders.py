"""``/v1/learning``: the orders an operator can give, each logged with the name of the key."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Any, get_args

import msgspec
import structlog
from fastapi import APIRouter, Query, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.auth import Holder, needs
from services.api.learning_link import LearningLink
from services.api.learning_replies import LearningDone, RollBack
from services.api.openapi import documented, errors
from services.api.problems import Problem, ProblemError
from services.api.request_body import described, invalid, read_body, read_json, read_struct
from services.api.seen import ALL, saw
from shared.keys import is_identifier
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import ModelKind

__all__ = ["learning_orders"]

log = structlog.get_logger(__name__)

_ROLL_BACK = f"kind: {', '.join(get_args(ModelKind))}; subject: the id of an area, camera or device"
LARGEST_ORDER = 4096
LARGEST_BUNDLE = 64 * 2**20
"""Bytes."""

_BUNDLE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "All active models, for an import here or in another museum; what is in it is learning's own.",
        "content": {"application/json": {"schema": {"type": "object"}, "example": {"format": "atrium-models/1"}}},
    }
}
_A_BUNDLE = {"requestBody": {"required": True, "content": _BUNDLE[200]["content"]}}


def learning_orders(link: LearningLink) -> APIRouter:
    """Return the routes that change something, and the one that takes everything out."""
    router = APIRouter(prefix="/v1/learning", tags=["learning"], default_response_class=Response)

    def order(request: Request, command: LearningCommand) -> LearningAnswer:
        holder: Holder = request.state.holder
        answer = link.tell(msgspec.structs.replace(command, by=holder.name))
        log.warning(
            "an order to learning",
            order=command.do,
            by=holder.name,
            kind=command.kind,
            subject=command.subject,
            done=answer.done,
            answer=answer.words,
        )
        if not answer.done:
            raise _refusal(command, answer)
        return answer

    def done(answer: LearningAnswer) -> Response:
        return Response(
            msgspec.json.encode(LearningDone(words=answer.words, version=answer.version)), media_type="application/json"
        )

    @router.post(
        "/rollback",
        responses=documented(LearningDone, 404, 409, 413, 422, 503),
        openapi_extra=described(RollBack, {"kind": "radio", "subject": "hall"}),
    )
    async def roll_back(request: Request) -> Response:
        """Return one model to the version before; the order is logged with the key's name."""
        wanted = await read_struct(request, RollBack, LARGEST_ORDER, _ROLL_BACK)
        command = LearningCommand(do="rollback", kind=wanted.kind, subject=wanted.subject)
        return done(await run_in_threadpool(order, request, command))

    @router.post("/freeze", responses=documented(LearningDone, 409, 503))
    def freeze(request: Request) -> Response:
        """Let nothing new go live until unfrozen; learning itself goes on."""
        return done(order(request, LearningCommand(do="freeze")))

    @router.post("/unfreeze", responses=documented(LearningDone, 409, 503))
    def unfreeze(request: Request) -> Response:
        """Let what wins go live again."""
        return done(order(request, LearningCommand(do="unfreeze")))

    @router.get("/export", responses=_BUNDLE | errors(409, 503))
    def export(
        request: Request,
        personal: Annotated[
            bool, Query(description="models of people's phones too; needs the scope positions")
        ] = False,
    ) -> Response:
        """Take all active models out, for a copy or another museum."""
        if personal:
            needs(request.state.holder, "positions")
        saw(request, ALL)
        return Response(
            bytes(order(request, LearningCommand(do="export", personal=personal)).bundle), media_type="application/json"
        )

    @router.post(
        "/import",
        responses=documented(LearningDone, 409, 413, 422, 503),
        openapi_extra=_A_BUNDLE,
    )
    async def bring_in(
        request: Request,
        as_site: Annotated[bool, Query(description="models of another site are taken for this one's")] = False,
        area: Annotated[list[str] | None, Query(description="an area's name there and here, THERE:HERE")] = None,
        camera: Annotated[list[str] | None, Query(description="a camera's name there and here, THERE:HERE")] = None,
    ) -> Response:
        """Bring in what an export took out; it goes live once it wins. What does not fit changes nothing."""
        body = await read_body(request, LARGEST_BUNDLE)
        read_json(body, "the JSON object that GET /v1/learning/export answered", dict[str, msgspec.Raw])
        command = LearningCommand(
            do="import",
            bundle=msgspec.Raw(body),
            as_site=as_site,
            areas=_renamed("area", area or []),
            cameras=_renamed("camera", camera or []),
        )
        return done(await run_in_threadpool(order, request, command))

    return router


def _renamed(field: str, pairs: Sequence[str]) -> dict[str, str]:
    names = dict(pair.split(":", 1) for pair in pairs if pair.count(":") == 1)
    wrong = [pair for pair in pairs if pair.count(":") != 1 or not all(map(is_identifier, pair.split(":")))]
    if wrong:
        raise invalid(field, wrong[0][:100], "THERE:HERE, the name it had there and the one it has here")
    return names


def _refusal(command: LearningCommand, answer: LearningAnswer) -> ProblemError:
    """Return why learning did not do it: what it names is not there, a value does not fit, or not now."""
    status, title = (409, "Not done")
    if answer.unknown:
        status, title = (404, "Nothing of that name")
    elif answer.field is not None:
        status, title = (422, "Invalid value")
    found = {"kind": command.kind, "subject": command.subject}.get(answer.field or "")
    return ProblemError(
        Problem(
            type="urn:atrium:" + title.lower().replace(" ", "-"),
            title=title,
            status=status,
            detail=answer.words or "learning refused and did not say why",
            field=answer.field,
            found=found,
        )
    )
