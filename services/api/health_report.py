"""Is the system doing its job, and if not, what is wrong in plain words?"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from services.api.replies import AreaFreshness, CameraReport, HealthReport, ServicePresence
from services.api.trouble import Finding

__all__ = ["Presence", "find_wrong", "health_report"]

_MEANS = {
    "camera": "no pictures are evaluated",
    "gateway": "phones cannot report",
    "fusion": "nobody is tracked",
    "geofence": "no alerts are raised",
    "learning": "nothing new is learned",
    "history": "what happens is not kept",
}

STATUS_OLD = 15.0
"""Seconds after which a camera's status says nothing: it is told every five."""


class Presence:
    """Which services hold a liveliness token, and which did before."""

    def __init__(self) -> None:
        self._alive: dict[tuple[str, str], bool] = {}

    def seen(self, alive_keys: Sequence[str]) -> None:
        """Take in the liveliness keys that stand now (they end in ``alive/SERVICE/INSTANCE``)."""
        now = {(parts[-2], parts[-1]) for parts in (key.split("/") for key in alive_keys) if len(parts) >= 2}
        self._alive = {known: known in now for known in sorted({*self._alive, *now})}
        # A process that comes back under a new name replaces its dead namesakes: names of the dead are bounded.
        for service in {service for service, _ in now}:
            dead = [known for known, alive in self._alive.items() if known[0] == service and not alive]
            for known in dead[:-16]:
                del self._alive[known]

    def services(self) -> list[ServicePresence]:
        """Return every process seen since this one started."""
        return [ServicePresence(service=s, instance=i, alive=alive) for (s, i), alive in sorted(self._alive.items())]


def find_wrong(
    *,
    connected: bool,
    services: Sequence[ServicePresence],
    areas: Sequence[AreaFreshness],
    cameras: Sequence[CameraReport],
    expected: Sequence[str],
    stale_after: float,
    unwatched: Collection[str] = (),
    told: Sequence[Finding] = (),
) -> list[Finding]:
    """Return what is wrong, causes first; what only follows from a cause that is named is left out.

    Args:
        connected: whether a router of the bus is reachable.
        services: every process seen so far.
        areas: when each area was last heard of.
        cameras: how each camera is doing.
        expected: services whose absence is a problem.
        stale_after: seconds without tracks that are a problem.
        unwatched: areas that have no camera.
        told: what services say of themselves.
    """
    found = []
    if not connected:
        found.append(Finding("bus", "", "router", "the bus router cannot be reached: nothing below is up to date"))
    alive = {presence.service for presence in services if presence.alive}
    # The first answer about who is alive names this service at least; before it, nothing is known of the others.
    missing = [name for name in expected if name not in alive] if connected and services else []
    for name in missing:
        means = f": {_MEANS[name]}" if name in _MEANS else ""
        found.append(Finding(name, "", "running", f"the {name} service is not running{means}"))
    gone = [one for one in services if connected and not one.alive and one.service in alive]
    found += [
        Finding(one.service, one.instance, "", f"{one.service} {one.instance} was running and is gone") for one in gone
    ]
    dead = {one.instance for one in gone if one.service == "camera"}
    blamed, silent = set(dead), set(dead)
    for camera in cameras:
        if "camera" in missing:
            silent.add(camera.camera)
            blamed.add(camera.camera)
        if camera.camera in dead or ("camera" in missing and (camera.age is None or camera.age > STATUS_OLD)):
            continue  # what it said last is not what it is
        if camera.state in ("unknown", "degraded", "ended"):
            reason = camera.reason or ("its source has come to an end" if camera.state == "ended" else camera.state)
            found.append(Finding("camera", camera.camera, "", f"camera {camera.camera}: {reason}"))
            blamed.add(camera.camera)
            if not camera.frames_per_s:
                silent.add(camera.camera)
    explained = {f"camera {camera}" for camera in blamed}
    for area in areas:
        cause = "fusion" in missing or any(one.service == "fusion" and one.instance == area.area for one in gone)
        mine = {camera.camera for camera in cameras if camera.area == area.area}
        cause = cause or (bool(mine) and mine <= silent)
        words = _area_words(area, stale_after, area.area in unwatched)
        if words and not cause:
            found.append(Finding("fusion", area.area, f"area {area.area}", words))
        if words or cause:
            explained.add(f"tracks of {area.area}")
    found += [one for one in told if one.topic not in explained]
    return found


def _area_words(area: AreaFreshness, stale_after: float, unwatched: bool) -> str:
    if unwatched:
        return f"area {area.area} has no camera: nobody is tracked or located there"
    if area.age is None:
        return f"area {area.area}: no tracks have arrived yet"
    old = area.age > stale_after
    return f"area {area.area}: no tracks for {area.age:.0f} s, positions are getting old" if old else ""


def health_report(
    now: float,
    wrong: Sequence[Finding],
    *,
    services: list[ServicePresence],
    areas: list[AreaFreshness],
    cameras: list[CameraReport],
) -> HealthReport:
    """Return the report of ``now``, seconds since the epoch; the other arguments: see ``find_wrong``."""
    return HealthReport(
        t=now,
        status="degraded" if wrong else "ok",
        problems=[one.words for one in wrong],
        services=services,
        areas=areas,
        cameras=cameras,
    )
