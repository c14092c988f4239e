"""Who entered or left which area and crossed which line: all tracks of one area of the site against all borders.

Each frame: which borders are near (``zone_index``), which pairs of track and border matter, and how areas
(``area_crossings``) and lines (``line_crossings``) take it. Only pairs near a border, or inside, are remembered.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any, Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from services.geofence.area_crossings import advance_areas
from services.geofence.borders import Borders
from services.geofence.carried_over import carried_over
from services.geofence.line_crossings import advance_lines
from services.geofence.pairs import PAIR, Crossing, Frame, Pairs, ranges_of
from services.geofence.slots import Slots
from services.geofence.ways import ways_of

__all__ = ["RETURN", "Crossing", "Crossings"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

_PASS_SURE, _PASS_NARROW = 2.5, 0.7
"""Standard deviations by which the way through an area may be aside and still lead through; of areas narrower than
these are long the lesser: who walks through a wide one deep inside is told by evidence."""
_BESIDE = 1.0
"""Standard deviations beside a line, were it without ends, from which on somebody is taken to come from that side."""
RETURN = 10.0
"""Seconds after a place is seen again in which whoever was there may be found, by their phone."""
_LIKELY = 0.5
"""Of the evidence needed, with which somebody is taken to have crossed who is seen no more."""


class Crossings:
    """The state of all tracks of one area of the site against all borders. Pure: time comes with the frames.

    Args:
        borders: see there.
        grace: seconds after which a track that is no longer reported has left all areas.

    Memory grows with the number of tracks at once, and with the borders near them.
    """

    def __init__(self, borders: Borders, grace: float) -> None:
        self._borders = borders
        self._grace = grace
        self._slots = Slots()
        self._pairs = np.empty(0, PAIR)
        self.occupancy = np.zeros(len(borders.index), np.int64)
        """How many tracks are inside each area, (borders,)."""
        self.hidden: Callable[[Floats, Floats], Bools] | None = None
        """Which of (n,) places, x and y in metres, nobody can see now; None: all are seen."""
        self.lost: dict[int, float] = {}
        """Tracks that vanished where nobody could see, and when it last was so."""

    @property
    def tracks(self) -> Ints:
        """Ids of the tracks that are remembered, sorted."""
        return self._slots.ids

    @property
    def places(self) -> NDArray[Any]:
        """(k,) of ``slots.PLACE``: when and where those who are remembered were last, and who they are."""
        return self._slots.place[self._slots.slot_of_id]

    def place_of(self, who: int) -> Any | None:
        """Return when and where one person was last; None where nobody knows."""
        places = self.places
        mine = np.flatnonzero(places["who"] == who)
        return places[mine[0]] if len(mine) else None

    def people(self, track: Ints) -> Ints:
        """Return who each of these tracks is, (n,); 0 where it is not remembered."""
        ids, slots = self._slots.ids, self._slots.slot_of_id
        at = np.minimum(np.searchsorted(ids, track), max(len(ids) - 1, 0))
        if not len(ids):
            return np.zeros(len(track), np.int64)
        found: Ints = np.where(ids[at] == track, self._slots.place["who"][slots[at]], 0)
        return found

    def note_lost(self, t: float) -> None:
        """Note who vanished where nobody can see; call before the ``step`` of the frame at ``t``."""
        place = self.places
        gone = np.flatnonzero(t - place["t"] > self._grace)
        if self.hidden is not None and len(gone):
            hidden = gone[self.hidden(place["x"][gone], place["y"][gone])]
            self.lost |= dict.fromkeys(self.tracks[hidden].tolist(), t)

    def step(
        self,
        t: float,
        track: Ints,
        floor: Ints,
        x: Floats,
        y: Floats,
        former: Sequence[Sequence[int]] = (),
        held: Ints | None = None,
        covariance: Floats | None = None,
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
            covariance: (n, 3) xx, xy, yy in m²; None: places are exact.

        Returns:
            Crossings; for each person and area enter and exit take turns.
        """
        others = np.empty(0, np.int64) if held is None else held
        slot, known = self._slots.take(track, former, others)
        happened = self._absorb(t, track, slot, former, others) if any(former) else []
        place = self._slots.place
        before = place.take(slot)
        frame = Frame(
            t, slot, track, before["who"], floor, x, y,
            np.zeros((len(x), 3)) if covariance is None else covariance,
            before["t"], before["x"], before["y"], known & (before["floor"] == floor),
        )  # fmt: skip
        code, pairs = self._borders.matter(frame, self._pairs["code"], len(self._slots.place))
        state, new = self._state_of(code)
        stays = np.zeros(len(code), np.bool_)
        is_line = self._borders.index.is_line[pairs.border]
        happened += self._areas(np.flatnonzero(~is_line), state, new, pairs, frame, stays)
        happened += self._lines(np.flatnonzero(is_line), state, new, pairs, frame, stays)
        self._remember(slot, state.compress(stays))
        place["t"][slot], place["x"][slot], place["y"][slot], place["floor"][slot] = t, x, y, floor
        place["spread"][slot] = frame.spread
        happened += self._vanish(t, self._grace)
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
        if len(track):
            self._slots.hold(t, track, former, others)

    def close(self, t: float) -> list[Crossing]:
        """Let every track leave every area at ``t``: no more frames will come."""
        return self._vanish(t, -np.inf)

    def moved(
        self, borders: Borders, becomes: Mapping[int, int], unchanged: Collection[int], t: float
    ) -> tuple[Crossings, list[Crossing]]:
        """Return the same people before other borders: whom a border that changed may still hold stays inside of it.

        Args:
            borders: the new ones.
            becomes: which old border is which new one, where it is the same area or line.
            unchanged: the old ones that keep their shape.
            t: now; who was inside of a shape that no longer holds them has left by then.

        Returns:
            The new state, and the exits. Who is inside of an area that is new, or grew, is inside without a word.
        """
        old, new, slots = self._borders.index, borders.index, self._slots
        slot, place = slots.slot_of_id, slots.place
        floor = new.floors_of([old.floor_names.get(number, "") for number in place["floor"][slot].tolist()])
        tracks = slot, place["x"][slot], place["y"][slot], floor
        other = Crossings(borders, self._grace)
        other._slots = slots
        other.hidden, other.lost = self.hidden, self.lost
        other._pairs, left = carried_over(self._pairs, old, new, becomes, unchanged, tracks)
        other._count_inside()
        happened = []
        track_of = {one: number for number, one in slots.by_id().items()}
        for code in left.tolist():
            one, border = divmod(code, len(old))
            t0, x, y, _, who, _ = place[one].tolist()
            happened.append(Crossing("exit", border, track_of[one], who, max(t, t0), x, y))
        elsewhere = place["floor"][slot] < 0
        place["floor"][slot] = np.where(elsewhere, place["floor"][slot], floor)
        return other, happened

    def inside(self) -> list[tuple[int, int, int, float, float]]:
        """Return border, track, person, x and y of everybody inside of an area."""
        track_of = {slot: number for number, slot in self._slots.by_id().items()}
        told = []
        for code in self._pairs["code"][(self._pairs["side"] > 0) & ~self._is_line(self._pairs["code"])].tolist():
            slot, border = divmod(code, len(self._borders.index))
            place = self._slots.place[slot]
            told.append((border, track_of[slot], int(place["who"]), float(place["x"]), float(place["y"])))
        return told

    def state(self) -> dict[str, Any]:
        """Return what ``restore`` takes, in plain values."""
        return {"slots": self._slots.state(), "pairs": self._pairs.tolist()}

    def restore(self, state: dict[str, Any]) -> None:
        """Be as another before the same borders was when its ``state`` was taken.

        Raises:
            ValueError, TypeError, KeyError: it is no such state.
        """
        slots = Slots()
        slots.restore(state["slots"])
        pairs = np.array([tuple(pair) for pair in state["pairs"]], PAIR)
        codes, count = pairs["code"], len(self._borders.index)
        if len(codes) and (
            not count or not np.isin(codes // count, slots.slot_of_id).all() or (np.diff(codes) <= 0).any()
        ):
            raise ValueError("pairs of tracks and zones that are not there")
        self._slots, self._pairs = slots, pairs
        self._count_inside()

    def _count_inside(self) -> None:
        codes, count = self._pairs["code"], len(self._borders.index)
        self.occupancy = np.zeros(count, np.int64)
        if count:
            np.add.at(self.occupancy, codes[(self._pairs["side"] > 0) & ~self._is_line(codes)] % count, 1)

    def _is_line(self, codes: Ints) -> Bools:
        return self._borders.index.is_line[codes % max(len(self._borders.index), 1)]

    def _state_of(self, code: Ints) -> tuple[NDArray[Any], Bools]:
        """Return a copy of what is remembered of pairs (m,), and which of them are new: these hold their code only."""
        if not len(self._pairs):
            state, new = np.zeros(len(code), PAIR), np.ones(len(code), np.bool_)
        else:
            codes = np.ascontiguousarray(self._pairs["code"])
            at = np.minimum(np.searchsorted(codes, code), len(codes) - 1)
            new = codes[at] != code
            state = self._pairs.take(at)
            fresh = np.flatnonzero(new)
            state.put(fresh, np.zeros(len(fresh), PAIR))
        state["code"] = code
        return state, new

    def _areas(
        self, some: Ints, state: NDArray[Any], new: Bools, pairs: Pairs, frame: Frame, stays: Bools
    ) -> list[Crossing]:
        mine, of = state.take(some), pairs.pick(some)
        step = advance_areas(mine, new[some], of, frame, self._borders.min_seconds)
        turned = mine[["t", "x", "y"]]
        happened = []
        for kind, places in (("enter", step.enters), ("exit", step.exits)):
            change = 1 if kind == "enter" else -1
            np.add.at(self.occupancy, of.border[places], change)
            for place in places.tolist():
                row = int(of.row[place])
                t, x, y = (float(value) for value in turned[place])
                one = Crossing(kind, int(of.border[place]), int(frame.track[row]), int(frame.who[row]), t, x, y)  # type: ignore[arg-type]
                happened.append(one)
        spread = frame.spread
        for place in step.passes.tolist():
            row = int(of.row[place])
            person = int(frame.track[row]), int(frame.who[row])
            here = frame.t, float(frame.x[row]), float(frame.y[row])
            happened += self._passed(int(of.border[place]), mine[place], person, here, float(spread[row]))
        state.put(some, mine)
        stays[some] = step.stays
        return happened

    def _lines(
        self, some: Ints, state: NDArray[Any], new: Bools, pairs: Pairs, frame: Frame, stays: Bools
    ) -> list[Crossing]:
        if not len(some):
            return []
        mine, of = state.take(some), pairs.pick(some)
        before = np.full(len(some), np.nan)
        fresh = np.flatnonzero(new[some] & frame.known[of.row])
        rows = of.row[fresh]
        # Whoever comes from beyond an end of the line was on neither side of it.
        left = self._borders.index.beside(of.border[fresh], frame.before_x[rows], frame.before_y[rows])
        before[fresh] = np.where(np.abs(left) >= _BESIDE * frame.spread[rows], left, np.nan)
        forward, backward, doubtful, stay = advance_lines(mine, new[some], of, frame, self._borders.min_seconds, before)
        # On another floor a line is nowhere.
        stays[some] = stay & np.isfinite(of.depth)
        through = [place for place in doubtful.tolist() if self._went_through(mine[place], of, place, frame)]
        told = [
            one for one in (*forward.tolist(), *backward.tolist()) if not self._went_round(mine[one], of, one, frame)
        ]
        # Whoever crossed was last surely on this side here.
        crossed = np.concatenate([forward, backward, doubtful])
        rows = of.row[crossed]
        for name, value in (("anchor_t", frame.t), ("anchor_x", frame.x[rows]), ("anchor_y", frame.y[rows])):
            mine[name][crossed] = value
        state.put(some, mine)
        happened = []
        for place in [*told, *through]:
            row = int(of.row[place])
            t, x, y = (float(mine[name][place]) for name in ("t", "x", "y"))
            # Those who crossed are on the other side by now: on the right after a crossing forward.
            direction: Literal["forward", "backward"] = "forward" if mine["side"][place] < 0 else "backward"
            person = int(frame.track[row]), int(frame.who[row])
            happened.append(Crossing("cross", int(of.border[place]), *person, t, x, y, direction))
        return happened

    def _went_round(self, pair: Any, pairs: Pairs, place: int, frame: Frame) -> bool:
        """Whether the steps cut the line by their errors only: the way past the positions near it does not."""
        row, border = int(pairs.row[place]), int(pairs.border[place])
        ways = ways_of(pair, np.array([frame.x[row], frame.y[row]]), float(frame.spread[row]), 0.0)
        if ways.shape[1] < 3:
            return False
        net, _, _ = self._borders.index.crossed(np.full(2, border), np.stack([ways[0, :-1], ways[0, 1:]], axis=1))
        return int(net.sum()) != -int(pair["side"])

    def _went_through(self, pair: Any, pairs: Pairs, place: int, frame: Frame) -> bool:
        """Whether the way to here cuts the line, also where it is shifted to either side; says where."""
        row, border = int(pairs.row[place]), int(pairs.border[place])
        ways = ways_of(pair, np.array([frame.x[row], frame.y[row]]), float(frame.spread[row]), 1.0)
        legs = np.stack([ways[:, :-1], ways[:, 1:]], axis=2).reshape(-1, 2, 2)
        net, cut, share = self._borders.index.crossed(np.full(len(legs), border), legs)
        count = ways.shape[1] - 1
        if not (net.reshape(-1, count).sum(axis=1) == -int(pair["side"])).all():
            return False
        leg = int(np.flatnonzero(cut[:count])[-1])
        length = np.hypot(*(legs[:count, 1] - legs[:count, 0]).T)
        gone = (float(length[:leg].sum()) + float(share[leg]) * float(length[leg])) / float(length.sum())
        pair["t"] = pair["anchor_t"] + gone * (frame.t - pair["anchor_t"])
        pair["x"], pair["y"] = (legs[leg, 0] + float(share[leg]) * (legs[leg, 1] - legs[leg, 0])).tolist()
        return True

    def _passed(
        self, border: int, pair: Any, person: tuple[int, int], here: tuple[float, float, float], spread: float
    ) -> list[Crossing]:
        """Return enter and exit if the way from where the track was last surely outside to here leads through."""
        t, x, y = here
        t0 = float(pair["anchor_t"])
        narrow = self._borders.index.half_width[border] <= spread
        ways = ways_of(pair, np.array([x, y]), spread, _PASS_NARROW if narrow else _PASS_SURE)
        shares = self._borders.index.chord(border, ways)
        if shares is None:
            return []
        track, who = person
        course = shapely.LineString(ways[0])
        told = []
        for kind, share in zip(("enter", "exit"), shares, strict=True):
            at = course.interpolate(share, normalized=True)
            told.append(Crossing(kind, border, track, who, t0 + share * (t - t0), float(at.x), float(at.y)))  # type: ignore[arg-type]
        return told

    def _remember(self, slot: Ints, state: NDArray[Any]) -> None:
        """Keep the pairs that matter next time, and those of tracks not in this frame."""
        absent = np.ones(len(self._slots.place), np.bool_)
        absent[slot] = False
        count = max(len(self._borders.index), 1)
        others = self._pairs.compress(absent[self._pairs["code"] // count]) if len(self._pairs) else self._pairs
        if len(others):
            state = np.concatenate([others, state])
            state = state.take(np.argsort(state["code"], kind="stable"))
        self._pairs = state

    def _absorb(
        self, t: float, track: Ints, slot: Ints, former: Sequence[Sequence[int]], others: Ints
    ) -> list[Crossing]:
        """Somebody told under two numbers for a while is one: inside with the new one, the old one leaves unsaid."""
        stale = self._slots.stale(former, {*track.tolist(), *others.tolist()})
        if not stale:
            return []
        slots, place, happened = self._slots.by_id(), self._slots.place, []
        for new, earlier in zip(slot.tolist(), former, strict=True):
            for number in [one for one in earlier if one in stale and place["t"][slots[one]] < t]:
                old = slots[number]
                mine = {code % len(self._borders.index) for code in self._inside_of(new)}
                for code in self._inside_of(old):
                    border = code % len(self._borders.index)
                    if border not in mine:
                        continue
                    self.occupancy[border] -= 1
                    self._pairs["side"][np.searchsorted(self._pairs["code"], code)] = -1
                    whose = int(place["who"][old])
                    x, y, heir = float(place["x"][old]), float(place["y"][old]), int(place["who"][new])
                    one = Crossing("absorbed", border, number, whose, t, x, y, heir=heir)
                    happened.append(one)
        return happened

    def _inside_of(self, slot: int) -> list[int]:
        """Return the codes of the pairs of a slot that is inside of the area."""
        first, last = ranges_of(self._pairs["code"], np.array([slot]), len(self._borders.index))
        pairs = self._pairs[int(first[0]) : int(last[0])]
        inside: list[int] = pairs["code"][(pairs["side"] > 0) & ~self._is_line(pairs["code"])].tolist()
        return inside

    def _vanish(self, t: float, grace: float) -> list[Crossing]:
        """Forget the tracks not seen for ``grace`` seconds; where they were inside, they leave at ``t``."""
        slots = self._slots
        gone = np.flatnonzero(t - slots.place["t"][slots.slot_of_id] > grace)
        gone, quiet = self._let_go(t, gone) if np.isfinite(grace) else (gone, set())
        if not len(gone):
            return []
        slot = slots.slot_of_id[gone]
        first, last = ranges_of(self._pairs["code"], slot, len(self._borders.index))
        happened = []
        for begin, end, number, place in zip(
            first.tolist(), last.tolist(), slots.ids[gone].tolist(), slots.place[slot], strict=True
        ):
            for pair in self._pairs[begin:end]:
                happened += self._ended(pair, int(number), place, t, int(number) in quiet)
        dropped = np.isin(self._pairs["code"] // max(len(self._borders.index), 1), slot)
        self._pairs = self._pairs[~dropped]
        slots.drop(gone)
        return happened

    def _let_go(self, t: float, gone: Ints) -> tuple[Ints, set[int]]:
        """Return which of those not seen for long are given up, and the tracks of them of which nothing is said."""
        if not self.lost or not len(gone):
            self.lost.clear()
            return gone, set()
        tracks = self._slots.ids[gone]
        waits = np.array([t - self.lost.get(track, -np.inf) <= RETURN for track in tracks.tolist()], np.bool_)
        quiet = self.lost.keys() & set(tracks[~waits].tolist())
        self.lost = {track: self.lost[track] for track in tracks[waits].tolist()}
        return gone[~waits], quiet

    def _ended(self, pair: Any, track: int, place: Any, t: float, quiet: bool) -> list[Crossing]:
        """Return what becomes of a pair whose track is seen no more; ``quiet``: nobody could see what it was."""
        border = int(pair["code"]) % len(self._borders.index)
        who, seen, x, y = int(place["who"]), float(place["t"]), float(place["x"]), float(place["y"])
        if not self._borders.index.is_line[border]:
            if pair["side"] > 0:
                self.occupancy[border] -= 1
                return [Crossing("lost" if quiet else "exit", border, track, who, t, x, y)]
            if quiet:
                return []
            # Through an area and lost just behind it.
            behind = pair["touched"] and np.isfinite(pair["anchor_x"]) and self._depth(border, x, y) < 0.0
            outside = behind and (
                pair["away"] >= _LIKELY or -self._depth(border, x, y) <= self._borders.margins[border]
            )
            return self._passed(border, pair, (track, who), (seen, x, y), float(place["spread"])) if outside else []
        if quiet or pair["evidence"] < _LIKELY or int(pair["net"]) * int(pair["side"]) <= 0:
            return []
        direction: Literal["forward", "backward"] = "forward" if pair["side"] > 0 else "backward"
        where = float(pair["t"]), float(pair["x"]), float(pair["y"])
        return [Crossing("cross", border, track, who, *where, direction)]

    def _depth(self, border: int, x: float, y: float) -> float:
        return float(self._borders.index.depth(np.array([border]), np.array([x]), np.array([y]))[0])
