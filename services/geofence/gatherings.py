"""Those inside of zones as they are now: too many, too fast, too near each other. Each told once per episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from services.geofence.conditions import too_fast, too_near
from services.geofence.episodes import Episodes
from services.geofence.people import AreaPeople, Person
from services.geofence.quiet import name_of
from services.geofence.visits import Visit, Visits
from services.geofence.zone_plan import Rule, ZonePlan

__all__ = ["Found", "Gatherings"]

LEAST = {"crowd": 1.0, "proximity": 0.5, "speed": 0.5}
"""Seconds for which it must be so: a step past each other is no meeting, one estimate no speed."""
REST = {"crowd": 5.0, "proximity": 3.0, "speed": 2.0}
"""Seconds after which it is another crowd, meeting, run."""
_FRESH = 1.0
"""Seconds by which areas' newest frames may be apart to be one moment."""


@dataclass(frozen=True, slots=True)
class Found:
    """Something that is so by now and was not before; about nobody alone, one person, or one and another."""

    rule: Rule
    since: float
    value: float
    x: float
    y: float
    people: tuple[tuple[Person, str | None], ...] = ()
    tracks: tuple[int, ...] = ()


class Gatherings:
    """The episodes of all rules about those inside.

    Args:
        plan: what is watched.
    """

    def __init__(self, plan: ZonePlan) -> None:
        self._plan = plan
        self._rules = [rule for rules in plan.rules_of for rule in rules if rule.rule.kind in LEAST]
        self._episodes: dict[str, Episodes[str]] = {kind: Episodes(LEAST[kind], REST[kind]) for kind in LEAST}

    def step(
        self,
        areas: Mapping[str, AreaPeople],
        area: str,
        t: float,
        visits: Visits,
        seen: Callable[[Visit], bool],
    ) -> list[Found]:
        """Return what has begun by ``t``, now that there is a newer frame of ``area``."""
        if not self._rules:
            return []
        holding: dict[str, dict[str, Found]] = {kind: {} for kind in LEAST}
        for rule in self._rules:
            inside = visits.at(rule.border)
            if rule.rule.kind == "crowd":
                found = self._crowd(rule, inside, areas, seen)
            elif rule.rule.kind == "speed":
                found = self._fast(rule, inside, areas, t)
            else:
                found = self._near(rule, inside, areas, t)
            holding[rule.rule.kind].update(found)
        begun = []
        for kind, episodes in self._episodes.items():
            for key, since in episodes.step(t, holding[kind]):
                one = holding[kind][key]
                begun.append(Found(one.rule, since, one.value, one.x, one.y, one.people, one.tracks))
        return begun

    def under(self, plan: ZonePlan) -> Gatherings:
        """Return the same episodes under other zones."""
        other = Gatherings(plan)
        other._episodes = self._episodes
        return other

    def clear(self) -> None:
        """Forget all: time begins anew."""
        for episodes in self._episodes.values():
            episodes.clear()

    def state(self) -> dict[str, Any]:
        """Return what ``restore`` takes."""
        return {kind: episodes.state() for kind, episodes in self._episodes.items()}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Be as another was when its ``state`` was taken."""
        for kind, episodes in self._episodes.items():
            episodes.restore(tuple(one) for one in state[kind])

    def _crowd(
        self, rule: Rule, inside: list[Visit], areas: Mapping[str, AreaPeople], seen: Callable[[Visit], bool]
    ) -> dict[str, Found]:
        there = [
            visit
            for visit in inside
            if rule.fits(_device(visit, areas)) and (rule.rule.audience == "phones" or rule.rule.devices or seen(visit))
        ]
        if len(there) <= rule.limit:
            return {}
        x, y = self._plan.borders.index.representative(rule.border)
        return {rule.key: Found(rule, 0.0, float(len(there)), x, y)}

    def _fast(self, rule: Rule, inside: list[Visit], areas: Mapping[str, AreaPeople], t: float) -> dict[str, Found]:
        rows = list(_rows(inside, areas, t))
        if not rows:
            return {}
        velocity = np.array([people.newest.velocity[row] for _, people, row in rows if people.newest is not None])
        found = {}
        for place in too_fast(velocity, rule.limit).tolist():
            person, people, row = rows[place]
            device = people.devices.get(person[1])
            if rule.fits(device):
                speed = float(np.hypot(*velocity[place]))
                found[f"{rule.key}|{name_of(*person)}"] = _found(rule, speed, [(person, people, row)])
        return found

    def _near(self, rule: Rule, inside: list[Visit], areas: Mapping[str, AreaPeople], t: float) -> dict[str, Found]:
        rows = list(_rows(inside, areas, t))
        target = rule.rule.target
        if target:
            # A hazard is one wherever it is.
            floor = self._plan.borders.index.floor[rule.border]
            rows = [one for one in rows if one[1].devices.get(one[0][1]) != target]
            rows += _carriers(target, areas, int(floor), t)
        if len(rows) < 2:
            return {}
        frames = [(people.newest, row) for _, people, row in rows if people.newest is not None]
        place = np.array([(frame.x[row], frame.y[row]) for frame, row in frames])
        covariance = np.array([frame.covariance[row] for frame, row in frames])
        devices = [people.devices.get(person[1]) for person, people, _ in rows]
        hazard = np.array([device == target for device in devices]) if target else None
        found = {}
        for one, other, distance in zip(
            *(part.tolist() for part in too_near(place, covariance, rule.limit, rule.rule.confidence, hazard)),
            strict=True,
        ):
            pair = [rows[one], rows[other]]
            if not rule.fits(devices[one]):
                if target or not rule.fits(devices[other]):
                    continue
                pair.reverse()
            names = [name_of(*person) for person, _, _ in pair]
            key = "|".join([rule.key, *(names if target else sorted(names))])
            found[key] = _found(rule, distance, pair)
        return found


_Row = tuple[Person, AreaPeople, int]


def _rows(inside: list[Visit], areas: Mapping[str, AreaPeople], t: float) -> Iterator[_Row]:
    """Yield where in which area's newest frame each visitor is, as far as one tells of them now."""
    seats: dict[str, dict[Person, Visit]] = {}
    for visit in inside:
        for seat in visit.seats:
            seats.setdefault(seat[0], {})[seat] = visit
    done: set[int] = set()
    for area, mine in seats.items():
        people = areas[area]
        if people.newest is None or abs(people.t - t) > _FRESH:
            continue
        rows = people.rows_of(np.array([who for _, who in mine], np.int64))
        for (seat, visit), row in zip(mine.items(), rows.tolist(), strict=True):
            if row >= 0 and id(visit) not in done:
                done.add(id(visit))
                yield seat, people, row


def _carriers(device: str, areas: Mapping[str, AreaPeople], floor: int, t: float) -> list[_Row]:
    """Return where a device is on a floor; in one place, though two areas may see it."""
    for name, people in areas.items():
        frame = people.newest
        if frame is None or abs(people.t - t) > _FRESH:
            continue
        for row, (who, theirs) in enumerate(zip(people.who.tolist(), frame.device, strict=True)):
            if theirs == device and frame.floor[row] == floor:
                return [((name, who), people, row)]
    return []


def _device(visit: Visit, areas: Mapping[str, AreaPeople]) -> str | None:
    known = (areas[area].devices.get(who) for area, who in visit.seats)
    return next((device for device in known if device is not None), None)


def _found(rule: Rule, value: float, rows: list[_Row]) -> Found:
    (_, people, row) = rows[0]
    frame = people.newest
    assert frame is not None  # noqa: S101 (rows come from it)
    return Found(
        rule,
        0.0,
        value,
        float(frame.x[row]),
        float(frame.y[row]),
        tuple((person, area.devices.get(person[1])) for person, area, _ in rows),
        tuple(int(area.newest.track[place]) for _, area, place in rows if area.newest is not None),
    )
