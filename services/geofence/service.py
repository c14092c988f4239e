"""The geofence service: tracks of all areas and the zones in force in; alerts and counts of people out."""

from __future__ import annotations

import functools
import math
import secrets
import time
import zoneinfo
from collections.abc import Callable, Sequence

import numpy as np
import structlog
from prometheus_client import Counter, Gauge

from services.geofence.people import Sighting
from services.geofence.saved_state import FORMAT, SavedState, SavedStateError, read_state, write_state
from services.geofence.settings import GeofenceSettings
from services.geofence.sight import Sight
from services.geofence.watch import Told, Watch
from services.geofence.zone_plan import MOST_ZONES, ZonePlan, of_site
from shared.acknowledgements import Acknowledgements
from shared.bus import Bus, Publisher
from shared.erased import Erased
from shared.messages import Alert, Erasure, Occupancy, Revision, TrackFrame
from shared.runner import Health, Service
from shared.setup_told import FollowedSite, SetupTold
from shared.site import Site
from shared.state_file import StateFile
from shared.zones import ZoneDefinition, ZoneSet

__all__ = ["GeofenceService", "sighting_of"]

log = structlog.get_logger(__name__)

ALERTS = Counter("atrium_geofence_alerts_total", "Alerts published", ["zone", "kind"])
POSITIONS = Counter("atrium_geofence_positions_total", "Track positions tested against the zones")
LEFT_OUT = Counter("atrium_geofence_frames_left_out_total", "Frames not tested", ["reason"])
OCCUPANCY = Gauge("atrium_zone_occupancy", "People inside a zone now", ["zone"])
ZONES_VERSION = Gauge("atrium_geofence_zones_version", "Version of the zones in force; 0: the site file's")

NEW_PASS = 1.0
"""Seconds by which time must run back for it to be a new pass of a recording and not a late frame."""
LATE = 2.0
"""Seconds after which a frame that waits here is told of."""


class GeofenceService(Service[GeofenceSettings]):
    """Publishes an alert for whatever the rules of the zones ask for, and how many people are in each zone."""

    name = "geofence"
    Settings = GeofenceSettings

    def __init__(self, settings: GeofenceSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        self._zones: list[ZoneDefinition] = of_site(site.zones)
        self._version = 0
        self._told_version = -1
        """Of the newest zone set the bus told since this process began: what was saved only bridges until then."""
        self._clock = zoneinfo.ZoneInfo(site.time_zone)
        self._followed = FollowedSite(settings.site_file, site, health)
        self._sight = Sight(site)
        self._watch = self._new_watch(self._zones, 0)
        self._heard = {area.id: math.inf for area in site.areas}
        """When the newest frame came, by the monotonic clock; infinite: none yet, or the area is silent and told of."""
        self._last = 0.0
        """When any came last."""
        self._unknown: tuple[object, set[str]] = (None, set())
        """Zones that nobody can see, and what that follows from."""
        self._alerts: dict[str, Publisher[Alert]] = {}
        self._counts = bus.publisher(self.keys.occupancy(), Occupancy)
        self._counted_at = -math.inf
        # Ids are unique across restarts and passes of one recording: a random name of this run and a number.
        self._run = secrets.token_hex(4)
        self._number = 0
        self._frames = 0
        self._erased = Erased()
        self._acknowledged = Acknowledgements(bus, self.keys, self.name)
        self._inbox = bus.inbox(capacity=10_000)
        folder = settings.state_folder
        self._state_file = StateFile(
            None if folder is None else folder / "geofence.state",
            settings.state_every,
            self._snapshot,
            health,
            what="who is in which zone",
            loss="whoever is inside would enter once more",
        )

    def run(self) -> None:
        """Test frames as they come until asked to stop."""
        self._restore()
        self._show_zones()
        self._inbox.subscribe(self.keys.zones(), ZoneSet, cached=True)
        self._inbox.subscribe(self.keys.tracks(), TrackFrame)
        self._inbox.subscribe(self.keys.revisions(), Revision)
        self._inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        self._inbox.subscribe(self.keys.setup(), SetupTold, cached=True)
        if not self._watch.plan.zones:
            log.info("the site file names no zones, and nobody drew any yet: there is nothing to watch")
        self.health.ready.set()
        while not self.stopping.is_set():
            received = self._inbox.receive(timeout=0.5)
            # Staff may change zones faster than many of them are made ready: what was changed again is passed over.
            newest = max((one.message.version for one in received if isinstance(one.message, ZoneSet)), default=0)
            for delivery in received:
                message, origin = delivery.message, delivery.trace.origin
                if isinstance(message, TrackFrame):
                    self._keep_pace(time.monotonic() - delivery.arrived)
                    self._take(self._erased.from_tracks(message), origin)
                elif isinstance(message, Revision):
                    self._revise(self._erased.from_revision(message), origin)
                elif isinstance(message, Erasure):
                    self._erase(message.device)
                elif isinstance(message, ZoneSet):
                    if message.version == newest:
                        self._follow(message)
                elif isinstance(message, SetupTold) and self._followed.take(message):
                    self._look_anew(self._followed.site)
            self._watch_silence()
            self._count()
            self._state_file.save_if_due(self._frames)
            self._acknowledged.tell_gone()
        self._state_file.save_last(self._frames)
        self._acknowledged.tell_gone()

    def stop(self) -> None:
        """Stop, and do not wait for a frame that may not come."""
        super().stop()
        self._inbox.wake()

    # -- what comes --------------------------------------------------------------------------------------------------

    def _take(self, frame: TrackFrame, origin: float) -> None:
        people = self._watch.areas.get(frame.area)
        if people is None:
            LEFT_OUT.labels("area not in the site file").inc()
            return
        if frame.t <= people.t:
            if people.t - frame.t < NEW_PASS:
                LEFT_OUT.labels("late").inc()
                return
            log.info("time ran back: a new pass begins", area=frame.area, seconds=round(people.t - frame.t, 1))
            self._publish(self._watch.begin_anew(frame.area), origin)
        self._heard[frame.area] = self._last = time.monotonic()
        self._frames += 1
        self.health.well(f"tracks of {frame.area}")
        sighting = sighting_of(frame, self._watch.plan)
        if len(sighting.track) < len(frame.track):
            LEFT_OUT.labels("a track named twice: its second place").inc()
        POSITIONS.inc(len(sighting.track))
        self._publish(self._watch.step(frame.area, sighting, frame.cameras), origin)

    def _keep_pace(self, waited: float) -> None:
        """Tell when frames wait here, as while thousands of zones are made ready or with more people than it can."""
        if waited > LATE:
            self.health.degraded("pace", f"frames wait here for more than {LATE:g} s: alerts and counts come late")
        elif waited < 0.5 * LATE:
            self.health.well("pace")

    def _revise(self, revision: Revision, origin: float) -> None:
        if revision.area in self._watch.areas:
            self._publish(self._watch.revise(revision), origin)

    def _erase(self, device: str) -> None:
        """Name a device whose consent was withdrawn in no alert from now on, and in no rule and no saved state."""
        self._erased.add(device)
        self._watch.erase(device)
        zones = self._erased.from_zones(self._zones)
        if zones != self._zones:
            self._watch_zones(zones, self._version)
        self._frames += 1
        self._state_file.save_soon()
        self._acknowledged.await_gone(device, functools.partial(self._state_file.holds, self._frames))

    def _follow(self, told: ZoneSet) -> None:
        """Watch the zones of a newer set."""
        if told.version <= self._told_version:
            return
        self._told_version = told.version
        if len(told.zones) > MOST_ZONES:
            reason = (
                f"{len(told.zones)} zones were told (version {told.version}), at most {MOST_ZONES} are watched: "
                f"those of version {self._version} stay in force until there are fewer"
            )
            self.health.degraded("zones", reason)
            return
        self.health.well("zones")
        zones = self._erased.from_zones(told.zones)
        if told.version == self._version and zones == self._zones:
            return
        self._watch_zones(zones, max(told.version, 1))
        self._version = told.version
        self._frames += 1
        self._state_file.save_soon()
        plan = self._watch.plan
        log.info("zones changed", version=told.version, zones=len(plan.zones), left_out=len(plan.problems))
        self._show_zones()

    def _watch_zones(self, zones: list[ZoneDefinition], version: int) -> None:
        """Watch these zones from now on."""
        plan = self._plan(zones, version)
        for topic in self.health.problems():
            if topic.startswith("zone ") and topic.removeprefix("zone ") not in plan.problems:
                self.health.well(topic)
        gone = set(self._watch.plan.zones) - set(plan.zones)
        self._publish(self._watch.follow(plan, time.time()), time.time())
        for zone in gone:
            OCCUPANCY.remove(zone)
            if zone in self._alerts:
                self._alerts.pop(zone).close()
        self._zones = zones

    def _watch_silence(self) -> None:
        now = time.monotonic()
        for name, heard in self._heard.items():
            quiet = now - heard
            if quiet > self.settings.geofence_silence:
                reason = f"no tracks for {self.settings.geofence_silence:g} s: nobody knows who is in its zones"
                self.health.degraded(f"tracks of {name}", reason)
                self._watch.lose_sight(name)
                self._heard[name] = math.inf
                self._frames += 1

    # -- what goes ---------------------------------------------------------------------------------------------------

    def _publish(self, told: Sequence[Told], origin: float) -> None:
        for one in told:
            zone = self._watch.plan.zone_of[one.rule.border]
            self._number += 1
            alert = Alert(
                t=one.t,
                id=f"{self._run}-{self._number}",
                zone=zone.id,
                kind=one.rule.rule.kind,
                area=one.area,
                track=one.track,
                floor=zone.floor,
                x=round(one.x, 3),
                y=round(one.y, 3),
                device=one.device,
                rule=one.rule.told_as,
                value=None if one.value is None else round(one.value, 3),
                limit=one.rule.rule.limit,
                direction=one.direction,
                other_track=one.other_track,
                other_device=one.other_device,
            )
            self._publisher(zone.id).publish(alert, origin)
            ALERTS.labels(zone.id, alert.kind).inc()
            log.debug("alert", zone=zone.id, kind=alert.kind, track=alert.track)

    def _publisher(self, zone: str) -> Publisher[Alert]:
        """Return the publisher of a zone's alerts, made at its first: of many zones most never have one."""
        publisher = self._alerts.get(zone)
        if publisher is None:
            history = self.settings.geofence_history
            publisher = self._alerts[zone] = self.bus.publisher(
                self.keys.alert(zone), Alert, cached=True, history=history
            )
        return publisher

    def _count(self) -> None:
        """Tell how many people are in each zone, when it is time."""
        now = time.monotonic()
        newest = max((people.t for people in self._watch.areas.values()), default=-math.inf)
        if now - self._counted_at < self.settings.geofence_occupancy_every or not math.isfinite(newest):
            return
        self._counted_at = now
        blind = self._blind()
        counts = {zone: count for zone, count in self._watch.counts().items() if zone not in blind}
        for zone, (people, _) in counts.items():
            OCCUPANCY.labels(zone).set(people)
        for zone in blind:
            OCCUPANCY.labels(zone).set(math.nan)
        if all(math.isinf(heard) for heard in self._heard.values()):
            newest += now - self._last  # time goes on, also where nobody tells of it
        self._counts.publish(
            Occupancy(
                t=newest,
                zone=list(counts),
                people=[people for people, _ in counts.values()],
                phones=[phones for _, phones in counts.values()],
                blind=sorted(blind),
            )
        )

    def _look_anew(self, site: Site) -> None:
        """Take up what the cameras watch now: somebody set one up."""
        self.site = site
        self._sight.follow(site)
        self._unknown = (None, set())

    def _blind(self) -> set[str]:
        """Return the zones that nobody can see; of them it is not known who is inside."""
        plan = self._watch.plan
        follows_from = plan.zones, [sight.blind for sight in self._sight.areas.values()]
        if follows_from != self._unknown[0]:
            counted = [zone for zone in self._zones if zone.id in plan.counted]
            self._unknown = follows_from, self._sight.blind_zones(counted)
        return self._unknown[1]

    # -- zones and state ---------------------------------------------------------------------------------------------

    def _plan(self, zones: Sequence[ZoneDefinition], version: int) -> ZonePlan:
        margin, min_seconds = self.settings.geofence_margin, self.settings.geofence_min_seconds
        return ZonePlan.of(zones, self.site, margin, min_seconds, named=version > 0)

    def _new_watch(self, zones: Sequence[ZoneDefinition], version: int) -> Watch:
        areas = [area.id for area in self.site.areas]
        return Watch(self._plan(zones, version), areas, self._clock, self.settings.geofence_grace, self._sight.areas)

    def _show_zones(self) -> None:
        plan = self._watch.plan
        ZONES_VERSION.set(self._version)
        for zone, problem in plan.problems.items():
            self.health.degraded(f"zone {zone}", problem)
        for zone, (people, _) in self._watch.counts().items():
            OCCUPANCY.labels(zone).set(people)

    def _snapshot(self) -> tuple[int, Callable[[], bytes]]:
        state = SavedState(
            format=FORMAT, site=self.site.site, version=self._version, zones=self._zones, watch=self._watch.state()
        )
        return self._frames, lambda: write_state(state)

    def _restore(self) -> None:
        try:
            data = self._state_file.read()
            if data is None:
                return
            state = read_state(data, self.site.site)
            watch = self._new_watch(state.zones, state.version)
            watch.restore(state.watch)
        except (OSError, SavedStateError, ValueError, TypeError, KeyError, IndexError) as error:
            log.warning("starting without the saved state", reason=str(error))
            return
        self._watch = watch
        if state.version == 0 and state.zones != self._zones:
            # The site file was edited meanwhile; nobody is told of those its new shapes no longer hold.
            watch.follow(self._plan(self._zones, 0), time.time())
        else:
            self._zones, self._version = state.zones, state.version
        now = self._last = time.monotonic()
        self._heard = {name: now if math.isfinite(people.t) else math.inf for name, people in watch.areas.items()}
        log.info("state restored", zones=len(self._zones), version=self._version)


def sighting_of(frame: TrackFrame, plan: ZonePlan) -> Sighting:
    """Return a frame's tracks as arrays, each track once."""
    track = np.array(frame.track, np.int64)
    sighting = Sighting(
        frame.t,
        track,
        plan.borders.index.floors_of(frame.floor),
        np.array(frame.x, float),
        np.array(frame.y, float),
        np.column_stack([np.array(frame.vx, float), np.array(frame.vy, float)]),
        np.array(frame.covariance, float).reshape(-1, 3),
        np.fromiter((state != "unseen" for state in frame.state), np.bool_, len(track)),
        frame.device,
        frame.former,
    )
    once = np.unique(track, return_index=True)[1]
    if len(once) == len(track):
        return sighting
    arrays = {
        name: getattr(sighting, name)[once] for name in ("track", "floor", "x", "y", "velocity", "covariance", "seen")
    }
    rows = once.tolist()
    device, former = [frame.device[row] for row in rows], [frame.former[row] for row in rows]
    return Sighting(t=frame.t, device=device, former=former, **arrays)
