"""What is there to tell? Tracks of all areas in, what zones' rules ask for out, once per person.

Pure: time comes with the frames. ``crossings`` says who is inside and what was crossed, ``visits`` makes people of
tracks, ``conditions`` looks at those inside; here is decided which rule tells of it.
"""

from __future__ import annotations

import heapq
import itertools
from collections import deque
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import tzinfo
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from services.geofence.crossings import Crossing, Crossings
from services.geofence.gatherings import Gatherings
from services.geofence.people import AreaPeople, Person, Sighting, twin_of
from services.geofence.quiet import Quiet, name_of
from services.geofence.schedule import holds
from services.geofence.sight import AreaSight
from services.geofence.visits import Visit, Visits
from services.geofence.zone_plan import MOST_SPREAD, Rule, ZonePlan
from shared.messages import Revision

__all__ = ["Told", "Watch"]

Ints = NDArray[np.int64]

SURE = 2.45
"""Standard deviations of the radius within which somebody is with 95 %, in two dimensions."""
LEAST_SPREAD = 0.1
"""Metres, standard deviation that every position has besides its own: cameras are not calibrated better than that."""
RECENT = 60.0
"""Seconds for which what happened is kept, should it turn out whose phone it was."""
MOST_RECENT = 5000
_AGAIN = 1.0
"""Seconds after which a stay that is long enough, but not the rule's business now, is looked at again."""
_SAME_CROSSING = 2.0
"""Seconds within which two areas see one crossing of a line."""


@dataclass(frozen=True, slots=True)
class Told:
    """One thing to tell; see ``shared.messages.Alert``."""

    rule: Rule
    t: float
    area: str
    track: int
    x: float
    y: float
    device: str | None = None
    value: float | None = None
    direction: Literal["forward", "backward"] | None = None
    other_track: int | None = None
    other_device: str | None = None


@dataclass(slots=True)
class _Happening:
    """An enter, exit or cross lately, of which more may have to be told once it is known who it was."""

    kind: str
    crossing: Crossing
    person: Person
    told: set[str] = field(default_factory=set)


class Watch:
    """The state of all rules of a site.

    Args:
        plan: what is watched.
        areas: ids of the site's areas.
        zone: of the site's clocks.
        grace: seconds after which somebody who vanished has left.
        sight: what the cameras of each area see; of one that is not named, always all.
    """

    def __init__(
        self,
        plan: ZonePlan,
        areas: Iterable[str],
        zone: tzinfo,
        grace: float,
        sight: Mapping[str, AreaSight] | None = None,
    ) -> None:
        self.plan = plan
        self._zone = zone
        self._grace = grace
        self._sight = sight or {}
        self.areas = {area: self._nobody(area) for area in areas}
        """By id."""
        self._visits = Visits()
        self._quiet = Quiet()
        self._gatherings = Gatherings(plan)
        self._recent: deque[_Happening] = deque(maxlen=MOST_RECENT)
        self._due: list[tuple[float, int, Visit, Rule]] = []
        self._number = itertools.count()

    def step(self, area: str, sighting: Sighting, cameras: Collection[str] | None = None) -> list[Told]:
        """Advance to a newer frame of one area and return what there is to tell.

        Args:
            area: its id.
            sighting: the frame.
            cameras: which cameras fed it; None: all of the area.
        """
        people = self.areas[area]
        if area in self._sight:
            self._sight[area].look(sighting.t, cameras)
        while self._recent and sighting.t - self._recent[0].crossing.t > RECENT:
            self._recent.popleft()
        known = self._known_well(sighting)
        rest, well = np.flatnonzero(~known), np.flatnonzero(known)
        track, former = sighting.track, sighting.former
        people.crossings.note_lost(sighting.t)
        if people.crossings.lost:
            # Who was lost while nobody could see is found by the phone.
            lost = people.lost_devices()
            former = [
                [lost[device], *before] if device in lost else before
                for device, before in zip(sighting.device, former, strict=True)
            ]
        people.crossings.hold(sighting.t, track[rest], [former[row] for row in rest.tolist()], track[well])
        happened = people.crossings.step(
            sighting.t,
            track[well],
            sighting.floor[well],
            sighting.x[well],
            sighting.y[well],
            former if not len(rest) else [former[row] for row in well.tolist()],
            track[rest],
            sighting.covariance[well] + LEAST_SPREAD**2 * np.array([1.0, 0.0, 1.0]),
        )
        changed = people.take(sighting)
        people.absent = set(people.crossings.people(np.array(list(people.crossings.lost), np.int64)).tolist())
        told = [one for crossing in happened for one in self._take(area, crossing)]
        told += [one for who in changed for one in self._reconsider(area, who)]
        told += self._stays(sighting.t)
        return told + self._conditions(area, sighting.t)

    def empty(self, area: str, t: float) -> list[Told]:
        """Let everybody leave an area at ``t``: its time begins anew."""
        people = self.areas[area]
        told = [one for crossing in people.crossings.close(t) for one in self._take(area, crossing)]
        people.newest, people.who = None, np.empty(0, np.int64)
        return told

    def lose_sight(self, area: str) -> None:
        """Note that an area is silent: nobody knows who is there, and nobody has left."""
        people = self.areas[area]
        if area in self._sight:
            self._sight[area].lose()
        people.newest, people.who = None, np.empty(0, np.int64)
        people.absent = set(people.crossings.people(people.crossings.tracks).tolist())

    def begin_anew(self, area: str) -> list[Told]:
        """Forget an area whose time ran back: another pass of a recording begins."""
        told = self.empty(area, self.areas[area].t)
        if area in self._sight:
            self._sight[area].forget()
        self.areas[area] = self._nobody(area)
        self._quiet.clear()
        self._gatherings.clear()
        self._recent.clear()
        return told

    def revise(self, revision: Revision) -> list[Told]:
        """Take in what is now thought of the last seconds: whose phone it was that entered, left or crossed."""
        told = []
        of, at, track = np.array(revision.of, int), np.array(revision.at, float), np.array(revision.track, int)
        for number, (device, since) in enumerate(zip(revision.device, revision.since, strict=True)):
            mine = of == number
            for happening in self._recent:
                crossing = happening.crossing
                if happening.person[0] != revision.area or not since <= crossing.t <= revision.t:
                    continue
                with_it = mine & (track == crossing.track)
                if with_it.any() and np.abs(at[with_it] - crossing.t).min() <= 1.0:
                    told += self._tell_happening(happening, device)
        return told

    def erase(self, device: str) -> None:
        """Forget a device whose consent was withdrawn."""
        for people in self.areas.values():
            people.devices = {who: name for who, name in people.devices.items() if name != device}
        self._quiet.forget(device)

    def follow(self, plan: ZonePlan, t: float) -> list[Told]:
        """Watch other zones from now on; whom a zone that changed still holds stays inside, without a word."""
        becomes, unchanged = self.plan.becomes(plan), self.plan.unchanged(plan)
        told: list[Told] = []
        moved: dict[str, Crossings] = {}
        for area, people in self.areas.items():
            when = people.t if np.isfinite(people.t) else t
            moved[area], exits = people.crossings.moved(plan.borders, becomes, unchanged, when)
            told += [one for crossing in exits for one in self._take(area, crossing)]
        known = {rule.key for rules in self.plan.rules_of for rule in rules}
        self.plan = plan
        self._visits.rebordered(becomes)
        for area, people in self.areas.items():
            people.crossings, people.newest, people.who = moved[area], None, np.empty(0, np.int64)
            for border, track, who, x, y in people.crossings.inside():
                person = (area, who)
                when = people.t if np.isfinite(people.t) else t
                crossing = Crossing("enter", border, track, who, when, x, y)
                visit = self._visits.enter(crossing, person, twin_of(person, self.areas, self._grace))
                if visit is not None:
                    visit.told |= {rule.key for rule in plan.rules_of[border] if rule.rule.kind == "enter"}
        for visit in self._visits.all():
            # A rule that is new tells of those who enter from now on.
            rules = plan.rules_of[visit.border]
            visit.told |= {rule.key for rule in rules if rule.rule.kind == "enter" and rule.key not in known}
        self._recent.clear()
        self._gatherings = self._gatherings.under(plan)
        self._plan_stays()
        return told

    def counts(self) -> dict[str, tuple[int, int]]:
        """Return how many people cameras see in each zone that is an area, and how many known devices are in it.

        People count where their positions are now: borders that wait and hold on, as alerts need them, would count
        those who are just outside. Where no frame came yet, who is inside by the saved state counts.
        """
        number = {border: zone for zone, border in self.plan.counted.items()}
        people = dict.fromkeys(self.plan.counted, 0)
        for name, area in self.areas.items():
            if area.newest is not None:
                for border in self._inside_now(name).tolist():
                    if border in number:
                        people[number[border]] += 1
        counted = {}
        for zone, border in self.plan.counted.items():
            visits = self._visits.at(border)
            here = [visit for visit in visits if not self._absent(visit)]
            devices = {device for visit in here if (device := self._device(visit)) is not None}
            unheard = [visit for visit in visits if all(self.areas[area].newest is None for area, _ in visit.seats)]
            counted[zone] = (people[zone] + sum(self._seen(visit) for visit in unheard), len(devices))
        return counted

    def _inside_now(self, name: str) -> Ints:
        """Return the borders in which somebody stands whom this area sees, and no area before it, once for each."""
        frame, who = self.areas[name].newest, self.areas[name].who
        if frame is None:
            return np.empty(0, np.int64)
        rows = np.flatnonzero(frame.seen)
        row, border, depth, _ = self.plan.borders.index.nearby(frame.x[rows], frame.y[rows], frame.floor[rows])
        inside = np.flatnonzero((depth >= 0.0) & ~self.plan.borders.index.is_line[border])
        row, border = row[inside], border[inside]
        if len(self.areas) > 1:
            order = list(self.areas)
            before = {other: self.areas[other] for other in order[: order.index(name) + 1]}
            twins = {
                one
                for one in set(who[rows[row]].tolist())
                if (twin := twin_of((name, one), before, self._grace)) is not None and self._reported(twin)
            }
            alone = np.array([one not in twins for one in who[rows[row]].tolist()], np.bool_)
            border = border[alone]
        return border

    def _reported(self, person: Person) -> bool:
        """Whether the newest frame of an area reports a person."""
        return bool((self.areas[person[0]].who == person[1]).any())

    # -- across restarts ---------------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """Return what ``restore`` takes, in plain values."""
        return {
            "areas": {
                name: {
                    "t": area.t,
                    "crossings": area.crossings.state(),
                    "devices": list(area.devices.items()),
                    "unseen": sorted(area.unseen),
                }
                for name, area in self.areas.items()
                if np.isfinite(area.t)
            },
            "visits": self._visits.state(),
            "quiet": self._quiet.state(),
            "gatherings": self._gatherings.state(),
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Be as another with the same plan was when its ``state`` was taken.

        Raises:
            ValueError, TypeError, KeyError, IndexError: it is no such state; then this is of no use any more.
        """
        for name, saved in state["areas"].items():
            area = self.areas.get(name)
            if area is None:
                continue
            area.crossings.restore(saved["crossings"])
            area.t = float(saved["t"])
            area.devices = {int(who): str(device) for who, device in saved["devices"]}
            area.unseen = set(saved["unseen"])
        kept = [one for one in state["visits"] if all(seat[0] in self.areas for seat in one["seats"])]
        self._visits.restore(kept)
        self._quiet.restore(state["quiet"])
        self._gatherings.restore(state["gatherings"])
        self._plan_stays()

    # -- crossings ---------------------------------------------------------------------------------------------------

    def _take(self, area: str, crossing: Crossing) -> list[Told]:
        person = (area, crossing.who)
        if crossing.kind == "enter":
            visit = self._visits.enter(crossing, person, twin_of(person, self.areas, self._grace))
            if visit is None:
                return []
            self._plan_stay(visit)
            # The one set of what was told serves both: the visit and what happened.
            happening = _Happening("enter", crossing, person, visit.told)
        elif crossing.kind == "exit":
            left = self._visits.leave(crossing.border, person)
            if left is None:
                return []
            happening = _Happening("exit", crossing, person)
        elif crossing.kind == "lost":
            self._visits.leave(crossing.border, person)
            return []
        elif crossing.kind == "absorbed":
            self._absorb(crossing, person)
            return []
        else:
            if self._crossed_elsewhere(crossing, person):
                return []
            happening = _Happening("cross", crossing, person)
        self._recent.append(happening)
        return self._tell_happening(happening, self.areas[area].devices.get(crossing.who))

    def _absorb(self, crossing: Crossing, person: Person) -> None:
        """One person was inside under two numbers: the longer stay is theirs, and what was told of it."""
        heirs = [one for one in self._visits.of((person[0], crossing.heir)) if one.border == crossing.border]
        gone = self._visits.leave(crossing.border, person)
        if gone is not None and heirs:
            heirs[0].told |= gone.told
            if gone.t < heirs[0].t:
                heirs[0].t = gone.t
                self._plan_stay(heirs[0])

    def _crossed_elsewhere(self, crossing: Crossing, person: Person) -> bool:
        """Whether another area saw the same person cross the same line the same way just now."""
        twin = twin_of(person, self.areas, self._grace)
        return twin is not None and any(
            one.person == twin
            and (one.crossing.border, one.crossing.direction) == (crossing.border, crossing.direction)
            and abs(one.crossing.t - crossing.t) <= _SAME_CROSSING
            for one in self._recent
            if one.kind == "cross"
        )

    def _tell_happening(self, happening: _Happening, device: str | None) -> list[Told]:
        crossing, area = happening.crossing, happening.person[0]
        told = []
        for rule in self.plan.rules_of[crossing.border]:
            if rule.rule.kind != happening.kind or rule.key in happening.told:
                continue
            if happening.kind == "cross" and rule.rule.direction not in ("both", crossing.direction):
                continue
            names = self._names(happening.person, device)
            if self._may(rule, crossing.t, device, names):
                happening.told.add(rule.key)
                told.append(
                    Told(rule, crossing.t, area, crossing.track, crossing.x, crossing.y, device,
                         direction=crossing.direction)
                )  # fmt: skip
        return told

    def _reconsider(self, area: str, who: int) -> list[Told]:
        """Tell what is now known to be the business of a rule, since it is known whose phone it is."""
        person, device, now = (area, who), self.areas[area].devices[who], self.areas[area].t
        told = []
        for happening in self._recent:
            if happening.person == person and now - happening.crossing.t <= RECENT:
                told += self._tell_happening(happening, device)
        fresh = {(one.crossing.border, one.crossing.t) for one in self._recent if one.person == person}
        for visit in self._visits.of(person):
            if (visit.border, visit.t) not in fresh:
                crossing = Crossing("enter", visit.border, visit.track, who, visit.t, visit.x, visit.y)
                told += self._tell_happening(_Happening("enter", crossing, person, visit.told), device)
        return told

    # -- those inside ------------------------------------------------------------------------------------------------

    def _plan_stays(self) -> None:
        self._due.clear()
        for visit in self._visits.all():
            self._plan_stay(visit)

    def _plan_stay(self, visit: Visit) -> None:
        for rule in self.plan.rules_of[visit.border]:
            if rule.rule.kind == "dwell" and rule.key not in visit.told:
                heapq.heappush(self._due, (visit.t + rule.limit, next(self._number), visit, rule))

    def _stays(self, t: float) -> list[Told]:
        """Tell of those who have stayed for long."""
        told = []
        while self._due and self._due[0][0] <= t:
            due, _, visit, rule = heapq.heappop(self._due)
            if not visit.open or rule.key in visit.told:
                continue
            device, (area, who) = self._device(visit), visit.person
            if self._absent(visit) or not self._may(rule, t, device, self._names(visit.person, device)):
                heapq.heappush(self._due, (t + _AGAIN, next(self._number), visit, rule))
                continue
            visit.told.add(rule.key)
            place = self.areas[area].crossings.place_of(who)
            x, y = (visit.x, visit.y) if place is None else (float(place["x"]), float(place["y"]))
            told.append(Told(rule, max(due, visit.t), area, self._track(visit), x, y, device, value=t - visit.t))
        return told

    def _conditions(self, area: str, t: float) -> list[Told]:
        """Tell of crowds, of the fast, and of those too near."""
        told = []
        for found in self._gatherings.step(self.areas, area, t, self._visits, self._seen):
            rule = found.rule
            names = [name for person, device in found.people for name in self._names(person, device)]
            if not holds(rule.rule.schedule, t, self._zone):
                continue
            if not self._quiet.allows(rule.key, names or ["everybody"], t, rule.rule.quiet):
                continue
            about = found.people[0] if found.people else None
            other = found.people[1] if len(found.people) > 1 else None
            told.append(
                Told(
                    rule,
                    found.since,
                    area if about is None else about[0][0],
                    found.tracks[0] if found.tracks else 0,
                    found.x,
                    found.y,
                    None if about is None else about[1],
                    value=found.value,
                    other_track=None if other is None else found.tracks[1],
                    other_device=None if other is None else other[1],
                )
            )
        return told

    # -- who it is ---------------------------------------------------------------------------------------------------

    def _known_well(self, sighting: Sighting) -> NDArray[np.bool_]:
        """Whether each place is known well enough to weigh, or surely on one side of every border."""
        xx, xy, yy = sighting.covariance.T
        spread = np.sqrt(np.maximum(0.5 * (xx + yy) + np.hypot(0.5 * (xx - yy), xy), 0.0))
        known: NDArray[np.bool_] = spread <= MOST_SPREAD
        vague = np.flatnonzero(~known)
        if len(vague):
            radius = SURE * spread[vague] + self.plan.borders.margin
            known[vague] = self.plan.borders.index.clear_of_borders(
                sighting.x[vague], sighting.y[vague], sighting.floor[vague], radius
            )
        return known

    def _may(self, rule: Rule, t: float, device: str | None, names: Sequence[str]) -> bool:
        return (
            rule.fits(device)
            and holds(rule.rule.schedule, t, self._zone)
            and self._quiet.allows(rule.key, names, t, rule.rule.quiet)
        )

    def _names(self, person: Person, device: str | None) -> list[str]:
        return [name_of(*person)] if device is None else [device, name_of(*person)]

    def _device(self, visit: Visit) -> str | None:
        known = (self.areas[area].devices.get(who) for area, who in visit.seats)
        return next((device for device in known if device is not None), None)

    def _seen(self, visit: Visit) -> bool:
        return any(who not in self.areas[area].unseen | self.areas[area].absent for area, who in visit.seats)

    def _absent(self, visit: Visit) -> bool:
        return all(who in self.areas[area].absent for area, who in visit.seats)

    def _nobody(self, area: str) -> AreaPeople:
        crossings = Crossings(self.plan.borders, self._grace)
        if area in self._sight:
            crossings.hidden = self._sight[area].hidden
        return AreaPeople(crossings)

    def _track(self, visit: Visit) -> int:
        """Return the number a visitor goes by now."""
        area, who = visit.person
        people = self.areas[area]
        row = int(people.rows_of(np.array([who]))[0])
        return visit.track if row < 0 or people.newest is None else int(people.newest.track[row])
