"""What would the twin have heard there? The walks of a recording, through a radio world of the same geometry."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.radio_recordings import Readings
from benchmarks.radio_residuals import PathLossFit, path_loss_line
from services.simulator.radio.radio_world import PHONE_HEIGHT, RadioParameters, RadioWorld
from services.simulator.radio.wall_loss import Barriers
from shared.site import AccessPoint, Site
from shared.site.site_file import Area, Floor

__all__ = ["counterpart", "site_of"]

Array = NDArray[np.float64]


def site_of(
    readings: Readings, fit: PathLossFit, kind: str, parameters: RadioParameters, walls: Sequence[Array]
) -> Site:
    """Return a site whose access points hang where those of the recording do, and are as strong.

    Args:
        readings: the recording.
        fit: places of its transmitters.
        kind: ``wifi`` or ``ble``.
        parameters: for what its walls swallow: path-loss lines are fitted to the rest.
        walls: lines (c, 2), metres.
    """
    around = np.concatenate([readings.scan_position, fit.place[:, :2]])
    (left, bottom), (right, top) = around.min(axis=0).tolist(), around.max(axis=0).tolist()
    outline = [(left, bottom), (right, bottom), (right, top), (left, top)]
    barriers = Barriers((wall, parameters.wall_loss) for wall in walls)
    points = []
    for number, place in enumerate(fit.place):
        mine = readings.transmitter == number
        lost = np.minimum(barriers.between(readings.position[mine], place[:2]), parameters.most_wall_loss)
        power, exponent = path_loss_line(readings.position[mine], readings.rssi[mine] + lost, place)
        point: dict[str, Any] = {
            "id": f"ap-{number}",
            "floor": "ground",
            "position": (float(place[0]), float(place[1]), float(place[2]) + PHONE_HEIGHT),
            "kind": kind,
            "power_1m": float(np.clip(power + 0.5 * parameters.body_loss, -110.0, 0.0)),
            "path_loss_exponent": float(np.clip(exponent, 1.0, 6.0)),
        }
        points.append(AccessPoint.model_validate(point))
    return Site(
        format="atrium-site/1",
        site="recorded",
        floors=[Floor(id="ground", outline=outline, walls=[[(float(x), float(y)) for x, y in wall] for wall in walls])],
        areas=[Area(id="all", floor="ground")],
        access_points=points,
    )


def counterpart(
    readings: Readings, fit: PathLossFit, kind: str, seed: int, parameters: RadioParameters, walls: Sequence[Array] = ()
) -> Readings:
    """Return what a phone of the twin reads at the recording's instants and places.

    One phone without offsets, since each recording was made with one; path-loss lines are the fitted ones, since the
    recording's own are asked for. All else is the twin's.
    """
    one_phone = {"device_sigma": 0.0, "antenna_sigma": 0.0, "power_sigma": 0.0, "exponent_sigma": 0.0}
    chosen = parameters.model_copy(update=one_phone)
    world = RadioWorld(site_of(readings, fit, kind, chosen, walls), seed, chosen)
    table = np.empty((len(readings.scan_t), readings.transmitters))
    start = readings.scan_t.min()
    for walk in np.unique(readings.scan_walk):
        mine = np.flatnonzero(readings.scan_walk == walk)
        mine = mine[np.argsort(readings.scan_t[mine], kind="stable")]
        heading = readings.scan_heading[mine]
        clear = np.flatnonzero(np.isfinite(heading))
        facing = heading[clear[np.abs(clear[:, None] - np.arange(len(mine))).argmin(axis=0)]] if len(clear) else None
        phone = world.phone(f"walk-{walk}")  # each walk fades in its own way
        table[mine] = phone.scan(readings.scan_t[mine] - start, readings.scan_position[mine], "ground", facing)
    # What a walk of the recording never heard is behind more than a line and shop windows: other storeys, other wings.
    heard = np.zeros((int(readings.scan_walk.max()) + 1, readings.transmitters), bool)
    heard[readings.walk, readings.transmitter] = True
    scan, transmitter = np.nonzero(np.isfinite(table) & heard[readings.scan_walk])
    return replace(
        readings,
        transmitter=transmitter,
        walk=readings.scan_walk[scan],
        scan=scan,
        t=readings.scan_t[scan],
        position=readings.scan_position[scan],
        heading=readings.scan_heading[scan],
        rssi=table[scan, transmitter],
    )
