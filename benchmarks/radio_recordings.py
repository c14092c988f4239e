"""What did real phones and beacons hear, where? Three recordings as one kind of table.

- ``ble-positions``: a beacon carried through a room and heard by twelve receivers, places true to 5 cm; and half hours
  at 45 points. Who sends and who receives is the other way round than in the twin; the air does not care.
- ``indoor-location``: a phone walked through a shopping mall, places interpolated between way-points (errors of a
  metre or two); where the access points hang is not known.
- ``rss-rooms``: readings at points of two rooms, phone and transmitters at rest, nobody else there.
"""

from __future__ import annotations

import gzip
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.spreadsheet import read_sheets

__all__ = ["Readings", "ble_points", "ble_walks", "mall_beacons", "mall_walls", "mall_wifi", "rooms"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

ADVERT = 0.4547
"""Seconds between two adverts of the beacon of ``ble-positions``."""


@dataclass(frozen=True, slots=True)
class Readings:
    """n readings of k transmitters.

    Attributes:
        transmitter: (n,), 0 … k - 1.
        walk: (n,), which walk, or which point where the phone was at rest.
        scan: (n,), which scan or advert; those of a walk follow each other.
        t: (n,), seconds.
        position: (n, 2), metres, of the moving side.
        heading: (n,), radians, where its carrier went; NaN where that is not clear.
        rssi: (n,), dBm.
        scan_walk: (s,), the walk of each scan, also of those in which nothing was heard.
        scan_t: (s,), seconds.
        scan_position: (s, 2), metres.
        scan_heading: (s,), radians.
        place: (k, 3), metres, of the transmitters relative to the height of the moving side; None where not known.
    """

    transmitter: Index
    walk: Index
    scan: Index
    t: Array
    position: Array
    heading: Array
    rssi: Array
    scan_walk: Index
    scan_t: Array
    scan_position: Array
    scan_heading: Array
    place: Array | None = None

    @property
    def transmitters(self) -> int:
        """How many transmitters."""
        return int(self.transmitter.max()) + 1


def ble_walks(data: Path) -> Readings:
    """Return the five walks of ``ble-positions``."""
    names, places = _receivers(data)
    parts = []
    for file in sorted((data / "ble-positions" / "trk").glob("*.mbd")):
        rows = [line.split(",") for line in file.read_text().split()]
        numbers = np.array([[float(row[0]), *map(float, row[3:7])] for row in rows])
        parts.append((numbers[:, 0], np.array([names.index(row[1]) for row in rows]), numbers[:, 1], numbers[:, 2:]))
    height = float(np.concatenate([part[3][:, 2] for part in parts]).mean())
    scans: list[tuple[Index, Index, Array, Array, Array]] = []
    rows_of: list[tuple[Index, Index, Array, Array]] = []
    first = 0
    for walk, (t, receiver, rssi, position) in enumerate(parts):
        # Adverts come at regular times; what comes within one interval is the same advert.
        number = np.round((t - t.min()) / ADVERT).astype(int)
        count = int(number.max()) + 1
        when = t.min() + ADVERT * np.arange(count)
        order = np.argsort(t)
        track = np.column_stack([np.interp(when, t[order], position[order, axis]) for axis in (0, 1)])
        scans.append((np.full(count, walk), number, when, track, heading_of(when, track, 0.4)))
        rows_of.append((receiver, first + number, t, rssi))
        first += count
    return _assembled(
        scans,
        np.concatenate([row[0] for row in rows_of]),
        np.concatenate([row[1] for row in rows_of]),
        np.concatenate([row[2] for row in rows_of]),
        np.concatenate([row[3] for row in rows_of]),
        places - [0.0, 0.0, height],
    )


def ble_points(data: Path, seconds: float = 300.0) -> Readings:
    """Return the first ``seconds`` at each of the 45 points of ``ble-positions``."""
    _, places = _receivers(data)
    aliases = sorted(alias for _, alias in _dongles(data).values())
    spot_of: dict[str, int] = {}
    began_at: list[float] = []
    rows = []
    with gzip.open(data / "ble-positions" / "hst" / "set_2_raw.csv.gz", "rt") as file:
        next(file)
        for line in file:
            x, y, z, alias, stamp, value = line.split(",")
            when = float(stamp)
            spot = spot_of.setdefault(f"{x},{y},{z}", len(began_at))
            if spot == len(began_at):
                began_at.append(when)
            if when < began_at[spot] + seconds + 60.0:  # receivers' rows are not quite in order
                rows.append((spot, aliases.index(alias), when, float(value)))
    spots = np.array([name.split(",") for name in spot_of], float)
    table = np.array(rows)
    walk, sensor = table[:, 0].astype(int), table[:, 1].astype(int)
    t, rssi = table[:, 2], table[:, 3]
    began = np.full(len(spots), np.inf)
    np.minimum.at(began, walk, t)
    keep = (rssi >= -110.0) & (rssi <= -20.0) & (t < began[walk] + seconds)
    count = int(seconds / ADVERT)
    number = np.minimum(np.round((t - began[walk]) / ADVERT).astype(int), count - 1)
    scans = [
        (
            np.full(count, spot),
            np.arange(count),
            began[spot] + ADVERT * np.arange(count),
            np.repeat(spots[spot : spot + 1, :2], count, axis=0),
            np.full(count, np.nan),
        )
        for spot in range(len(spots))
    ]
    scan = walk * count + number
    # The receivers sometimes tell one advert twice.
    _, once = np.unique(scan * len(aliases) + sensor, return_index=True)
    keep[np.setdiff1d(np.arange(len(keep)), once, assume_unique=True)] = False
    return _assembled(scans, sensor[keep], scan[keep], t[keep], rssi[keep], places - [0.0, 0.0, float(spots[0, 2])])


def mall_wifi(data: Path, radios: int = 80) -> Readings:
    """Return the Wi-Fi scans of ``indoor-location`` for the ``radios`` most heard radios that somebody came near to.

    A radio sends under several addresses; one of each is kept. What a scan repeats from an earlier one is left out.
    """
    return _mall(data, "TYPE_WIFI", radios, 150)


def mall_beacons(data: Path, radios: int = 40) -> Readings:
    """Return what ``indoor-location`` heard of iBeacons, told apart by address, as scans of a second."""
    return _mall(data, "TYPE_BEACON", radios, 100)


def mall_walls(data: Path) -> list[Array]:
    """Return the outlines of the shops of ``indoor-location``, closed lines (c, 2) in metres."""
    folder = data / "indoor-location" / "site1" / "F1"
    size = json.loads((folder / "floor_info.json").read_text())["map_info"]
    features = json.loads((folder / "geojson_map.json").read_text())["features"]
    outline = np.concatenate([np.array(ring) for part in features[0]["geometry"]["coordinates"] for ring in part])
    low, high = outline.min(axis=0), outline.max(axis=0)
    scale = np.array([size["width"], size["height"]]) / (high - low)
    return [
        (np.array(feature["geometry"]["coordinates"][0]) - low) * scale
        for feature in features[1:]
        if feature["geometry"]["type"] == "Polygon"
    ]


def rooms(data: Path, technology: str, scans: int = 150) -> tuple[Readings, list[Array]]:
    """Return what ``rss-rooms`` measured with BLE, WiFi or Zigbee on the grid of its first room, and at rest.

    Returns:
        the mean reading of each point and transmitter, with instants of ``scans`` scans at each point; and the
        sequences of readings of one transmitter at one point of the second room.
    """
    folder = data / "rss-rooms"
    rows = read_sheets(folder / "Scenario1" / "Database_Scenario1.xlsx")[technology]
    table = np.array([row[2:7] for row in rows[1:] if all(isinstance(cell, float) for cell in row[2:7])], float)
    count = len(table)
    point = np.repeat(np.arange(count), 3)
    scan_walk = np.repeat(np.arange(count), scans)
    readings = Readings(
        transmitter=np.tile(np.arange(3), count),
        walk=point,
        scan=point * scans,
        t=60.0 * point.astype(float),
        position=table[point, :2],
        heading=np.full(3 * count, np.nan),
        rssi=-np.abs(table[:, 2:]).ravel(),
        scan_walk=scan_walk,
        scan_t=60.0 * scan_walk.astype(float) + np.tile(0.3 * np.arange(scans, dtype=float), count),
        scan_position=table[scan_walk, :2],
        scan_heading=np.full(len(scan_walk), np.nan),
    )
    sequences = []
    for file in sorted((folder / "Scenario2" / technology / "Database").glob("*.txt")):
        text = file.read_text()
        for node in "ABC":
            values = np.array([float(value) for value in re.findall(rf"Node {node}: (-?\d+)", text)])
            sequences.append(values[(values < 0.0) & (values > -110.0)])
    return readings, sequences


def heading_of(t: Array, track: Array, reach: float, slowest: float = 0.15) -> Array:
    """Return where somebody on a ``track`` (n, 2) at times (n,) goes, (n,) radians; NaN where hardly anywhere."""
    ahead, behind = (
        np.column_stack([np.interp(t + shift, t, track[:, axis]) for axis in (0, 1)]) for shift in (reach, -reach)
    )
    step = ahead - behind
    heading: Array = np.where(np.hypot(*step.T) > 2.0 * reach * slowest, np.arctan2(step[:, 1], step[:, 0]), np.nan)
    return heading


def _dongles(data: Path) -> dict[str, tuple[Sequence[float], str]]:
    text = (data / "ble-positions" / "cnf" / "tetam.dev").read_text()
    line = next(line for line in text.splitlines() if line.startswith("Dongles:"))
    return {mac: (place, alias) for mac, (place, _, alias) in json.loads(line.partition(":")[2]).items()}


def _receivers(data: Path) -> tuple[list[str], Array]:
    """Return the receivers' addresses in the order of their aliases, and their places (k, 3)."""
    dongles = _dongles(data)
    names = sorted(dongles, key=lambda mac: dongles[mac][1])
    return names, np.array([dongles[mac][0] for mac in names], float)


def _mall(data: Path, kind: str, radios: int, least: int) -> Readings:
    wifi = kind == "TYPE_WIFI"
    files = sorted((data / "indoor-location" / "site1" / "F1" / "path_data_files").glob("*.txt.gz"))
    heard: list[tuple[int, int, float, str, float]] = []  # walk, scan, time, address, rssi
    scans: list[tuple[Index, Index, Array, Array, Array]] = []
    total = 0
    for walk, file in enumerate(files):
        points, rows = [], []
        with gzip.open(file, "rt", errors="replace") as lines:
            for line in lines:
                cell = line.rstrip("\n").split("\t")
                if len(cell) > 3 and cell[1] == "TYPE_WAYPOINT":
                    points.append((int(cell[0]) / 1e3, float(cell[2]), float(cell[3])))
                elif len(cell) > 6 and cell[1] == kind and wifi:
                    rows.append((int(cell[0]) / 1e3, int(cell[6]) / 1e3, cell[3] + cell[5], float(cell[4])))
                elif len(cell) > 8 and cell[1] == kind:
                    rows.append((float(int(cell[0]) // 1000), int(cell[0]) / 1e3, cell[8], float(cell[6])))
        way = np.array(sorted(points))
        rows = [row for row in rows if way[0, 0] <= row[1] <= way[-1, 0]]
        when = np.unique([row[0] for row in rows])
        if not len(when):
            continue
        if wifi:  # a scan is told when it is over; its middle is when most was heard
            middle = np.array([np.median([row[1] for row in rows if row[0] == one]) for one in when])
        else:
            middle = when + 0.5
        track = np.column_stack([np.interp(middle, way[:, 0], way[:, axis]) for axis in (1, 2)])
        scans.append((np.full(len(when), walk), np.arange(len(when)), middle, track, heading_of(middle, track, 1.5)))
        seen = set()
        for scan, t, address, rssi in rows:
            place = int(np.searchsorted(when, scan))
            if (address, t) not in seen and t > scan - 4.0:
                seen.add((address, t))
                heard.append((walk, total + place, float(middle[place]), address, rssi))
        total += len(when)
    best: dict[str, tuple[int, str]] = {}
    by_address: dict[str, list[tuple[int, int, float, str, float]]] = {}
    for row in heard:
        by_address.setdefault(row[3], []).append(row)
    for address, mine in sorted(by_address.items()):
        walks = len({row[0] for row in mine})
        radio = address[3:] if wifi else address
        if len(mine) >= least and max(row[4] for row in mine) >= -62.0 and walks >= 4:
            best[radio] = max(best.get(radio, (0, "")), (len(mine), address))
    chosen = [address for _, address in sorted(best.values(), reverse=True)[:radios]]
    column = {address: index for index, address in enumerate(chosen)}
    kept = [row for row in heard if row[3] in column]
    _, once = np.unique([row[1] * len(chosen) + column[row[3]] for row in kept], return_index=True)
    kept = [kept[index] for index in once]
    return _assembled(
        scans,
        np.array([column[row[3]] for row in kept]),
        np.array([row[1] for row in kept]),
        np.array([row[2] for row in kept]),
        np.array([row[4] for row in kept]),
        None,
    )


def _assembled(
    scans: list[tuple[Index, Index, Array, Array, Array]],
    transmitter: Index,
    scan: Index,
    t: Array,
    rssi: Array,
    place: Array | None,
) -> Readings:
    walk, _, when, track, heading = (np.concatenate([one[column] for one in scans]) for column in range(5))
    return Readings(
        transmitter, walk[scan], scan, t, track[scan], heading[scan], rssi, walk, when, track, heading, place
    )
