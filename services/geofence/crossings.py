"""Who entered and left which zone: one two-state machine per track and zone, all of them advanced at once in arrays.

A track is *inside* a zone once it is deeper than ``margin`` in it, or has been in it for ``min_seconds`` on end. It is
*outside* again once it has been farther than ``margin`` away for ``min_seconds`` on end. Between the two borders
nothing changes, so noise on the edge does not flap. A track that touched a zone and is now beyond the margin on
another side has *passed*: enter and exit at once, however thin the zone and however long the step. One that touched
and went back where it came from has not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from services.geofence.zone_index import CORE, OUTSIDE, WITHIN, ZoneIndex

__all__ = ["Crossing", "Crossings"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

S = TypeVar("S", bound=np.generic)

_FIRST_CAPACITY = 64
_ELSEWHERE = -2
"""A floor nobody is on: whoever comes from there has made no step."""


@dataclass(frozen=True, slots=True)
class Crossing:
    """One track entered or left one zone at ``t``, near (x, y)."""

    kind: Literal["enter", "exit"]
    zone: int
    track: int
    t: float
    x: float
    y: float


class Crossings:
    """The state of all tracks of one area against all zones. Pure: time comes with the frames.

    Args:
        index: the zones.
        min_seconds: how long a track must stay on the other side of a border before it counts.
        grace: seconds after which a track that is no longer reported has left all zones.

    Memory grows with the number of tracks at once times the number of zones (59 bytes for each).
    """

    def __init__(self, index: ZoneIndex, min_seconds: float, grace: float) -> None:
        self._index = index
        self._zones = len(index)
        self._min_seconds = min_seconds
        self._grace = grace
        # A step shorter than this touches no zone unless one end lies within the margin (1.9: arcs are polygons).
        self._long_step = 1.9 * index.margin
        self.occupancy = np.zeros(self._zones, np.int64)
        """How many tracks are inside each zone, (zones,)."""
        self._ids = np.empty(0, np.int64)
        self._slot_of_id = np.empty(0, np.int64)
        self._free: list[int] = []
        self._capacity = 0
        # Per slot: where and when the track was last, and its row in the frame at hand (-1 outside of a step).
        self._x, self._y, self._t = (np.empty(0) for _ in range(3))
        self._floor = np.empty(0, np.int64)
        self._row_of = np.empty(0, np.int64)
        # Per pair (slot times zones plus zone): the machine. ``since``: a change is pending since then and from there;
        # ``anchor``: when and where the track was last beyond the margin; ``place``: scratch like ``row_of``.
        self._inside, self._is_active, self._touched = (np.empty(0, np.bool_) for _ in range(3))
        self._since, self._since_x, self._since_y = (np.empty(0) for _ in range(3))
        self._anchor_t, self._anchor_x, self._anchor_y = (np.empty(0) for _ in range(3))
        self._place = np.empty(0, np.int64)
        self._active = np.empty(0, np.int64)
        self._allocate(_FIRST_CAPACITY)

    @property
    def tracks(self) -> Ints:
        """Ids of the tracks that are remembered, sorted."""
        return self._ids

    def step(
        self,
        t: float,
        track: Ints,
        floor: Ints,
        x: Floats,
        y: Floats,
        former: Sequence[Sequence[int]] = (),
        held: Ints | None = None,
    ) -> list[Crossing]:
        """Advance to the frame at ``t`` and return what happened, in order of time.

        Args:
            t: seconds, later than the frame before.
            track: (n,) ids, each once.
            floor: (n,) floor numbers of the index.
            x: (n,) metres.
            y: (n,) metres.
            former: for each track the ids it had before, oldest first; a new track takes over the state of the newest
                of them that is remembered and no longer reported.
            held: (h,) ids the frame reports besides, given to ``hold``; None: no others.

        Returns:
            Crossings; for each track and zone enter and exit take turns.
        """
        present = set(track.tolist()) if held is None else {*track.tolist(), *held.tolist()}
        slot, known = self._slots(track, former, present)
        self._absorb(t, slot, former, present)
        before_x, before_y, before_t = self._x[slot], self._y[slot], self._t[slot]
        known &= self._floor[slot] == floor
        code, row, zone, depth, touched_now = self._pairs(slot, known, floor, x, y, before_x, before_y)
        px, py = x[row], y[row]

        inside = self._inside[code]
        self._begin(code, row, depth, t, x, y, known, before_x, before_y, before_t)
        # A change of floor is no step: what was touched downstairs is not passed upstairs.
        touched = (self._touched[code] | touched_now | (depth >= WITHIN)) & (self._index.floor[zone] == floor[row])
        self._touched[code] = touched

        # Where a change is pending (into the zone, or out of its margin), remember since when and from where.
        pending = np.where(inside, depth == OUTSIDE, depth >= WITHIN)
        since = self._since[code]
        begins = pending & np.isnan(since)
        since = np.where(pending, np.where(begins, t, since), np.nan)
        self._since[code] = since
        began = code[begins]
        self._since_x[began], self._since_y[began] = px[begins], py[begins]
        with np.errstate(invalid="ignore"):
            settled = pending & (t - since >= self._min_seconds)
        enters = ~inside & (settled | (depth == CORE))
        exits = inside & settled
        ends = ~inside & (depth == OUTSIDE)
        passes = np.flatnonzero(ends & touched & ~np.isnan(self._anchor_t[code]))

        happened = [self._changed("enter", int(code[i]), int(track[row[i]])) for i in np.flatnonzero(enters)]
        happened += [self._changed("exit", int(code[i]), int(track[row[i]])) for i in np.flatnonzero(exits)]
        for pair, r in zip(code[passes].tolist(), row[passes].tolist(), strict=True):
            happened.extend(self._passed(pair, int(track[r]), t, float(x[r]), float(y[r])))

        now_inside = (inside | enters) & ~exits
        self._inside[code] = now_inside
        self._since[code[enters]] = np.nan
        stays = now_inside | (depth != OUTSIDE)
        self._set_active(code, stays, slot)
        self._x[slot], self._y[slot], self._t[slot], self._floor[slot] = x, y, t, floor
        happened.extend(self._vanish(t, self._grace))
        happened.sort(key=lambda crossing: (crossing.t, crossing.kind))
        return happened

    def hold(self, t: float, track: Ints, former: Sequence[Sequence[int]], others: Ints) -> None:
        """Leave tracks whose place is not known well enough where they were; call before the ``step`` of their frame.

        They neither cross a border nor vanish; of one never seen before nothing is remembered. When its place is known
        again, nothing between then and now counts as a step.

        Args:
            t: of the frame.
            track: (n,) ids.
            former: for each track the ids it had before, oldest first.
            others: (o,) ids the frame reports besides: whoever is still there leaves nobody anything.
        """
        present = {*track.tolist(), *others.tolist()}
        slots = dict(zip(self._ids.tolist(), self._slot_of_id.tolist(), strict=True))
        for row, number in enumerate(track.tolist()):
            if number not in slots:
                heir = next((one for one in reversed(former[row]) if one in slots and one not in present), None)
                if heir is None:
                    continue
                slots[number] = slots.pop(heir)
            self._t[slots[number]] = t
            self._floor[slots[number]] = _ELSEWHERE
        self._index_ids(slots)

    def close(self, t: float) -> list[Crossing]:
        """Let every track leave every zone at ``t``: no more frames will come."""
        return self._vanish(t, -np.inf)

    def _pairs(
        self, slot: Ints, known: Bools, floor: Ints, x: Floats, y: Floats, before_x: Floats, before_y: Floats
    ) -> tuple[Ints, Ints, Ints, NDArray[np.int8], Bools]:
        """Return every pair of a track and a zone that may change or matter now, each once.

        Returns:
            code: (m,) slot times zones plus zone.
            row: (m,) place of the track in the frame.
            zone: (m,).
            depth: (m,) of the track in the zone.
            touched: (m,) whether the step from the frame before touched the zone.
        """
        row, zone, depth = self._index.nearby(x, y, floor)
        code = slot[row] * self._zones + zone
        place = self._place
        place[code] = np.arange(len(code))
        # What was near before and is not now: beyond the margin, by construction of the index.
        row_of = self._row_of
        row_of[slot] = np.arange(len(slot))
        left = self._active[(row_of[self._active // self._zones] >= 0) & (place[self._active] < 0)]
        place[left] = len(code) + np.arange(len(left))
        codes, rows = [code, left], [row, row_of[left // self._zones]]
        step = np.hypot(x - before_x, y - before_y)
        fast = known & (step > self._long_step)
        cut = np.empty(0, np.int64)
        if fast.any():
            movers = np.flatnonzero(fast)
            segments = _segments(before_x[movers], before_y[movers], x[movers], y[movers])
            which, cut_zone = self._index.cut(segments, floor[movers])
            cut = slot[movers[which]] * self._zones + cut_zone
            new = place[cut] < 0
            place[cut[new]] = len(code) + len(left) + np.arange(int(new.sum()))
            codes.append(cut[new])
            rows.append(movers[which[new]])
        code, row = np.concatenate(codes), np.concatenate(rows)
        depth = np.concatenate([depth, np.zeros(len(code) - len(depth), np.int8)])
        zone = code % self._zones
        touched = np.zeros(len(code), np.bool_)
        touched[place[cut]] = True
        place[code] = -1
        row_of[slot] = -1
        # Slow steps can only touch from within the margin; what lies inside has touched anyway.
        slow = np.flatnonzero(
            (depth < WITHIN) & known[row] & ~fast[row] & ~self._inside[code] & (step[row] > 0.0)
            & ~(self._touched[code] & self._is_active[code]) & (self._index.floor[zone] == floor[row])
        )  # fmt: skip
        r = row[slow]
        if len(slow):
            touched[slow] = self._index.touches(zone[slow], _segments(before_x[r], before_y[r], x[r], y[r]))
        return code, row, zone, depth, touched

    def _begin(
        self,
        code: Ints,
        row: Ints,
        depth: NDArray[np.int8],
        t: float,
        x: Floats,
        y: Floats,
        known: Bools,
        before_x: Floats,
        before_y: Floats,
        before_t: Floats,
    ) -> None:
        """Start the machines of pairs that did not matter so far: the frame before was well away from the zone."""
        begins = ~self._is_active[code]
        fresh, row, outside = code[begins], row[begins], depth[begins] < WITHIN
        self._since[fresh] = np.nan
        self._touched[fresh] = False
        # A track born beside a zone starts there; one born inside it has not come through anything.
        known = known[row]
        self._anchor_t[fresh] = np.where(known, before_t[row], np.where(outside, t, np.nan))
        self._anchor_x[fresh] = np.where(known, before_x[row], x[row])
        self._anchor_y[fresh] = np.where(known, before_y[row], y[row])

    def _changed(self, kind: Literal["enter", "exit"], pair: int, track: int) -> Crossing:
        """Count and return a change that has been pending since a time and place remembered."""
        zone = pair % self._zones
        self.occupancy[zone] += 1 if kind == "enter" else -1
        return Crossing(
            kind, zone, track, float(self._since[pair]), float(self._since_x[pair]), float(self._since_y[pair])
        )

    def _passed(self, pair: int, track: int, t: float, x: float, y: float) -> list[Crossing]:
        """Return enter and exit if the way from where the zone was last well away to here leads through it."""
        zone = pair % self._zones
        start_x, start_y, start_t = (float(a[pair]) for a in (self._anchor_x, self._anchor_y, self._anchor_t))
        shares = self._index.chord(zone, np.array([[start_x, start_y], [x, y]]))
        if shares is None:
            return []
        turns: list[tuple[Literal["enter", "exit"], float]] = [("enter", shares[0]), ("exit", shares[1])]
        return [
            Crossing(
                kind,
                zone,
                track,
                start_t + share * (t - start_t),
                start_x + share * (x - start_x),
                start_y + share * (y - start_y),
            )
            for kind, share in turns
        ]

    def _passed_at_last(self, slot: int, track: int) -> list[Crossing]:
        """Return the crossings of a track that went through a zone and ended just behind it, within the margin."""
        happened = []
        x, y, t = float(self._x[slot]), float(self._y[slot]), float(self._t[slot])
        first = slot * self._zones
        span = slice(first, first + self._zones)
        for zone in np.flatnonzero(self._is_active[span] & self._touched[span] & ~self._inside[span]).tolist():
            anchored = not np.isnan(self._anchor_t[first + zone])
            if anchored and self._index.depth(np.array([zone]), np.array([x]), np.array([y]))[0] < WITHIN:
                happened.extend(self._passed(first + zone, track, t, x, y))
        return happened

    def _vanish(self, t: float, grace: float) -> list[Crossing]:
        """Forget the tracks not seen for ``grace`` seconds; where they were inside, they leave at ``t``."""
        gone = np.flatnonzero(t - self._t[self._slot_of_id] > grace)
        happened = []
        for place in gone.tolist():
            slot, track = int(self._slot_of_id[place]), int(self._ids[place])
            span = slice(slot * self._zones, (slot + 1) * self._zones)
            for zone in np.flatnonzero(self._inside[span]).tolist():
                self.occupancy[zone] -= 1
                happened.append(Crossing("exit", zone, track, t, float(self._x[slot]), float(self._y[slot])))
            happened.extend(self._passed_at_last(slot, track))
            self._inside[span] = False
            self._is_active[span] = False
            self._free.append(slot)
        if len(gone):
            self._ids = np.delete(self._ids, gone)
            self._slot_of_id = np.delete(self._slot_of_id, gone)
            self._active = self._active[self._is_active[self._active]]
        return happened

    def _set_active(self, code: Ints, stays: Bools, slot: Ints) -> None:
        """Keep the pairs that matter next time: those named by ``stays``, and those of tracks not in this frame."""
        self._row_of[slot] = 0
        absent = self._active[self._row_of[self._active // self._zones] < 0]
        self._row_of[slot] = -1
        self._is_active[code] = stays
        self._active = np.concatenate([absent, code[stays]])

    def _slots(self, track: Ints, former: Sequence[Sequence[int]], present: set[int]) -> tuple[Ints, Bools]:
        """Return the slot of each track (n,), made where it has none, and whether its place before is known (n,)."""
        at = np.searchsorted(self._ids, track)
        known = np.zeros(len(track), np.bool_)
        within = at < len(self._ids)
        known[within] = self._ids[at[within]] == track[within]
        if not known.all():
            self._admit(track, np.flatnonzero(~known), former, present)
            at = np.searchsorted(self._ids, track)
        slot = self._slot_of_id[at]
        return slot, np.isfinite(self._t[slot])

    def _absorb(self, t: float, slot: Ints, former: Sequence[Sequence[int]], present: set[int]) -> None:
        """Somebody told under two numbers for a while is one: inside with the new one, the old one leaves unsaid."""
        named = {one for earlier in former for one in earlier}
        stale = (named & set(self._ids.tolist())).difference(present) if named else set()
        if not stale:
            return
        slots = dict(zip(self._ids.tolist(), self._slot_of_id.tolist(), strict=True))
        zones = np.arange(self._zones)
        for new, earlier in zip(slot.tolist(), former, strict=True):
            for old in [slots[one] for one in earlier if one in stale and self._t[slots[one]] < t]:
                both = zones[self._inside[old * self._zones + zones] & self._inside[new * self._zones + zones]]
                self.occupancy[both] -= 1
                self._inside[old * self._zones + both] = False

    def _admit(self, track: Ints, new: Ints, former: Sequence[Sequence[int]], present: set[int]) -> None:
        slots = dict(zip(self._ids.tolist(), self._slot_of_id.tolist(), strict=True))
        for row in new.tolist():
            earlier = former[row] if row < len(former) else ()
            heir = next((one for one in reversed(earlier) if one in slots and one not in present), None)
            if heir is not None:
                slots[int(track[row])] = slots.pop(heir)
                continue
            if not self._free:
                self._allocate(self._capacity)
            slot = self._free.pop()
            self._t[slot] = np.nan
            slots[int(track[row])] = slot
        self._index_ids(slots)

    def _index_ids(self, slots: dict[int, int]) -> None:
        ids = np.fromiter(slots.keys(), np.int64, len(slots))
        order = np.argsort(ids)
        self._ids = ids[order]
        self._slot_of_id = np.fromiter(slots.values(), np.int64, len(slots))[order]

    def _allocate(self, more: int) -> None:
        """Make room for ``more`` tracks."""
        old, new, zones = self._capacity, self._capacity + more, self._zones
        self._x, self._y, self._t = (_grown(a, old, new, np.nan) for a in (self._x, self._y, self._t))
        self._floor = _grown(self._floor, old, new, -1)
        self._row_of = _grown(self._row_of, old, new, -1)
        pairs = new * zones
        self._since, self._since_x, self._since_y, self._anchor_t, self._anchor_x, self._anchor_y = (
            _grown(a, old * zones, pairs, np.nan)
            for a in (self._since, self._since_x, self._since_y, self._anchor_t, self._anchor_x, self._anchor_y)
        )
        self._inside, self._is_active, self._touched = (
            _grown(a, old * zones, pairs, False) for a in (self._inside, self._is_active, self._touched)
        )
        self._place = _grown(self._place, old * zones, pairs, -1)
        self._capacity = new
        self._free.extend(range(new - 1, old - 1, -1))


def _grown(array: NDArray[S], used: int, size: int, fill: float) -> NDArray[S]:
    larger = np.full(size, fill, array.dtype)
    larger[:used] = array[:used]
    return larger


def _segments(x0: Floats, y0: Floats, x1: Floats, y1: Floats) -> Floats:
    """Return (n, 2, 2) segments."""
    return np.stack([np.stack([x0, y0], axis=1), np.stack([x1, y1], axis=1)], axis=1)
