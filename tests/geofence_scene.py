"""A small site and people who walk in it, for tests of what zones tell."""

import itertools
from zoneinfo import ZoneInfo

import numpy as np

from services.geofence.people import Sighting
from services.geofence.sight import AreaSight
from services.geofence.watch import Told, Watch
from services.geofence.zone_plan import ZonePlan
from shared.site import Area, Floor, Site
from shared.zones import ZoneDefinition, ZoneRule

ROOM = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0)]
OUTLINE = [(-50.0, -50.0), (50.0, -50.0), (50.0, 50.0), (-50.0, 50.0)]
DT = 0.1
Where = tuple[float, float]


def a_site(*areas: str) -> Site:
    return Site(
        format="atrium-site/1",
        site="test",
        floors=[Floor(id="ground", outline=OUTLINE), Floor(id="upper", outline=OUTLINE)],
        areas=[Area(id=area, floor="ground") for area in areas or ("hall",)],
    )


def a_room(*rules: ZoneRule, zone: str = "room", points: list[Where] | None = None) -> ZoneDefinition:
    return ZoneDefinition(id=zone, floor="ground", points=points or ROOM, rules=list(rules))


def a_line(*rules: ZoneRule, points: list[Where] | None = None) -> ZoneDefinition:
    """From south to north at x = 0: left of it is the west, and forward is eastward."""
    return ZoneDefinition(
        id="line", floor="ground", shape="line", points=points or [(0.0, -3.0), (0.0, 3.0)], rules=list(rules)
    )


def a_plan(*zones: ZoneDefinition, site: Site | None = None) -> ZonePlan:
    return ZonePlan.of(zones, site or a_site(), 0.1, 0.3)


def a_watch(
    *zones: ZoneDefinition,
    areas: tuple[str, ...] = ("hall",),
    clock: str = "UTC",
    sight: dict[str, AreaSight] | None = None,
) -> Watch:
    return Watch(a_plan(*zones, site=a_site(*areas)), areas, ZoneInfo(clock), grace=2.0, sight=sight)


def sighting(
    watch: Watch,
    t: float,
    places: dict[int, Where],
    devices: dict[int, str] | None = None,
    former: dict[int, list[int]] | None = None,
    sigma: float = 0.05,
    velocity: Where = (0.0, 0.0),
    unseen: tuple[int, ...] = (),
) -> Sighting:
    count = len(places)
    return Sighting(
        t,
        np.array(list(places), np.int64),
        watch.plan.borders.index.floors_of(["ground"] * count),
        np.array([x for x, _ in places.values()]),
        np.array([y for _, y in places.values()]),
        np.tile(np.array(velocity), (count, 1)),
        np.tile([sigma**2, 0.0, sigma**2], (count, 1)),
        np.array([track not in unseen for track in places], np.bool_),
        [(devices or {}).get(track) for track in places],
        [(former or {}).get(track, []) for track in places],
    )


class Scene:
    """Plays frames to a watch and keeps what it told."""

    def __init__(self, watch: Watch, area: str = "hall", t: float = 1000.0) -> None:
        self.watch, self.area, self.t = watch, area, t
        self.told: list[Told] = []
        self.cameras: list[str] | None = None
        """Which feed the frames; None: they do not say."""

    def stand(self, seconds: float, places: dict[int, Where], area: str | None = None, **more: object) -> list[Told]:
        """Let everybody stand for so long; returns what was told meanwhile."""
        told: list[Told] = []
        for _ in range(round(seconds / DT)):
            self.t += DT
            told += self.watch.step(area or self.area, sighting(self.watch, self.t, places, **more), self.cameras)  # type: ignore[arg-type]
        self.told += told
        return told

    def walk(self, track: int, way: list[Where], speed: float = 1.3, **more: object) -> list[Told]:
        """Let one track walk along corners; returns what was told meanwhile."""
        told: list[Told] = []
        for (x0, y0), (x1, y1) in itertools.pairwise(way):
            steps = max(1, round(float(np.hypot(x1 - x0, y1 - y0)) / speed / DT))
            for share in np.arange(1, steps + 1) / steps:
                self.t += DT
                place = (float(x0 + share * (x1 - x0)), float(y0 + share * (y1 - y0)))
                told += self.watch.step(self.area, sighting(self.watch, self.t, {track: place}, **more), self.cameras)  # type: ignore[arg-type]
        self.told += told
        return told


def kinds(told: list[Told]) -> list[str]:
    return [one.rule.rule.kind for one in told]
