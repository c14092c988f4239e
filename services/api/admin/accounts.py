"""Who may come in beside the keys of the settings: keys that were issued, staff, and their sign-ins.

Of keys, passwords and tokens only digests are kept. What the guard of every request asks is a mapping in memory, which
is replaced as a whole after each change; the database is asked at the start and when something changes.
"""

from __future__ import annotations

import hashlib
import math
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, cast

import structlog
from sqlalchemy import Engine, delete, func, insert, select, update
from sqlalchemy.exc import IntegrityError, SQLAlchemyError

from services.api.admin.passwords import NOBODY, SHORTEST, hash_password, is_password
from services.api.admin.roles import SCOPES_OF, Role
from services.api.admin.tables import KeyRow, SessionRow, UserRow
from services.api.auth import Holder
from services.api.database_away import database_away
from services.api.problems import Problem, ProblemError, invalid_value, unknown
from services.api.settings import ALL_SCOPES, Scope
from shared.database import unreachable
from shared.runner import ServiceError
from shared.weak_secrets import why_weak

__all__ = ["Accounts", "IssuedKey", "SignIn", "User"]

log = structlog.get_logger(__name__)

MOST_KEYS, MOST_USERS, MOST_SESSIONS = 1000, 1000, 20
"""The last of one person; the oldest gives way."""
HOUR = 3600.0
LOOKED_AGAIN = 60.0
"""Seconds after which the database is read again: `atrium staff` may have changed it."""


@dataclass(frozen=True)
class IssuedKey:
    """One key; the secret is known to whoever it was issued to."""

    id: str
    name: str
    scopes: list[Scope]
    rate: float
    created: float
    expires: float | None
    last_used: float | None = None
    """To the hour; None: not yet."""


@dataclass(frozen=True)
class User:
    """One of the staff."""

    name: str
    role: Role
    created: float


@dataclass(frozen=True)
class SignIn:
    """One sign-in: the token is told once."""

    token: str
    user: str
    role: Role
    expires: float


_ADMINS = select(func.count()).select_from(UserRow).where(UserRow.role == "admin")


class Accounts:
    """Keys, staff and sign-ins of one site.

    Args:
        engine: the database.
        session_hours: after which a sign-in ends.
        session_rate: requests per second of one sign-in.
        clock: wall clock.

    Raises:
        ServiceError: the database cannot be read.
    """

    def __init__(
        self, engine: Engine, session_hours: float, session_rate: float, clock: Callable[[], float] = time.time
    ) -> None:
        self._engine = engine
        self._seconds = 3600.0 * session_hours
        self._session_rate = session_rate
        self._clock = clock
        self._lock = threading.Lock()
        self._used: dict[str, float] = {}
        """When issued keys were used last, to the hour, as far as this process knows."""
        self._written: dict[str, float] = {}
        """And what of it is in the database."""
        self._loaded = 0.0
        self.holders: dict[bytes, Holder] = {}
        """By the digest of key or token."""
        try:
            self._load()
        except SQLAlchemyError as error:
            raise ServiceError(unreachable(engine, error)) from error

    def issue(self, name: str, scopes: list[Scope], rate: float, expires: float | None) -> tuple[IssuedKey, str]:
        """Return a new key and its secret, which is told nowhere else.

        Raises:
            ProblemError: there are too many, or the database is away.
        """
        key = IssuedKey(f"k-{secrets.token_hex(4)}", name, scopes, rate, self._clock(), expires)
        secret = f"atrium-{secrets.token_urlsafe(32)}"
        row: dict[str, object] = {"id": key.id, "name": name, "scopes": " ".join(scopes), "rate": rate}
        row |= {"digest": _digest(secret).hex(), "created": key.created, "expires": expires}
        self._change(insert(KeyRow).values(row), most=(select(func.count()).select_from(KeyRow), MOST_KEYS, "key"))
        return key, secret

    def issued(self) -> list[IssuedKey]:
        """Return all keys, the newest first."""
        columns = (KeyRow.id, KeyRow.name, KeyRow.scopes, KeyRow.rate, KeyRow.created, KeyRow.expires, KeyRow.last_used)
        keys = [
            IssuedKey(name, title, _scopes(scopes), rate, created, expires, self._used.get(name, used))
            for name, title, scopes, rate, created, expires, used in self._read(select(*columns))
        ]
        return sorted(keys, key=lambda key: -key.created)

    def note_use(self, holder: Holder) -> None:
        """Note that a key is used now, to the hour; costs no access to the database."""
        if holder.id and holder.role is None:
            self._used[holder.id] = self._clock() // HOUR * HOUR

    def keep(self) -> None:
        """Write down which keys were used, and see what was changed from the command line; called about once a second.

        Raises:
            SQLAlchemyError: the database is away.
        """
        if self._clock() >= self._loaded + LOOKED_AGAIN:
            with self._lock:
                self._load()
        used = {key: at for key, at in list(self._used.items()) if self._written.get(key) != at}
        if not used:
            return
        with self._engine.begin() as connection:
            for key, at in used.items():
                connection.execute(update(KeyRow).where(KeyRow.id == key).values(last_used=at))
        self._written |= used

    def revoke(self, key: str) -> None:
        """Let a key open nothing any more.

        Raises:
            ProblemError: there is none of that id, or the database is away.
        """
        if not self._change(delete(KeyRow).where(KeyRow.id == key)):
            raise unknown("key", key)

    def users(self) -> list[User]:
        """Return the staff by name."""
        rows = self._read(select(UserRow.name, UserRow.role, UserRow.created).order_by(UserRow.name))
        return [User(name, role, created) for name, role, created in rows]

    def let_in(self, name: str, role: Role, password: str) -> User:
        """Add one of the staff.

        Raises:
            ProblemError: the name is taken, there are too many, or the database is away.
        """
        alike = next((user.name for user in self.users() if user.name.casefold() == name.casefold()), name)
        if alike != name:
            words = f"{alike} is somebody's; names that differ in capitals only are taken for each other"
            raise _refused("id-taken", "Name taken", words)
        _strong(password)
        user = User(name, role, self._clock())
        row = {"name": name, "role": role, "password": hash_password(password), "created": user.created}
        self._change(insert(UserRow).values(row), most=(select(func.count()).select_from(UserRow), MOST_USERS, "user"))
        return user

    def change(self, name: str, role: Role | None, password: str | None) -> User:
        """Give one of the staff another role or password; whoever is signed in under the name has to do so again.

        Raises:
            ProblemError: there is nobody of that name, it is the last admin, or the database is away.
        """
        values: dict[str, Any] = {} if role is None else {"role": role}
        if password is not None:
            _strong(password)
            values["password"] = hash_password(password)
        if not self._change(
            update(UserRow).where(UserRow.name == name).values(values or {"name": name}),
            delete(SessionRow).where(SessionRow.user == name),
            leaves_admins=role is not None,
        ):
            raise unknown("user", name)
        return next(user for user in self.users() if user.name == name)

    def shut_out(self, name: str) -> None:
        """Take one of the staff out.

        Raises:
            ProblemError: there is nobody of that name, it is the last admin, or the database is away.
        """
        if not self._change(
            delete(UserRow).where(UserRow.name == name),
            delete(SessionRow).where(SessionRow.user == name),
            leaves_admins=True,
        ):
            raise unknown("user", name)

    def is_right(self, name: str, password: str) -> Role | None:
        """Return the role of whoever has this name and password, None where nobody has."""
        rows = self._read(select(UserRow.role, UserRow.password).where(UserRow.name == name))
        role, stored = rows[0] if rows else (None, NOBODY)
        return role if is_password(password, stored) and rows else None

    def sign_in(self, name: str, role: Role) -> SignIn:
        """Return a token for somebody whose password was right.

        Raises:
            ProblemError: the database is away.
        """
        now = self._clock()
        token = f"atrium-session-{secrets.token_urlsafe(32)}"
        row = {"digest": _digest(token).hex(), "user": name, "created": now, "expires": now + self._seconds}
        mine = select(SessionRow.digest).where(SessionRow.user == name).order_by(SessionRow.created.desc())
        self._change(
            insert(SessionRow).values(row),
            delete(SessionRow).where(SessionRow.expires <= now),
            delete(SessionRow).where(SessionRow.digest.in_(mine.offset(MOST_SESSIONS).limit(MOST_SESSIONS))),
        )
        return SignIn(token, name, role, now + self._seconds)

    def sign_out(self, token: bytes) -> None:
        """End a sign-in.

        Raises:
            ProblemError: the database is away.
        """
        digest = hashlib.sha256(token).hexdigest()
        self._change(delete(SessionRow).where(SessionRow.digest == digest))

    def _read(self, statement: Any) -> list[Any]:
        with database_away(self._engine), self._engine.connect() as connection:
            return list(connection.execute(statement).all())

    def _change(
        self, first: Any, *others: Any, most: tuple[Any, int, str] | None = None, leaves_admins: bool = False
    ) -> int:
        """Make the changes as one, then let the guard see them; return how many rows the first one touched."""
        with self._lock, database_away(self._engine):
            try:
                with self._engine.begin() as connection:
                    if most is not None and (connection.scalar(most[0]) or 0) >= most[1]:
                        raise _refused("full", "Too many", f"there are {most[1]} {most[2]}s already, no more are kept")
                    admins = connection.scalar(_ADMINS) if leaves_admins else 0
                    touched: int = connection.execute(first).rowcount
                    if admins and not connection.scalar(_ADMINS):
                        raise _refused("last-admin", "Last admin", "let another admin in first")
                    for statement in others:
                        connection.execute(statement)
                self._load()
            except IntegrityError as error:
                raise _refused("id-taken", "Name taken", "there is one of that name already") from error
        return touched

    def _load(self) -> None:
        holders: dict[bytes, Holder] = {}
        with self._engine.connect() as connection:
            for key in connection.execute(select(KeyRow.__table__)).all():
                holders[bytes.fromhex(key.digest)] = Holder(
                    name=key.name,
                    scopes=frozenset(_scopes(key.scopes)),
                    expires=math.inf if key.expires is None else key.expires,
                    rate=key.rate,
                    id=key.id,
                )
            rows = select(SessionRow.digest, SessionRow.expires, UserRow.name, UserRow.role).join(
                UserRow, UserRow.name == SessionRow.user
            )
            for digest, expires, name, role in connection.execute(rows).all():
                holders[bytes.fromhex(digest)] = Holder(
                    name=name,
                    scopes=SCOPES_OF.get(cast(Role, role), frozenset()),
                    expires=expires,
                    rate=self._session_rate,
                    id=f"s-{digest[:8]}",
                    role=role,
                )
        self.holders = holders
        self._loaded = self._clock()


def _scopes(text: str) -> list[Scope]:
    """Scopes that this version does not know open nothing."""
    return [scope for scope in ALL_SCOPES if scope in text.split()]


def _digest(secret: str) -> bytes:
    # The secrets are random and long: nothing slower than this is needed to keep them.
    return hashlib.sha256(secret.encode()).digest()


def _strong(password: str) -> None:
    """Refuse a password that is guessed first.

    Raises:
        ProblemError: this one is.
    """
    weak = why_weak(password, SHORTEST)
    if weak is not None:
        raise ProblemError(invalid_value("password", "one that " + weak, "one that nobody guesses"))


def _refused(kind: str, title: str, detail: str) -> ProblemError:
    return ProblemError(Problem(type=f"urn:atrium:{kind}", title=title, status=409, detail=detail, field="name"))
