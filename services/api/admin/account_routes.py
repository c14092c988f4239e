"""``/v1/keys`` and ``/v1/users``: who may come in. Nobody gives away more than they have."""

from __future__ import annotations

import time
from urllib.parse import quote

from fastapi import APIRouter, Request
from starlette.concurrency import run_in_threadpool
from starlette.responses import Response

from services.api.admin.account_replies import Key, Keys, NewKey, NewUser, OneKey, StaffMember, UserChange, Users
from services.api.admin.accounts import Accounts
from services.api.admin.roles import SCOPES_OF, Role
from services.api.auth import Holder
from services.api.examples import EXAMPLES
from services.api.json_answer import unkept_answer
from services.api.openapi import GONE, created, documented, errors
from services.api.problems import Problem, ProblemError
from services.api.request_body import described, invalid, read_struct
from services.api.settings import Scope
from services.api.times import YEAR_9999

__all__ = ["account_routes"]

LARGEST = 16_384
"""Bytes."""


def account_routes(accounts: Accounts, key_rate: float) -> APIRouter:
    """Return the routes; ``key_rate`` is that of keys that name none."""
    router = APIRouter(prefix="/v1", tags=["accounts"], default_response_class=Response)

    def may_change(holder: Holder, name: str) -> None:
        for user in accounts.users():
            if user.name == name:
                _may_give(holder, user.role)

    @router.get("/keys", responses=documented(Keys, 503))
    def keys() -> Response:
        """The keys that were issued; never their secrets."""
        return unkept_answer(Keys(t=time.time(), keys=[Key(**vars(key)) for key in accounts.issued()]))

    @router.post(
        "/keys",
        status_code=201,
        responses=created(OneKey, 409, 413, 422, 503),
        openapi_extra=described(NewKey, EXAMPLES[NewKey]),
    )
    async def issue(request: Request) -> Response:
        """Issue a key; the secret is told in this answer and nowhere else."""
        wanted = await read_struct(request, NewKey, LARGEST, "name, scopes, and expires, rate if wanted")
        if wanted.expires is not None and not time.time() < wanted.expires < YEAR_9999:
            allowed = "seconds (not milliseconds) since the epoch, in the future and before the year 9999; null: never"
            raise invalid("expires", f"{wanted.expires:g}", allowed)
        _not_more_than_own(request.state.holder, frozenset(wanted.scopes), "scopes")
        scopes = sorted(set(wanted.scopes))
        key, secret = await run_in_threadpool(
            accounts.issue, wanted.name, scopes, wanted.rate or key_rate, wanted.expires
        )
        request.state.audit = f"issued to {key.name}: {' '.join(scopes)}"
        return unkept_answer(OneKey(**vars(key), key=secret), 201, {"Location": f"/v1/keys/{key.id}"})

    @router.delete("/keys/{key}", status_code=204, responses=GONE | errors(403, 404, 503))
    def revoke(key: str, request: Request) -> Response:
        """Let a key open nothing any more, from now on; it may open nothing that yours does not."""
        for issued in accounts.issued():
            if issued.id == key:
                _not_more_than_own(request.state.holder, frozenset(issued.scopes), "key")
        accounts.revoke(key)
        return Response(status_code=204)

    @router.get("/users", responses=documented(Users, 503))
    def users() -> Response:
        """The staff."""
        return unkept_answer(Users(t=time.time(), users=[StaffMember(**vars(user)) for user in accounts.users()]))

    @router.post(
        "/users",
        status_code=201,
        responses=created(StaffMember, 409, 413, 422, 503),
        openapi_extra=described(NewUser, EXAMPLES[NewUser]),
    )
    async def let_in(request: Request) -> Response:
        """Let somebody in, as viewer, guard, desk, curator or admin."""
        wanted = await read_struct(request, NewUser, LARGEST, "name, role, password")
        _may_give(request.state.holder, wanted.role)
        user = await run_in_threadpool(accounts.let_in, wanted.name, wanted.role, wanted.password)
        request.state.audit = f"{user.name} as {user.role}"
        return unkept_answer(StaffMember(**vars(user)), 201, {"Location": f"/v1/users/{quote(user.name)}"})

    @router.put(
        "/users/{name}",
        responses=documented(StaffMember, 404, 409, 413, 422, 503),
        openapi_extra=described(UserChange, EXAMPLES[UserChange]),
    )
    async def change(name: str, request: Request) -> Response:
        """Give somebody another role or password; they have to sign in again."""
        wanted = await read_struct(request, UserChange, LARGEST, "role, password, or both")
        if wanted.role is None and wanted.password is None:
            raise invalid("body", "nothing to change", "role, password, or both")
        # Whoever sets a password has what it opens.
        await run_in_threadpool(may_change, request.state.holder, name)
        if wanted.role is not None:
            _may_give(request.state.holder, wanted.role)
        changed = await run_in_threadpool(accounts.change, name, wanted.role, wanted.password)
        request.state.audit = f"role {wanted.role or 'as before'}, password {'new' if wanted.password else 'as before'}"
        return unkept_answer(StaffMember(**vars(changed)))

    @router.delete("/users/{name}", status_code=204, responses=GONE | errors(403, 404, 409, 503))
    def shut_out(name: str, request: Request) -> Response:
        """Take somebody out who may do nothing that you may not; their sign-ins end at once. The last admin stays."""
        may_change(request.state.holder, name)
        accounts.shut_out(name)
        return Response(status_code=204)

    return router


def _may_give(holder: Holder, role: Role) -> None:
    _not_more_than_own(holder, SCOPES_OF[role], "role")


def _not_more_than_own(holder: Holder, scopes: frozenset[Scope], field: str) -> None:
    beyond = sorted(scopes - holder.scopes)
    if beyond:
        raise ProblemError(
            Problem(
                type="urn:atrium:forbidden",
                title="More than you have",
                status=403,
                detail=f"nobody gives away or takes away scopes they do not have: {', '.join(beyond)}",
                field=field,
                found=", ".join(beyond),
                allowed=", ".join(sorted(holder.scopes)),
            )
        )
