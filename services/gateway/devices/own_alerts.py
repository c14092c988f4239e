"""Which zones has this phone entered and left lately? Only ever asked by the phone itself."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence

import msgspec

from services.gateway.protocol import OwnAlert
from shared.messages import Alert
from shared.site import Zone
from shared.zones import ZoneDefinition

__all__ = ["MOST_ALERTS", "OwnAlertBook"]

MOST_ALERTS = 50
"""Kept of one device."""


class OwnAlertBook:
    """The last alerts of every device.

    Args:
        zones: of the site file; they hold until staff draw others.
        kept: seconds an alert is told.
    """

    def __init__(self, zones: list[Zone], kept: float) -> None:
        self._names = {zone.id: zone.name or zone.id for zone in zones}
        self._kept = kept
        self._alerts: dict[str, deque[tuple[str, float, OwnAlert]]] = {}
        self._lock = threading.Lock()

    def take(self, alert: Alert, arrived: float) -> None:
        """Remember one alert, once, if it is a device's; ``arrived`` is monotonic."""
        if alert.device is None:
            return
        own = self.told(alert)
        with self._lock:
            alerts = self._alerts.setdefault(alert.device, deque(maxlen=MOST_ALERTS))
            if all(known != alert.id for known, _, _ in alerts):
                alerts.append((alert.id, arrived, own))

    def told(self, alert: Alert) -> OwnAlert:
        """Return an alert as the phone it is about is told of it."""
        return OwnAlert(
            t=alert.t,
            kind=alert.kind,
            zone=alert.zone,
            name=self._names.get(alert.zone, alert.zone),
            floor=alert.floor,
            x=alert.x,
            y=alert.y,
        )

    def draw(self, zones: Sequence[ZoneDefinition]) -> None:
        """Call zones by these names from now on, also in what was told before."""
        self._names = {zone.id: zone.name or zone.id for zone in zones}

    def forget(self, device: str) -> None:
        """Forget one device."""
        with self._lock:
            self._alerts.pop(device, None)

    def forget_old(self, now: float) -> None:
        """Forget alerts that are no longer told; ``now`` is monotonic."""
        with self._lock:
            for device, alerts in list(self._alerts.items()):
                while alerts and now - alerts[0][1] > self._kept:
                    alerts.popleft()
                if not alerts:
                    del self._alerts[device]

    def of(self, device: str) -> list[OwnAlert]:
        """Return the alerts of one device in order of time."""
        with self._lock:
            found = [own for _, _, own in self._alerts.get(device, ())]
        named = [msgspec.structs.replace(own, name=self._names.get(own.zone, own.name)) for own in found]
        return sorted(named, key=lambda own: own.t)
