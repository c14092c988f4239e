"""``/v1/session``: staff sign in with name and password, and get a token that goes where a key goes."""

from __future__ import annotations

import asyncio
import hmac
import math

from fastapi import APIRouter, Request
from pydantic import SecretStr
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.admin.account_replies import Credentials, NewPassword, Session, SignedIn
from services.api.admin.accounts import Accounts
from services.api.admin.audit_layer import claimed
from services.api.admin.roles import SCOPES_OF, Role
from services.api.auth import Holder, presented_key, too_many
from services.api.examples import EXAMPLES
from services.api.json_answer import unkept_answer
from services.api.openapi import GONE, documented, errors
from services.api.problems import Problem, ProblemError
from services.api.request_body import described, read_struct
from shared.client_address import source_of
from shared.rate_limiter import RateLimiter

__all__ = ["session_routes"]

LARGEST = 4096
"""Bytes."""
AT_ONCE = 2
"""Passwords that are tried at once: each takes 32 MiB and a tenth of a second of a core."""
OF_A_NAME = (10, 30.0)
"""Wrong passwords for it from one address at once, and seconds until there is another try."""
OF_AN_ADDRESS = (100, 2.0)
"""More, because all who come through one proxy have one address."""
ON_BEHALF_OF = "x-atrium-client"
"""Header in which the dashboard says whose browser it asks for."""

LONGEST_CLIENT = 100


def session_routes(accounts: Accounts, dashboard_key: SecretStr | None) -> APIRouter:
    """Return the routes.

    Args:
        accounts: the staff.
        dashboard_key: whoever shows it is believed for whom they ask.
    """
    router = APIRouter(prefix="/v1/session", tags=["accounts"], default_response_class=Response)
    rations = [RateLimiter(1.0 / seconds, tries) for tries, seconds in (OF_A_NAME, OF_AN_ADDRESS)]
    desk = asyncio.Semaphore(AT_ONCE)

    def client_of(request: Request) -> str:
        told = request.headers.get(ON_BEHALF_OF, "")
        shown = presented_key(request.scope) or b""
        if told and dashboard_key is not None and hmac.compare_digest(shown, dashboard_key.get_secret_value().encode()):
            return told[:LONGEST_CLIENT]
        return source_of(request.client.host if request.client else "")

    async def role_of(request: Request, name: str, password: str) -> Role:
        # A stranger who guesses must not lock out the one whose name it is: rations of a name are by address, too.
        source = client_of(request)
        sources = list(zip(rations, (f"{source}\n{name}", source), strict=True))
        wait = max(ration.wait(source) for ration, source in sources)
        if wait > 0.0:
            raise ProblemError(*too_many("too many wrong passwords", wait))
        # Counted before it is tried: many at once are many tries.
        for ration, source in sources:
            ration.spend(source)
        async with desk:
            role = await run_in_threadpool(accounts.is_right, name, password)
        if role is None:
            raise ProblemError(
                Problem(
                    type="urn:atrium:unauthorized",
                    title="Wrong name or password",
                    status=401,
                    detail="name or password is wrong",
                    field="password",
                    found="a name and password that do not go together",
                    allowed="those of one of the staff",
                ),
                {"WWW-Authenticate": 'Bearer realm="atrium"'},
            )
        for ration, source in sources:
            ration.spend(source, -1.0)
        return role

    @router.post(
        "",
        responses=documented(SignedIn, 413, 422, 429, 503),
        openapi_extra=described(Credentials, EXAMPLES[Credentials]) | {"security": []},
    )
    async def sign_in(request: Request) -> Response:
        """Sign in; needs no key. After ten wrong passwords for a name from one address, or a hundred from it: wait."""
        told = await read_struct(request, Credentials, LARGEST, "user and password")
        request.state.audit_who = claimed(told.user)
        role = await role_of(request, told.user, told.password)
        request.state.audit_who = told.user
        made = await run_in_threadpool(accounts.sign_in, told.user, role)
        return unkept_answer(
            SignedIn(token=made.token, user=made.user, role=role, scopes=sorted(SCOPES_OF[role]), expires=made.expires)
        )

    @router.get("", responses=documented(Session))
    async def who_am_i(request: Request) -> Response:
        """Whose key or token this is, and what it may do."""
        holder: Holder = request.state.holder
        expires = None if math.isinf(holder.expires) else holder.expires
        return unkept_answer(Session(name=holder.name, role=holder.role, scopes=sorted(holder.scopes), expires=expires))

    @router.delete("", status_code=204, responses=GONE | errors(409, 503))
    async def sign_out(request: Request) -> Response:
        """Sign out: the token opens nothing any more."""
        _only_people(request.state.holder)
        await run_in_threadpool(accounts.sign_out, presented_key(request.scope) or b"")
        return Response(status_code=204)

    @router.put(
        "/password",
        responses=documented(Session, 409, 413, 422, 429, 503),
        openapi_extra=described(NewPassword, EXAMPLES[NewPassword]),
    )
    async def change_password(request: Request) -> Response:
        """Change one's own password; all sign-ins of that name end, this one too."""
        holder: Holder = request.state.holder
        _only_people(holder)
        told = await read_struct(request, NewPassword, LARGEST, "password and new_password")
        request.state.audit_who = f"{holder.name} ({holder.id})"
        await role_of(request, holder.name, told.password)
        await run_in_threadpool(accounts.change, holder.name, None, told.new_password)
        return unkept_answer(Session(name=holder.name, role=holder.role, scopes=[], expires=None))

    return router


def _only_people(holder: Holder) -> None:
    if holder.role is None:
        raise ProblemError(
            Problem(
                type="urn:atrium:not-a-session",
                title="Not a sign-in",
                status=409,
                detail="this is a key, not the token of a sign-in: keys are revoked with DELETE /v1/keys/{key}",
            )
        )
