"""Who is in an area of the site, and who is the same person in two areas.

A person is the area that tracks them and the number ``Crossings`` gave the first of their tracks.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from services.geofence.crossings import Crossings

__all__ = ["AreaPeople", "Person", "Sighting", "twin_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

Person = tuple[str, int]
"""Area, and who in it."""

_SAME_PLACE = 0.75
"""Metres between two areas' positions of one person."""
_WALKING = 1.5
"""m/s by which this grows while one of them is out of sight for longer than …"""
_AT_ONCE = 0.5
"""… so many seconds."""


@dataclass(frozen=True, slots=True)
class Sighting:
    """One frame: (n,) tracks of one area at ``t``, each once; metres, m/s, m²."""

    t: float
    track: Ints
    floor: Ints
    """Numbers of the index of zones."""
    x: Floats
    y: Floats
    velocity: Floats
    """(n, 2)."""
    covariance: Floats
    """(n, 3): xx, xy, yy."""
    seen: Bools
    """By a camera, not followed by a device alone."""
    device: Sequence[str | None]
    former: Sequence[Sequence[int]]


@dataclass
class AreaPeople:
    """The people of one area, and what the newest frame says of them.

    Attributes:
        crossings: the state machines.
        t: of the newest frame.
        devices: what each carries, by who; of those who vanished, what they carried last.
        unseen: whom no camera sees.
        absent: whom nobody can see: the cameras are away that saw them.
        newest: the frame; ``who``: who each of its rows is.
    """

    crossings: Crossings
    t: float = -np.inf
    devices: dict[int, str] = field(default_factory=dict)
    unseen: set[int] = field(default_factory=set)
    absent: set[int] = field(default_factory=set)
    newest: Sighting | None = None
    who: Ints = field(default_factory=lambda: np.empty(0, np.int64))

    def take(self, sighting: Sighting) -> list[int]:
        """Take in a frame after ``crossings`` did, and return whose device is another now, and is known."""
        before, self.newest, self.t = self.newest, sighting, sighting.t
        who = self.crossings.people(sighting.track)
        same = len(who) == len(self.who) and np.array_equal(who, self.who)
        self.who = who
        self.unseen = set(who[~sighting.seen].tolist())
        if same and before is not None and before.device == sighting.device:
            return []
        changed = []
        for one, device in zip(who.tolist(), sighting.device, strict=True):
            if device is None:
                self.devices.pop(one, None)  # its phone turned out to be somebody else's
            elif one and self.devices.get(one) != device:
                self.devices[one] = device
                changed.append(one)
        if len(self.devices) > 2 * len(self.crossings.tracks) + 64:
            kept = set(self.crossings.people(self.crossings.tracks).tolist())
            self.devices = {one: device for one, device in self.devices.items() if one in kept}
        return changed

    def lost_devices(self) -> dict[str, int]:
        """Return the tracks that vanished where nobody could see, by the device each carried."""
        tracks = np.array(list(self.crossings.lost), np.int64)
        carried = zip(tracks.tolist(), self.crossings.people(tracks).tolist(), strict=True)
        return {self.devices[who]: track for track, who in carried if who in self.devices}

    def rows_of(self, who: Ints) -> Ints:
        """Return the rows of these people (n,) in the newest frame; -1 where it does not report them."""
        if not len(self.who):
            return np.full(len(who), -1)
        order = np.argsort(self.who)
        at = order[np.minimum(np.searchsorted(self.who, who, sorter=order), len(order) - 1)]
        found: Ints = np.where(self.who[at] == who, at, -1)
        return found


def twin_of(person: Person, areas: Mapping[str, AreaPeople], grace: float) -> Person | None:
    """Return who in another area is the same person: by the device, or alone in the same place at the same time.

    Args:
        person: somebody seen now.
        areas: all areas, this one too.
        grace: seconds for which somebody out of sight is still looked for.
    """
    if len(areas) < 2:
        return None
    area, who = person
    mine = areas[area].crossings.place_of(who)
    device = areas[area].devices.get(who)
    near: list[Person] = []
    for name, people in areas.items():
        if name == area:
            continue
        places = people.crossings.places
        if device is not None:
            same = [one for one, theirs in people.devices.items() if theirs == device and one in places["who"]]
            if same:
                return name, same[0]
        if mine is None:
            continue
        apart = np.abs(places["t"] - mine["t"])
        within = _SAME_PLACE + _WALKING * np.maximum(apart - _AT_ONCE, 0.0)
        distance = np.hypot(places["x"] - mine["x"], places["y"] - mine["y"])
        close = (apart <= grace) & (distance <= within) & (places["floor"] == mine["floor"])
        near += [
            (name, one) for one in places["who"][close].tolist() if device is None or people.devices.get(one) is None
        ]
    return near[0] if len(near) == 1 else None
