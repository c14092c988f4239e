"""What does the client of a stream want to be told? The same filters as those of the reads, on events."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

from services.api.event_log import Entry, Framing
from services.api.event_views import of_device, of_place, of_zone, without_names
from services.api.place_filter import Place
from services.api.zones_drawn import ZonesDrawn

__all__ = ["Selection"]

ANYWHERE = Place()
PEOPLE = frozenset({"tracks", "revision"})


@dataclass(frozen=True, slots=True)
class Selection:
    """What a client wants to be told: these events; of one area, device or place, where those are asked for.

    Attributes:
        events: their names.
        area: only what is of this area; occupancy is of none.
        device: only rows of people, revisions and alerts of this device.
        place: only people, revised points and alerts there; of a zone also its alerts, acknowledgements and count.
        confidence: only people tracked with at least this quality.
        zones: returns those that hold now.
        floors: of areas.
        nameless: whether alerts are told without the names of phones.
    """

    events: frozenset[str]
    area: str | None = None
    device: str | None = None
    place: Place = ANYWHERE
    confidence: float = 0.0
    zones: Callable[[], ZonesDrawn] = lambda: ZonesDrawn([])
    floors: dict[str, str] = field(default_factory=dict)
    nameless: bool = False

    @property
    def of_cameras(self) -> bool:
        """Whether how cameras are doing is part of it."""
        return "camera" in self.events and self.device is None and self.place.anywhere

    def framed(self, entry: Entry, framing: Framing) -> bytes | None:
        """Return what is wanted of an event, as it travels; None: nothing."""
        payload = entry.payload
        if entry.event not in self.events or payload is None or (self.area is not None and entry.area != self.area):
            return None
        part: bytes | None = payload
        if self.device is not None:
            part = of_device(entry.event, payload, self.device)
        if part is not None:
            part = self._there(entry, part)
        if part is None:
            return None
        if self.nameless and entry.event == "alert":
            part = without_names(part)
        return entry.framed(framing) if part is payload else framing(entry.id, entry.event, part)

    def _there(self, entry: Entry, payload: bytes) -> bytes | None:
        zone, place = self.place.zone, self.place
        if zone is not None and entry.event not in PEOPLE:
            part = of_zone(entry.event, payload, entry.zone, zone)
            place = replace(place, zone=None)
            if part is None or place.anywhere:
                return part
            payload = part
        if place.anywhere and (self.confidence == 0.0 or entry.event != "tracks"):
            return payload
        zones = self.zones()
        return of_place(entry.event, payload, lambda *points: place.holds(zones, *points), self.floors, self.confidence)
