"""Is the system doing its job, and if not, what is wrong in plain words?"""

from __future__ import annotations

from collections.abc import Collection, Sequence

from services.api.replies import AreaFreshness, CameraReport, HealthReport, ServicePresence

__all__ = ["Presence", "health_report"]

_MEANS = {
    "camera": "no pictures are evaluated",
    "gateway": "phones cannot report",
    "fusion": "nobody is tracked",
    "geofence": "no alerts are raised",
    "learning": "nothing new is learned",
    "history": "what happens is not kept",
}


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


def health_report(
    now: float,
    *,
    connected: bool,
    services: list[ServicePresence],
    areas: list[AreaFreshness],
    cameras: list[CameraReport],
    expected: Sequence[str],
    stale_after: float,
    unwatched: Collection[str] = (),
    told: Sequence[str] = (),
) -> HealthReport:
    """Return the report for one moment.

    Args:
        now: seconds since the epoch.
        connected: whether a router of the bus is reachable.
        services: every process seen so far.
        areas: when each area was last heard of.
        cameras: how each camera is doing.
        expected: services whose absence is a problem.
        stale_after: seconds without tracks that are a problem.
        unwatched: areas that have no camera.
        told: what services say of themselves.
    """
    problems = []
    if not connected:
        problems.append("the bus router cannot be reached: nothing below is up to date")
    alive = {presence.service for presence in services if presence.alive}
    # The first answer about who is alive names this service at least; before it, nothing is known of the others.
    for name in expected if connected and services else ():
        if name not in alive:
            means = f": {_MEANS[name]}" if name in _MEANS else ""
            problems.append(f"the {name} service is not running{means}")
    problems.extend(
        f"{presence.service} {presence.instance} was running and is gone"
        for presence in services
        if connected and not presence.alive and presence.service in alive
    )
    for area in areas:
        if area.area in unwatched:
            problems.append(f"area {area.area} has no camera: nobody is tracked or located there")
        elif area.age is None:
            problems.append(f"area {area.area}: no tracks have arrived yet")
        elif area.age > stale_after:
            problems.append(f"area {area.area}: no tracks for {area.age:.0f} s, positions are getting old")
    for camera in cameras:
        if camera.state in ("unknown", "degraded", "ended"):
            reason = camera.reason or ("its source has come to an end" if camera.state == "ended" else camera.state)
            problems.append(f"camera {camera.camera}: {reason}")
    problems.extend(told)
    return HealthReport(
        t=now,
        status="degraded" if problems else "ok",
        problems=problems,
        services=services,
        areas=areas,
        cameras=cameras,
    )
