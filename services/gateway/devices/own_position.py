"""Where is this phone, as far as the tracks say? Only ever asked by the phone itself."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import shapely

from services.gateway.protocol import Position, ZoneName
from shared.messages import TrackFrame
from shared.site import Zone
from shared.zones import ZoneDefinition

__all__ = ["OwnPositions"]


@dataclass(frozen=True, slots=True)
class _Seen:
    frame: TrackFrame
    index: int
    arrived: float


class OwnPositions:
    """The newest track of every device.

    Args:
        zones: of the site file; they hold until staff draw others.
        kept: seconds a position is told after its last update.
    """

    def __init__(self, zones: list[Zone], kept: float) -> None:
        self._zones = [(zone.floor, shapely.Polygon(zone.polygon), _named(zone)) for zone in zones]
        """Replaced as a whole: another thread reads them."""
        self._kept = kept
        self._seen: dict[str, _Seen] = {}

    def take(self, frame: TrackFrame, arrived: float) -> None:
        """Remember where one frame saw which device."""
        for index, device in enumerate(frame.device):
            if device is not None:
                self._seen[device] = _Seen(frame, index, arrived)

    def draw(self, zones: Sequence[ZoneDefinition]) -> None:
        """Tell of these zones from now on; nobody is in a line."""
        areas = [zone for zone in zones if zone.shape == "area"]
        self._zones = [(zone.floor, shapely.Polygon(zone.points), _named(zone)) for zone in areas]

    def forget(self, device: str) -> None:
        """Forget one device."""
        self._seen.pop(device, None)

    def forget_old(self, now: float) -> None:
        """Forget positions that are no longer told."""
        for device in [device for device, seen in self._seen.copy().items() if now - seen.arrived > self._kept]:
            self._seen.pop(device, None)

    def of(self, device: str, now: float) -> Position | None:
        """Return the position of one device, None where no track carries it.

        Args:
            device: whose.
            now: the server's clock.
        """
        seen = self._seen.get(device)
        if seen is None:
            return None
        frame, index = seen.frame, seen.index
        floor, x, y = frame.floor[index], frame.x[index], frame.y[index]
        return Position(
            t=frame.t,
            age=max(0.0, now - frame.t),
            area=frame.area,
            floor=floor,
            x=x,
            y=y,
            covariance=frame.covariance[index],
            probability=frame.probability[index],
            zones=[
                name for level, polygon, name in self._zones if level == floor and shapely.intersects_xy(polygon, x, y)
            ],
        )


def _named(zone: Zone | ZoneDefinition) -> ZoneName:
    return ZoneName(id=zone.id, name=zone.name or zone.id)
