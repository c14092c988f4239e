"""The client: one method for each thing one may ask or change."""

from __future__ import annotations

import time
from collections.abc import Collection, Iterator
from types import TracebackType
from typing import Any, TypeVar
from urllib.parse import quote

import httpx
import msgspec

from atrium_client.errors import AtriumError, NotFound, error_of
from atrium_client.event_stream import Event, lines, parse
from atrium_client.models import (
    Alert,
    Device,
    DwellReport,
    Erasure,
    Exhibit,
    Flows,
    HeatMap,
    InFront,
    Occupancy,
    Position,
    SignedIn,
    Track,
    Trajectory,
    Zone,
)

__all__ = ["AtriumClient"]

T = TypeVar("T")

FIRST_PAUSE, LONGEST_PAUSE = 0.5, 15.0
"""Seconds before a stream that was lost is asked for again, doubled each time."""
SILENCE = 60.0
"""Seconds without a byte after which a stream counts as lost; the API sends a comment every ten."""


class AtriumClient:
    """Asks one API; not for several threads at once.

    Args:
        url: of the API, such as ``http://127.0.0.1:8081``.
        key: an API key; None: ``sign_in`` first.
        timeout: seconds for an answer.
        transport: in place of the network, for tests.
    """

    def __init__(
        self,
        url: str,
        key: str | None = None,
        *,
        timeout: float = 10.0,
        transport: httpx.BaseTransport | None = None,
    ) -> None:
        self._http = httpx.Client(base_url=f"{url.rstrip('/')}/v1", timeout=timeout, transport=transport)
        self._show(key)

    def __enter__(self) -> AtriumClient:
        """Use the client for the length of a block."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close its connections."""
        self.close()

    def close(self) -> None:
        """Close its connections."""
        self._http.close()

    # ---- who asks

    def sign_in(self, user: str, password: str) -> SignedIn:
        """Sign in as one of the staff; what is asked from now on is asked as them."""
        signed = self._ask("POST", "/session", SignedIn, json={"user": user, "password": password})
        self._show(signed.token)
        return signed

    def sign_out(self) -> None:
        """End the sign-in."""
        self._send("DELETE", "/session")
        self._show(None)

    # ---- who is where

    def positions(
        self,
        *,
        age: float | None = None,
        confidence: float | None = None,
        zone: str | None = None,
        near: tuple[float, float, float] | None = None,
        floor: str | None = None,
    ) -> list[Position]:
        """Return where devices are: all, or only those that match.

        Args:
            age: seconds old at most.
            confidence: at least so probable.
            zone: only in this zone.
            near: x, y and radius in metres; where the site has several floors, with ``floor``.
            floor: only on this floor.
        """
        asked = {"age": age, "confidence": confidence, "zone": zone, "near": _listed(near), "floor": floor}
        return self._pages("/positions", "positions", Position, asked)

    def position(self, device: str) -> Position | None:
        """Return where one device is, None where it has not been located lately."""
        try:
            return self._ask("GET", f"/positions/{_part(device)}", Position)
        except NotFound:
            return None

    def in_front_of(self, device: str, *, field_of_view: float = 120.0, limit: int = 10) -> InFront | None:
        """Return what one visitor may be looking at, the likeliest first; None: nobody knows where they are."""
        asked = {"field_of_view": field_of_view, "limit": limit}
        try:
            return self._ask("GET", f"/positions/{_part(device)}/exhibits", InFront, params=asked)
        except NotFound:
            return None

    def tracks(
        self,
        *,
        area: str | None = None,
        age: float | None = None,
        confidence: float | None = None,
        zone: str | None = None,
        near: tuple[float, float, float] | None = None,
        floor: str | None = None,
    ) -> list[Track]:
        """Return everybody, also people without a phone: all, or only those that match, as of ``positions``."""
        asked = {"area": area, "age": age, "confidence": confidence, "zone": zone, "near": _listed(near)}
        return self._pages("/tracks", "tracks", Track, {**asked, "floor": floor})

    def devices(self, *, zone: str | None = None, floor: str | None = None) -> list[Device]:
        """Return the devices that are located, or were lately, and their zones."""
        return self._pages("/devices", "devices", Device, {"zone": zone, "floor": floor})

    # ---- zones and exhibits

    def zones(self) -> list[Zone]:
        """Return all zones and how many people are in each."""
        return self._list("/zones", "zones", Zone)

    def zone(self, name: str) -> Zone:
        """Return one zone."""
        return self._ask("GET", f"/zones/{_part(name)}", Zone)

    def add_zone(self, zone: Zone) -> Zone:
        """Add a zone and return it as it is kept."""
        return self._ask("POST", "/zones", Zone, json=msgspec.to_builtins(zone))

    def put_zone(self, zone: Zone) -> Zone:
        """Put a zone in the place of the one of its id; if it was read, only if nobody changed it since."""
        return self._ask("PUT", f"/zones/{_part(zone.id)}", Zone, json=msgspec.to_builtins(zone), etag=zone.etag)

    def delete_zone(self, name: str, *, etag: str = "") -> None:
        """Take a zone out."""
        self._send("DELETE", f"/zones/{_part(name)}", etag=etag)

    def exhibits(self) -> list[Exhibit]:
        """Return all exhibits."""
        return self._list("/exhibits", "exhibits", Exhibit)

    def add_exhibit(self, exhibit: Exhibit) -> Exhibit:
        """Add an exhibit and return it as it is kept."""
        return self._ask("POST", "/exhibits", Exhibit, json=msgspec.to_builtins(exhibit))

    def put_exhibit(self, exhibit: Exhibit) -> Exhibit:
        """Put an exhibit in the place of the one of its id; if it was read, only if nobody changed it since."""
        path = f"/exhibits/{_part(exhibit.id)}"
        return self._ask("PUT", path, Exhibit, json=msgspec.to_builtins(exhibit), etag=exhibit.etag)

    def delete_exhibit(self, name: str, *, etag: str = "") -> None:
        """Take an exhibit out."""
        self._send("DELETE", f"/exhibits/{_part(name)}", etag=etag)

    # ---- what happened; the past: where the site keeps a history

    def alerts(self, *, since: float | None = None, zone: str | None = None, limit: int = 100) -> list[Alert]:
        """Return the newest alerts, newest first."""
        return self._list("/alerts", "alerts", Alert, {"since": since, "zone": zone, "limit": limit})

    def alerts_after(self, alert: str = "", *, limit: int = 100) -> list[Alert]:
        """Return the alerts that came after the one of this id, in the order they came; empty: from the first held.

        Raises:
            NotFound: it is not held any more: begin again.
        """
        return self._list("/alerts", "alerts", Alert, {"after": alert, "limit": limit})

    def acknowledge(self, alert: str, note: str = "") -> Alert:
        """Say that you have looked at an alert.

        Raises:
            Conflict: somebody did before.
        """
        return self._ask("POST", f"/alerts/{_part(alert)}/acknowledge", Alert, json={"note": note})

    def erase(self, device: str) -> Erasure:
        """End a phone's consent for the visitor whose it is; it cannot be undone. ``erasures`` tells how far it is.

        Raises:
            NotFound: it never was enrolled.
        """
        return self._ask("DELETE", f"/devices/{_part(device)}", Erasure)

    def erasures(self) -> list[Erasure]:
        """Return the devices whose consent has ended, the newest first."""
        return self._list("/erasures", "erasures", Erasure)

    def trajectory(self, device: str, *, since: float, until: float, step: float = 0.0) -> Trajectory:
        """Return where one device was; ``step``: seconds between two points at least."""
        asked = {"since": since, "until": until, "step": step}
        return self._ask("GET", f"/trajectories/{_part(device)}", Trajectory, params=asked)

    def occupancy(self, zone: str | None = None, *, since: float, until: float, step: int = 3600) -> Occupancy:
        """Return how many people were in a zone, or in each, by steps of so many seconds."""
        asked = {"zone": zone, "since": since, "until": until, "step": step}
        return self._ask("GET", "/occupancy", Occupancy, params=asked)

    def heat_map(self, floor: str, *, since: float, until: float, cell: float = 0.5) -> HeatMap:
        """Return where people spent their time on a floor, in whole quarter hours; ``cell``: its side, m."""
        asked = {"floor": floor, "since": since, "until": until, "cell": cell}
        return self._ask("GET", "/heatmap", HeatMap, params=asked)

    def dwell(self, *, since: float, until: float, at: str = "zones") -> DwellReport:
        """Return how long people stayed in each zone, or ``at="exhibits"`` before each, in whole quarter hours."""
        return self._ask("GET", "/dwell", DwellReport, params={"since": since, "until": until, "at": at})

    def flows(self, *, since: float, until: float, at: str = "zones") -> Flows:
        """Return how often people went from which zone, or exhibit, to which, in whole quarter hours."""
        return self._ask("GET", "/flows", Flows, params={"since": since, "until": until, "at": at})

    # ---- the site

    def site(self) -> dict[str, Any]:
        """Return what a map needs."""
        return self._document("/site", {})

    def health(self) -> dict[str, Any]:
        """Return whether all of it works, and what does not, in plain words."""
        return self._document("/health", {})

    def events(
        self,
        *,
        kinds: Collection[str] = (),
        area: str | None = None,
        device: str | None = None,
        confidence: float | None = None,
        zone: str | None = None,
        near: tuple[float, float, float] | None = None,
        floor: str | None = None,
        after: str = "",
        lossless: bool = False,
    ) -> Iterator[Event]:
        """Yield what happens, the present first, for ever: a connection that is lost is asked for again.

        After each loss it goes on with what came after the last event that had an id, so that no alert is missed.

        Args:
            kinds: only these, such as ``alert``; none: all that the key may see.
            area: only this area.
            device: only this one's rows, revisions and alerts.
            confidence: only people tracked with at least this quality.
            zone: only what is in this zone, as of ``positions``; ``near`` and ``floor`` likewise.
            near: x, y and radius in metres; where the site has several floors, with ``floor``.
            floor: only on this floor.
            after: id of an event to go on after.
            lossless: after a loss, be told every event since, also positions that are old by now.

        Raises:
            AtriumError: the API refuses, for another reason than that it is busy or away; 410: with ``lossless``, what
                came after the last event is held no more.
        """
        asked = {"kinds": ",".join(kinds), "area": area, "device": device, "confidence": confidence, "zone": zone}
        asked |= {"near": _listed(near), "floor": floor}
        params = {name: value for name, value in asked.items() if value not in (None, "")}
        pause = FIRST_PAUSE
        while True:
            try:
                for event in self._connected(params, after, lossless):
                    pause = FIRST_PAUSE
                    # "ended" is for this client: it asks again, and hears it where its key is refused.
                    if event is not None and event.name != "ended" and (not kinds or event.name in kinds):
                        after = event.id or after
                        yield event
            except httpx.TransportError:
                pass
            except AtriumError as refusal:
                if refusal.status not in (429, 502, 503, 504):
                    raise
                pause = max(pause, refusal.retry_after or 0.0)
            time.sleep(pause)
            pause = min(2.0 * pause, LONGEST_PAUSE)

    def _connected(self, params: dict[str, Any], after: str, lossless: bool) -> Iterator[Event | None]:
        headers = {"Last-Event-ID": after} if after else {}
        if lossless and after:
            params = params | {"from": after}
        timeout = httpx.Timeout(self._http.timeout.connect, read=SILENCE)
        with self._http.stream("GET", "/stream", params=params, headers=headers, timeout=timeout) as response:
            if response.is_error:
                response.read()
                raise error_of(response)
            yield from parse(lines(response.iter_bytes()))

    # ---- how it is asked

    def _show(self, key: str | None) -> None:
        self._http.headers.pop("Authorization", None)
        if key is not None:
            self._http.headers["Authorization"] = f"Bearer {key}"

    def _send(
        self, method: str, path: str, *, params: dict[str, Any] | None = None, json: Any = None, etag: str = ""
    ) -> httpx.Response:
        told = {name: value for name, value in (params or {}).items() if value is not None}
        headers = {"If-Match": etag} if etag else {}
        response = self._http.request(method, path, params=told, json=json, headers=headers)
        if response.is_error:
            raise error_of(response)
        return response

    def _ask(
        self,
        method: str,
        path: str,
        kind: type[T],
        *,
        params: dict[str, Any] | None = None,
        json: Any = None,
        etag: str = "",
    ) -> T:
        return msgspec.json.decode(self._send(method, path, params=params, json=json, etag=etag).content, type=kind)

    def _document(self, path: str, params: dict[str, Any]) -> dict[str, Any]:
        return self._ask("GET", path, dict[str, Any], params=params)

    def _list(self, path: str, name: str, kind: type[T], params: dict[str, Any] | None = None) -> list[T]:
        return msgspec.convert(self._document(path, params or {})[name], list[kind])  # type: ignore[valid-type]

    def _pages(self, path: str, name: str, kind: type[T], asked: dict[str, Any]) -> list[T]:
        rows: list[T] = []
        asked = {key: value for key, value in asked.items() if value is not None}
        while True:
            page = self._document(path, asked)
            rows += msgspec.convert(page[name], list[kind])  # type: ignore[valid-type]
            if page.get("next") is None:
                return rows
            asked["cursor"] = page["next"]


def _part(name: str) -> str:
    """Return a name as one part of a path, whatever it holds."""
    return quote(name, safe="")


def _listed(near: tuple[float, float, float] | None) -> str | None:
    return None if near is None else ",".join(f"{value!r}" for value in near)
