"""What the gateway remembers of devices: consents, tokens, transmitters, trial walks. Each method is one transaction.

No token and no transmitter's address is stored: a token is its id, an address a keyed digest.
"""

from __future__ import annotations

import secrets
from collections.abc import Iterable
from dataclasses import dataclass

from sqlalchemy import Engine, Exists, delete, exists, func, select, update
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import InstrumentedAttribute, Session

from services.gateway.devices.tables import (
    ConsentRow,
    DeviceRow,
    ErasureRow,
    SpoolRow,
    TokenRow,
    TransmitterRow,
    WalkerRow,
)
from services.gateway.devices.tokens import WITHDRAWABLE
from services.gateway.devices.transmitters import digest_of

__all__ = ["DeviceStore", "Newcomer", "Record", "Registered", "StoredToken", "TransmitterTakenError", "Walker"]


class TransmitterTakenError(ValueError):
    """A transmitter belongs to another device; ``index`` says which of those given."""

    def __init__(self, index: int) -> None:
        super().__init__(f"transmitter {index} is another device's")
        self.index = index


@dataclass(frozen=True, slots=True)
class Walker:
    """What trial walks told of how somebody walks; None where they told nothing."""

    peak: float | None = None
    """Step threshold δ, m/s²; see ``services.gateway.steps.thresholds``."""
    mean: float | None = None
    """Step threshold ρ, m/s²."""
    slope: float | None = None
    """m per step/s: ``length = slope x cadence + offset``."""
    offset: float | None = None
    """m."""
    scale_variance: float | None = None
    """Of the factor by which this line may be wrong for this person."""


@dataclass(frozen=True, slots=True)
class Registered:
    """A device that may post."""

    id: str
    carrying: str
    walker: Walker | None = None


@dataclass(frozen=True, slots=True)
class Newcomer:
    """What a phone says of itself when it enrols."""

    consent_version: str
    name: str = ""
    platform: str = ""
    carrying: str = "unknown"
    transmitters: tuple[str, ...] = ()
    """Addresses with which its carrier can be heard by the site's receivers."""


@dataclass(frozen=True, slots=True)
class StoredToken:
    """A token that was handed out and not revoked."""

    id: str
    scopes: tuple[str, ...]
    created: float
    expires: float


@dataclass(frozen=True, slots=True)
class Record:
    """What is stored of one enrolled device."""

    name: str
    platform: str
    carrying: str
    created: float
    consents: tuple[tuple[str, float], ...]
    """Version and time of each that is given."""
    tokens: int
    """That open something now."""
    transmitters: int
    waiting: int
    """Messages that wait for the bus."""
    walker: Walker | None


class DeviceStore:
    """Enrolled devices. Every method may be called from any thread.

    Args:
        engine: an open database with the tables.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine

    def enrol(
        self, now: float, newcomer: Newcomer, scopes: Iterable[str], expires: float, address_key: str
    ) -> tuple[Registered, StoredToken]:
        """Store a new device, its consent, its first token and its transmitters.

        Args:
            now: the server's clock.
            newcomer: what it says of itself.
            scopes: what its first token may do.
            expires: when that ends.
            address_key: keys the digests of addresses.

        Raises:
            TransmitterTakenError: another device has one of the transmitters; nothing is stored.
        """
        device = Registered(f"d-{secrets.token_hex(8)}", newcomer.carrying)
        token = StoredToken(secrets.token_hex(8), tuple(scopes), now, expires)
        row = DeviceRow(
            id=device.id,
            token_sha256=None,
            name=newcomer.name,
            platform=newcomer.platform,
            carrying=newcomer.carrying,
            created=now,
            revoked=None,
        )
        with Session(self._engine) as session, session.begin():
            session.add(row)
            session.flush()
            session.add(ConsentRow(device=device.id, version=newcomer.consent_version, given=now, withdrawn=None))
            session.add(_token_row(device.id, token))
            _add_transmitters(session, device.id, newcomer.transmitters, address_key, now)
        return device, token

    def add_token(self, device: str, now: float, scopes: Iterable[str], expires: float) -> StoredToken:
        """Store one more token of a device."""
        token = StoredToken(secrets.token_hex(8), tuple(scopes), now, expires)
        with Session(self._engine) as session, session.begin():
            session.add(_token_row(device, token))
        return token

    def by_token(self, token_id: str) -> Registered | None:
        """Return the device a token belongs to, None where token or device is unknown or revoked."""
        query = (
            select(DeviceRow.id, DeviceRow.carrying, WalkerRow)
            .join(TokenRow, TokenRow.device == DeviceRow.id)
            .outerjoin(WalkerRow, WalkerRow.device == DeviceRow.id)
            .where(TokenRow.id == token_id, TokenRow.revoked.is_(None), DeviceRow.revoked.is_(None))
        )
        with Session(self._engine) as session:
            row = session.execute(query).one_or_none()
            return None if row is None else Registered(row.id, row.carrying, _walker(row.WalkerRow))

    def tokens(self, device: str, now: float) -> list[StoredToken]:
        """Return the tokens of a device that open something now, oldest first."""
        query = (
            select(TokenRow)
            .where(TokenRow.device == device, TokenRow.revoked.is_(None), TokenRow.expires > now)
            .order_by(TokenRow.created, TokenRow.id)
        )
        with Session(self._engine) as session:
            return [
                StoredToken(row.id, tuple(row.scopes.split()), row.created, row.expires)
                for row in session.scalars(query)
            ]

    def revoke_token(self, device: str, token_id: str, now: float) -> bool:
        """Revoke one token of a device; whether there was such a one."""
        change = (
            update(TokenRow)
            .where(TokenRow.id == token_id, TokenRow.device == device, TokenRow.revoked.is_(None))
            .values(revoked=now)
        )
        with Session(self._engine) as session, session.begin():
            return bool(session.execute(change).rowcount)  # type: ignore[attr-defined]

    def purge(self, now: float) -> None:
        """Delete tokens that open nothing any more, and let go the transmitters of devices without a valid token."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(TransmitterRow).where(~_is_valid(TransmitterRow.device, now)))
            session.execute(
                delete(TokenRow).where(TokenRow.revoked.is_not(None) | (TokenRow.expires <= now - WITHDRAWABLE))
            )

    def exists(self, device: str) -> bool:
        """Whether a device of this id is enrolled now."""
        query = select(DeviceRow.id).where(DeviceRow.id == device, DeviceRow.revoked.is_(None))
        with Session(self._engine) as session:
            return session.execute(query).one_or_none() is not None

    def withdrawn(self, device: str) -> float | None:
        """Return when a device's consent was withdrawn, None where it was not.

        Raises:
            KeyError: no such device was ever enrolled.
        """
        with Session(self._engine) as session:
            row = session.get(DeviceRow, device)
            if row is None:
                raise KeyError(device)
            return row.revoked

    def record(self, device: str, now: float) -> Record:
        """Return all that is stored of a device.

        Raises:
            KeyError: no such device is enrolled.
        """
        given = select(ConsentRow).where(ConsentRow.device == device, ConsentRow.withdrawn.is_(None))
        with Session(self._engine) as session:
            row = session.get(DeviceRow, device)
            if row is None or row.revoked is not None:
                raise KeyError(device)

            def count(table: type[TransmitterRow] | type[SpoolRow]) -> int:
                return session.scalar(select(func.count()).select_from(table).where(table.device == device)) or 0

            return Record(
                name=row.name,
                platform=row.platform,
                carrying=row.carrying,
                created=row.created,
                consents=tuple((consent.version, consent.given) for consent in session.scalars(given)),
                tokens=len(self.tokens(device, now)),
                transmitters=count(TransmitterRow),
                waiting=count(SpoolRow),
                walker=_walker(session.get(WalkerRow, device)),
            )

    def carry(self, device: str, carrying: str) -> None:
        """Store how a phone is carried now."""
        with Session(self._engine) as session, session.begin():
            session.execute(update(DeviceRow).where(DeviceRow.id == device).values(carrying=carrying))

    def devices_by_digest(self, now: float) -> dict[str, Registered]:
        """Return who transmits: devices with a valid token by the keyed digest of an address (``digest_of``)."""
        query = (
            select(TransmitterRow.digest, DeviceRow.id, DeviceRow.carrying)
            .join(DeviceRow, DeviceRow.id == TransmitterRow.device)
            .where(DeviceRow.revoked.is_(None), _is_valid(TransmitterRow.device, now))
        )
        with Session(self._engine) as session:
            return {row.digest: Registered(row.id, row.carrying) for row in session.execute(query)}

    def keep_walker(self, device: str, walker: Walker, now: float) -> None:
        """Store what trial walks told, in the place of what earlier ones did."""
        with Session(self._engine) as session, session.begin():
            session.merge(
                WalkerRow(
                    device=device,
                    peak=walker.peak,
                    mean=walker.mean,
                    slope=walker.slope,
                    offset=walker.offset,
                    scale_variance=walker.scale_variance,
                    created=now,
                )
            )

    def withdraw(self, device: str, now: float) -> None:
        """Take the consent back: all known of the device is deleted; the times stay, and whom the bus is to forget."""
        with Session(self._engine) as session, session.begin():
            for table in (TokenRow, TransmitterRow, WalkerRow, SpoolRow):
                session.execute(delete(table).where(table.device == device))
            session.execute(
                update(DeviceRow).where(DeviceRow.id == device).values(name="", platform="", carrying="", revoked=now)
            )
            session.execute(
                update(ConsentRow)
                .where(ConsentRow.device == device, ConsentRow.withdrawn.is_(None))
                .values(withdrawn=now)
            )
            session.merge(ErasureRow(device=device, withdrawn=now))


def _is_valid(device: InstrumentedAttribute[str], now: float) -> Exists:
    """Whether a device has a token that is valid now."""
    return exists().where(TokenRow.device == device, TokenRow.revoked.is_(None), TokenRow.expires > now)


def _token_row(device: str, token: StoredToken) -> TokenRow:
    return TokenRow(
        id=token.id,
        device=device,
        scopes=" ".join(token.scopes),
        created=token.created,
        expires=token.expires,
        revoked=None,
    )


def _walker(row: WalkerRow | None) -> Walker | None:
    return None if row is None else Walker(row.peak, row.mean, row.slope, row.offset, row.scale_variance)


def _add_transmitters(session: Session, device: str, addresses: tuple[str, ...], address_key: str, now: float) -> None:
    if addresses:  # those that an expired visit holds come free
        session.flush()
        session.execute(delete(TransmitterRow).where(~_is_valid(TransmitterRow.device, now)))
    for index, address in enumerate(addresses):
        digest = digest_of(address, address_key)
        found = session.get(TransmitterRow, digest)
        if found is not None and found.device != device:
            raise TransmitterTakenError(index)
        if found is None:
            session.add(TransmitterRow(digest=digest, device=device))
            try:
                session.flush()
            except IntegrityError as error:  # somebody else was a moment quicker
                raise TransmitterTakenError(index) from error
