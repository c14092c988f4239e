"""The geofence service: tracks of all areas in, alerts of all zones out."""

from __future__ import annotations

import math
import secrets
import time
from dataclasses import dataclass, field

import numpy as np
import structlog
from numpy.typing import NDArray
from prometheus_client import Counter, Gauge

from services.geofence.crossings import Crossing, Crossings
from services.geofence.settings import GeofenceSettings
from services.geofence.zone_index import ZoneIndex
from shared.bus import Bus
from shared.erased import Erased
from shared.messages import Alert, Erasure, TrackFrame, covariances
from shared.runner import Health, Service
from shared.site import Site

__all__ = ["GeofenceService"]

log = structlog.get_logger(__name__)

ALERTS = Counter("atrium_geofence_alerts_total", "Alerts published", ["zone", "kind"])
POSITIONS = Counter("atrium_geofence_positions_total", "Track positions tested against the zones")
LEFT_OUT = Counter("atrium_geofence_frames_left_out_total", "Frames not tested", ["reason"])
OCCUPANCY = Gauge("atrium_zone_occupancy", "Tracks inside a zone now", ["zone"])

Floats = NDArray[np.float64]

SURE = 2.45
"""Standard deviations of the radius within which somebody is with 95 %, in two dimensions."""
NEW_PASS = 1.0
"""Seconds by which time must run back for it to be a new pass of a recording and not a late frame."""


@dataclass
class _Area:
    crossings: Crossings
    t: float = -math.inf
    """Of the newest frame."""
    heard: float = math.inf
    """When it came, by the monotonic clock; infinite: nobody is inside, or the area is silent and told of."""
    devices: dict[int, str] = field(default_factory=dict)
    """Of each track in the newest frame; of one that vanished, the last it had: its exit is still to be told."""


class GeofenceService(Service[GeofenceSettings]):
    """Publishes an alert for each crossing of a zone's border."""

    name = "geofence"
    Settings = GeofenceSettings

    def __init__(self, settings: GeofenceSettings, site: Site, bus: Bus, health: Health) -> None:
        super().__init__(settings, site, bus, health)
        zones = site.zones
        self._index = ZoneIndex(
            [zone.polygon for zone in zones], [zone.floor for zone in zones], settings.geofence_margin
        )
        self._areas = {area.id: _Area(self._new_crossings()) for area in site.areas}
        self._publishers = [
            bus.publisher(self.keys.alert(zone.id), Alert, cached=True, history=settings.geofence_history)
            for zone in zones
        ]
        # Ids are unique across restarts and passes of one recording: a random name of this run and a number.
        self._run = secrets.token_hex(4)
        self._number = 0
        self._erased = Erased()
        self._inbox = bus.inbox(capacity=10_000)

    def run(self) -> None:
        """Test frames as they come until asked to stop."""
        self._inbox.subscribe(self.keys.tracks(), TrackFrame)
        self._inbox.subscribe(self.keys.erasure(), Erasure, cached=True)
        if not self.site.zones:
            log.info("the site file names no zones: there is nothing to watch")
        for zone in self.site.zones:
            OCCUPANCY.labels(zone.id).set(0)
        self.health.ready.set()
        while not self.stopping.is_set():
            for delivery in self._inbox.receive(timeout=0.5):
                if isinstance(delivery.message, TrackFrame):
                    self._take(self._erased.from_tracks(delivery.message), delivery.trace.origin)
                elif isinstance(delivery.message, Erasure):
                    self._erase(delivery.message.device)
            self._watch_silence()

    def stop(self) -> None:
        """Stop, and do not wait for a frame that may not come."""
        super().stop()
        self._inbox.wake()

    def _erase(self, device: str) -> None:
        """Name a device whose consent was withdrawn in no alert from now on."""
        self._erased.add(device)
        for area in self._areas.values():
            area.devices = {track: name for track, name in area.devices.items() if name != device}

    def _new_crossings(self) -> Crossings:
        return Crossings(self._index, self.settings.geofence_min_seconds, self.settings.geofence_grace)

    def _take(self, frame: TrackFrame, origin: float) -> None:
        area = self._areas.get(frame.area)
        if area is None:
            LEFT_OUT.labels("area not in the site file").inc()
            return
        if not self.site.zones:
            return
        if frame.t <= area.t:
            if area.t - frame.t < NEW_PASS:
                LEFT_OUT.labels("late").inc()
                return
            log.info("time ran back: a new pass begins", area=frame.area, seconds=round(area.t - frame.t, 1))
            self._publish(area.crossings.close(area.t), area, frame.area, origin)
            area.crossings = self._new_crossings()
            area.devices.clear()
        area.t, area.heard = frame.t, time.monotonic()
        self.health.well(f"tracks of {frame.area}")
        track = np.array(frame.track, np.int64)
        x, y = np.array(frame.x, float), np.array(frame.y, float)
        floor = self._index.floors_of(frame.floor)
        former, devices = frame.former, frame.device
        _, once = np.unique(track, return_index=True)
        if len(once) == len(track):
            once = np.arange(len(track))
        else:
            LEFT_OUT.labels("a track named twice: its second place").inc()
            track, x, y, floor = track[once], x[once], y[once], floor[once]
            former, devices = [former[place] for place in once.tolist()], [devices[place] for place in once.tolist()]
        for number, device in zip(track.tolist(), devices, strict=True):
            if device is not None:
                area.devices[number] = device
            else:
                area.devices.pop(number, None)  # its phone turned out to be somebody else's
        known = self._known_well(frame, once, floor, x, y)
        rest, well = np.flatnonzero(~known), np.flatnonzero(known)
        area.crossings.hold(frame.t, track[rest], [former[row] for row in rest.tolist()], track[well])
        earlier = [former[row] for row in well.tolist()]
        happened = area.crossings.step(frame.t, track[well], floor[well], x[well], y[well], earlier, track[rest])
        POSITIONS.inc(len(track))
        self._publish(happened, area, frame.area, origin)
        if len(area.devices) > 2 * len(area.crossings.tracks) + 64:
            remembered = set(area.crossings.tracks.tolist())
            area.devices = {number: device for number, device in area.devices.items() if number in remembered}

    def _known_well(
        self, frame: TrackFrame, rows: NDArray[np.int64], floor: NDArray[np.int64], x: Floats, y: Floats
    ) -> NDArray[np.bool_]:
        """Whether each of ``rows`` of a frame is surely on one side of every border.

        Cameras see whom they see. Whom no camera sees is somewhere within metres: unless that is wholly inside or
        wholly outside of every zone, nothing is said.
        """
        known = np.ones(len(rows), np.bool_)
        unseen = np.array([place for place, row in enumerate(rows.tolist()) if frame.state[row] == "unseen"], np.int64)
        if len(unseen):
            matrices = covariances(frame)[rows[unseen]]
            radius = SURE * np.sqrt(np.linalg.eigvalsh(matrices)[:, 1])
            known[unseen] = self._index.clear_of_borders(x[unseen], y[unseen], floor[unseen], radius)
        return known

    def _watch_silence(self) -> None:
        now = time.monotonic()
        for name, area in self._areas.items():
            quiet = now - area.heard
            if quiet > self.settings.geofence_silence:
                reason = f"no tracks for {self.settings.geofence_silence:g} s: everybody counts as gone"
                self.health.degraded(f"tracks of {name}", reason)
                self._publish(area.crossings.close(area.t + quiet), area, name, time.time())
                area.heard = math.inf

    def _publish(self, happened: list[Crossing], area: _Area, name: str, origin: float) -> None:
        for crossing in happened:
            zone = self.site.zones[crossing.zone]
            occupancy = sum(int(each.crossings.occupancy[crossing.zone]) for each in self._areas.values())
            OCCUPANCY.labels(zone.id).set(occupancy)
            if crossing.kind not in zone.alert_on:
                continue
            self._number += 1
            alert = Alert(
                t=crossing.t,
                id=f"{self._run}-{self._number}",
                zone=zone.id,
                kind=crossing.kind,
                area=name,
                track=crossing.track,
                floor=zone.floor,
                x=round(crossing.x, 3),
                y=round(crossing.y, 3),
                device=area.devices.get(crossing.track),
            )
            self._publishers[crossing.zone].publish(alert, origin)
            ALERTS.labels(zone.id, crossing.kind).inc()
            log.debug("alert", zone=zone.id, kind=crossing.kind, track=crossing.track)
