"""What is true now: the newest tracks, last known positions and camera statuses, and their ready-made bytes.

Touched by one thread only (the HTTP event loop), so it needs no locks. Time comes in as an argument. Everything kept
is bounded: frames by the number of areas, positions by age.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace

import msgspec
import numpy as np

from services.api.accuracy import accuracy_of
from services.api.replies import (
    AreaFreshness,
    CameraReport,
    Cameras,
    Position,
    Positions,
    Reply,
    Track,
    Tracks,
    ZoneReport,
)
from services.api.track_memory import Since, TrackMemory
from services.api.zones_drawn import People, ZonesDrawn, zones_of
from shared.erased import Erased
from shared.messages import CameraStatus, TrackFrame
from shared.site import Site

__all__ = ["LiveState"]

REBUILD_AFTER = 0.2
"""Seconds after which ready-made bytes are built anew even when nothing came: ages must grow."""

WALKS = 0.3
"""Metres per second from which a velocity tells where somebody looks; slower, it is noise."""

CLOCK_SET_BACK = 5.0
"""Seconds by which a message must be older than the one held for it to be a clock set back and no late message."""


@dataclass(frozen=True, slots=True)
class _Arrived:
    frame: TrackFrame
    origin: float
    """Wall clock at which what the frame was made from reached the system; ages count from here."""
    since: Since


@dataclass(frozen=True, slots=True)
class _Fix:
    arrived: _Arrived
    index: int
    heading: tuple[float, float] | None = None
    """Radians counter-clockwise from +x, and when its carrier last walked that way."""


class _ReadyBytes:
    """Bytes of one reply, built at most once per change and once per ``REBUILD_AFTER``."""

    __slots__ = ("_build", "_built_at", "_bytes", "_version")

    def __init__(self, build: Callable[[float], Reply | bytes]) -> None:
        self._build = build
        self._bytes = b""
        self._built_at = -math.inf
        self._version = -1

    def at(self, now: float, version: int) -> bytes:
        if version != self._version or not 0.0 <= now - self._built_at < REBUILD_AFTER:
            built = self._build(now)
            self._bytes = built if isinstance(built, bytes) else msgspec.json.encode(built)
            self._built_at = now
            self._version = version
        return self._bytes


class LiveState:
    """The present state of one site as the API tells it.

    Args:
        site: what is where.
        positions_kept: seconds a device's last position is told after its source was received.
        tracks_kept: the same for the tracks of an area.
    """

    def __init__(self, site: Site, positions_kept: float, tracks_kept: float) -> None:
        self._site = site
        self._positions_kept = positions_kept
        self._tracks_kept = tracks_kept
        self._version = 0
        self.erased = Erased()
        self._newest: dict[str, _Arrived] = {}
        self._memories = {area.id: TrackMemory() for area in site.areas}
        self._fixes: dict[str, _Fix] = {}
        self._statuses: dict[str, tuple[CameraStatus, float]] = {}
        self._drawn = ZonesDrawn(zones_of(site))
        self._blind: frozenset[str] = frozenset()
        """Zones that no camera can see, as geofence told last."""
        self._positions = _ReadyBytes(self._build_positions)
        self._tracks: dict[str | None, _ReadyBytes] = {}
        for area in (None, *(area.id for area in site.areas)):
            self._tracks[area] = _ReadyBytes(lambda now, area=area: self._build_tracks(now, area))  # type: ignore[misc]
        self._zones = _ReadyBytes(self._build_zones_json)
        self._cameras = _ReadyBytes(lambda now: Cameras(t=now, cameras=self.cameras(now)))

    def take_tracks(self, frame: TrackFrame, origin: float) -> bool:
        """Take in a frame; False where its area is not in the site file, or an older frame than the one held."""
        if frame.area not in self._tracks:
            return False
        held = self._newest.get(frame.area)
        if held is not None and frame.t < held.frame.t:
            if held.frame.t - frame.t < CLOCK_SET_BACK and origin <= held.origin:
                return False
            # The clock was set back: what was told of a time yet to come must not outlive what is told now.
            self._fixes = {
                device: fix
                for device, fix in self._fixes.items()
                if fix.arrived.frame.area != frame.area or fix.arrived.frame.t <= frame.t
            }
        told, since = self._memories[frame.area].take(self.erased.from_tracks(frame))
        arrived = _Arrived(told, origin, since)
        self._newest[frame.area] = arrived
        for index, device in enumerate(arrived.frame.device):
            if device is not None:
                known = self._fixes.get(device)
                # Two tracks of one frame may claim a device while it changes hands: the surer one has it.
                if known is None or known.arrived is not arrived or _surer(arrived.frame, index, known.index):
                    self._fixes[device] = _Fix(arrived, index, _heading(arrived.frame, index, known))
        self._version += 1
        return True

    def newest(self, area: str) -> tuple[TrackFrame, Since]:
        """Return the newest frame of an area, and since when each device in it has been its person's.

        ``sources`` of the frame are those of the last second.

        Raises:
            KeyError: nothing was heard of this area.
        """
        held = self._newest[area]
        return held.frame, held.since

    def erase(self, device: str) -> None:
        """Forget a device whose consent was withdrawn."""
        self.erased.add(device)
        self._fixes.pop(device, None)
        for area, held in self._newest.items():
            self._memories[area].erase(device)
            self._newest[area] = replace(held, frame=self.erased.from_tracks(held.frame))
        self._version += 1

    def take_status(self, status: CameraStatus, now: float) -> bool:
        """Take in a camera's status; False where the camera is not in the site file or a newer status is held.

        One that is much older is taken: its clock was set back.
        """
        held = self._statuses.get(status.camera)
        if held is not None and 0.0 < held[0].t - status.t < CLOCK_SET_BACK:
            return False
        if all(camera.id != status.camera for camera in self._site.cameras):
            return False
        self._statuses[status.camera] = (status, now)
        self._version += 1
        return True

    def calibration(self, camera: str) -> str | None:
        """Return the digest of the calibration a camera said last that it uses; None: it was never heard."""
        held = self._statuses.get(camera)
        return None if held is None else held[0].geometry

    def forget(self, now: float) -> None:
        """Drop the positions that are too old to be told; call once in a while, so that memory is bounded."""
        for name in [name for name, fix in self._fixes.items() if now - fix.arrived.origin > self._positions_kept]:
            del self._fixes[name]

    def positions_json(self, now: float) -> bytes:
        """Return the body of ``GET /v1/positions``."""
        return self._positions.at(now, self._version)

    def positions(self, now: float) -> list[Position]:
        """Return where every device is."""
        return self._build_positions(now).positions

    def tracks(self, area: str | None, now: float) -> list[Track]:
        """Return everybody in the newest frame of one area or of all."""
        return self._build_tracks(now, area).tracks

    def position(self, device: str, now: float) -> Position | None:
        """Return where one device is, None if it has not been located lately."""
        fix = self._fixes.get(device)
        if fix is None or now - fix.arrived.origin > self._positions_kept:
            return None
        return self._told(device, fix, now)

    def heading(self, device: str) -> tuple[float, float] | None:
        """Return where a device's carrier walked last, radians counter-clockwise from +x, and when; None: nowhere."""
        fix = self._fixes.get(device)
        return None if fix is None else fix.heading

    def tracks_json(self, area: str | None, now: float) -> bytes:
        """Return the body of ``GET /v1/tracks`` for one area (KeyError if the site has none such) or for all."""
        return self._tracks[area].at(now, self._version)

    def zones_json(self, now: float) -> bytes:
        """Return the body of ``GET /v1/zones``."""
        return self._zones.at(now, self._version)

    def cameras_json(self, now: float) -> bytes:
        """Return the body of ``GET /v1/cameras``."""
        return self._cameras.at(now, self._version)

    def draw(self, zones: ZonesDrawn) -> None:
        """Count in these zones from now on."""
        self._drawn = zones
        self._version += 1

    def take_blind(self, zones: Collection[str]) -> None:
        """Take in which zones no camera can see now."""
        if self._blind != frozenset(zones):
            self._blind = frozenset(zones)
            self._version += 1

    @property
    def zones(self) -> ZonesDrawn:
        """The zones that hold now."""
        return self._drawn

    def cameras(self, now: float) -> list[CameraReport]:
        """Return how each camera of the site is doing."""
        return [self._camera(camera.id, camera.area, now) for camera in self._site.cameras]

    def camera(self, camera_id: str, now: float) -> CameraReport:
        """Return how one camera of the site is doing (KeyError if the site has none such)."""
        return self._camera(camera_id, self._site.camera(camera_id).area, now)

    def areas(self, now: float) -> list[AreaFreshness]:
        """Return when each area was last heard of."""
        reports = []
        for area in self._site.areas:
            arrived = self._newest.get(area.id)
            if arrived is None:
                reports.append(AreaFreshness(area=area.id, t=None, age=None, people=0))
            else:
                age = _age(now, arrived.origin)
                seen = sum(state != "unseen" for state in arrived.frame.state)
                people = seen if age <= self._tracks_kept else 0
                reports.append(AreaFreshness(area=area.id, t=arrived.frame.t, age=age, people=people))
        return reports

    def _build_positions(self, now: float) -> Positions:
        self.forget(now)
        return Positions(t=now, positions=[self._told(name, fix, now) for name, fix in self._fixes.items()])

    def _told(self, device: str, fix: _Fix, now: float) -> Position:
        frame, index = fix.arrived.frame, fix.index
        fresh = self._newest.get(frame.area) is fix.arrived
        return Position(
            device=device,
            area=frame.area,
            floor=frame.floor[index],
            x=frame.x[index],
            y=frame.y[index],
            covariance=frame.covariance[index],
            accuracy=accuracy_of(frame.covariance[index]),
            vx=frame.vx[index],
            vy=frame.vy[index],
            t=frame.t,
            age=_age(now, fix.arrived.origin),
            track=frame.track[index],
            probability=frame.probability[index],
            state=frame.state[index] if fresh else "lost",
        )

    def _present(self, now: float) -> list[_Arrived]:
        return [arrived for arrived in self._newest.values() if now - arrived.origin <= self._tracks_kept]

    def _build_tracks(self, now: float, area: str | None) -> Tracks:
        return Tracks(
            t=now,
            tracks=[
                Track(
                    track=track,
                    area=frame.area,
                    floor=frame.floor[i],
                    x=frame.x[i],
                    y=frame.y[i],
                    covariance=frame.covariance[i],
                    accuracy=accuracy_of(frame.covariance[i]),
                    vx=frame.vx[i],
                    vy=frame.vy[i],
                    t=frame.t,
                    age=_age(now, arrived.origin),
                    state=frame.state[i],
                    device=frame.device[i],
                    device_since=_held_since(arrived, track, frame.device[i]),
                    probability=frame.probability[i],
                    runner_up=frame.runner_up[i],
                    runner_up_probability=frame.runner_up_probability[i],
                    former=frame.former[i],
                    sources=frame.sources[i],
                    quality=frame.quality[i],
                )
                for arrived in self._present(now)
                if area is None or arrived.frame.area == area
                for frame in (arrived.frame,)
                for i, track in enumerate(frame.track)
            ],
        )

    def zone(self, name: str, now: float) -> ZoneReport:
        """Return one zone and who is in it (KeyError if there is none such)."""
        return self._drawn.reports(self._people(now), self._blind)[self._drawn.ids[name]]

    def _build_zones_json(self, now: float) -> bytes:
        return b'{"t":%b,"zones":%b}' % (
            msgspec.json.encode(now),
            self._drawn.reports_json(self._people(now), self._blind),
        )

    def _people(self, now: float) -> People:
        frames = [arrived.frame for arrived in self._present(now)]
        floor = np.array([name for frame in frames for name in frame.floor], dtype=object)
        x = np.array([value for frame in frames for value in frame.x], dtype=float)
        y = np.array([value for frame in frames for value in frame.y], dtype=float)
        unseen = np.array([state == "unseen" for frame in frames for state in frame.state], dtype=bool)
        return People(floor, x, y, unseen)

    def _camera(self, camera: str, area: str, now: float) -> CameraReport:
        held = self._statuses.get(camera)
        if held is None:
            return CameraReport(
                camera=camera,
                area=area,
                state="unknown",
                reason="has not reported yet",
                frames=0,
                dropped=0,
                frames_per_s=0.0,
                t=None,
                age=None,
            )
        status, received = held
        return CameraReport(
            camera=camera,
            area=area,
            state=status.state,
            reason=status.reason,
            frames=status.frames,
            dropped=status.dropped,
            frames_per_s=status.frames_per_s,
            t=status.t,
            age=_age(now, received),
        )


def _age(now: float, origin: float) -> float:
    return round(max(0.0, now - origin), 3)


def _held_since(arrived: _Arrived, track: int, device: str | None) -> float | None:
    return None if device is None else arrived.since.get((track, device))


def _heading(frame: TrackFrame, index: int, known: _Fix | None) -> tuple[float, float] | None:
    vx, vy = frame.vx[index], frame.vy[index]
    if vx * vx + vy * vy >= WALKS * WALKS:
        return math.atan2(vy, vx), frame.t
    return None if known is None else known.heading


def _surer(frame: TrackFrame, index: int, than: int) -> bool:
    return frame.probability[index] > frame.probability[than]
