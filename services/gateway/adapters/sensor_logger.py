"""What does the Sensor Logger app push over HTTP? ``{messageId, sessionId, payload: [{name, time, values}]}``.

``time`` is in nanoseconds since 1970 on the phone's clock; every sensor has stamps of its own. Acceleration comes
without gravity (``accelerometer``, beside ``gravity``) and, on Android, with it (``totalacceleration``). iOS counts
both the other way round, unless the app's "Standardise Units & Frames" is on, and no field tells: the URL must.

Source: the app's documentation (github.com/tszheichoi/awesome-sensor-logger: PUSHING, UNITS, COORDINATES,
CROSSPLATFORM).
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.gateway.adapters.adapter import RSSI, Push, number
from services.gateway.errors import read_json, refuse
from services.gateway.phones.batch_check import (
    AHEAD,
    ENOUGH_FOR_UNITS,
    FASTEST_ON_AVERAGE,
    GRAVITY_BETWEEN,
    LATEST_CLOCK,
    RANGES,
    Limits,
)
from services.gateway.protocol import Batch, RadioReadings
from shared.messages import InertialColumns

__all__ = ["Frame", "SensorLogger", "SensorLoggerPush"]

Array = NDArray[np.float64]
Frame = Literal["android", "ios"]

STANDARD_GRAVITY = 9.80665
IN_G_BELOW = 4.0
"""Mean length of uncalibrated acceleration below which it is in g: iOS, and with its signs."""
SENSORS = {
    "accelerometer": "a",
    "accelerometeruncalibrated": "a",
    "totalacceleration": "a",
    "gravity": "a",
    "gyroscope": "g",
    "gyroscopeuncalibrated": "g",
    "magnetometer": "m",
    "magnetometeruncalibrated": "m",
}
"""Sensors of three axes, and the range of their values."""
NEAR = {"gravity": 0.1, "gyroscope": 0.1, "magnetometer": 0.5}
"""s: how far from a sample of that sensor an acceleration may lie to be given its value. Gravity and rotation come as
often as acceleration, compasses of some phones at 5 Hz."""
SCAN = 1.0
"""s: radio readings closer than this belong to one scan."""


class SensorLoggerEntry(msgspec.Struct, frozen=True):
    """One sample of one sensor. An entry that is of no use here may hold anything."""

    name: Any = None
    """Which sensor, text."""
    time: Any = None
    """ns since 1970, phone clock: a number."""
    values: Any = None
    """By name: ``x``, ``y``, ``z`` of a sensor of three axes."""


class SensorLoggerPush(msgspec.Struct, frozen=True, rename="camel"):
    """Body of the app's pushes, as far as it is used."""

    payload: list[SensorLoggerEntry]
    message_id: int
    """Counts the pushes of a recording."""
    session_id: str = ""
    """Of the recording."""


class SensorLogger:
    """Turns pushes of the app into batches.

    Args:
        frame: ``ios`` for an iPhone whose "Standardise Units & Frames" is off.
    """

    name = "sensor-logger"

    def __init__(self, frame: Frame = "android") -> None:
        self._sign = -1.0 if frame == "ios" else 1.0

    def decode(self, payload: bytes, limits: Limits) -> Push:
        """Return the batch that a push holds. ``sent`` is its newest stamp, since the app tells no other.

        Raises:
            RequestError: 400 where it is not JSON, 422 naming the field that is wrong.
        """
        body = read_json(payload, SensorLoggerPush)
        ignored: Counter[str] = Counter()
        streams: dict[str, list[tuple[float, float, float, float]]] = {}
        radio: dict[Literal["wifi", "ble"], list[tuple[float, str, float]]] = {"wifi": [], "ble": []}
        for index, entry in enumerate(body.payload):
            place = f"payload[{index}]"
            name = entry.name.lower() if isinstance(entry.name, str) else ""
            used = name in SENSORS or name == "wifi" or name.startswith("bluetooth")
            if used and not isinstance(entry.values, dict):
                ignored["entry without its values"] += 1
            elif name in SENSORS:
                row = _row(entry, place, SENSORS[name])
                if row is None:
                    ignored["entry without its values"] += 1
                else:
                    streams.setdefault(name, []).append(row)
            elif name == "wifi":
                _radio_row(entry, place, ("bssid", "level"), limits, radio["wifi"], ignored)
            elif name == "bluetooth" or name.startswith("bluetooth-"):
                _radio_row(entry, place, ("id", "rssi"), limits, radio["ble"], ignored)
            else:
                ignored["sensor of no use here"] += 1
        imu = self._inertial({name: _in_order(rows, ignored) for name, rows in streams.items()}, limits, ignored)
        key = (body.session_id, str(body.message_id))
        batch = _batch(imu, radio, limits, ignored)
        return Push(batch, key, dict(+ignored))

    def _inertial(
        self, streams: dict[str, tuple[Array, Array]], limits: Limits, ignored: Counter[str]
    ) -> tuple[Array, Array, Array, Array | None] | None:
        """Return stamps (n,), acceleration with gravity, rotation, magnetic field, each (n, 3), on common rows."""
        found = self._acceleration(streams, ignored)
        if found is None:
            return None
        t, acceleration = found
        rotation = streams.get("gyroscope", streams.get("gyroscopeuncalibrated"))
        if rotation is None:
            ignored["acceleration without gyroscope"] += len(t)
            return None
        beside = _near(t, rotation[0], NEAR["gyroscope"])
        ignored["acceleration without gyroscope"] += int(np.count_nonzero(~beside))
        t, acceleration = t[beside], acceleration[beside]
        if len(t) < 2:
            ignored["acceleration without gyroscope"] += len(t)
            return None
        turning = _at(t, *rotation)
        _check_rows(t, acceleration, turning, limits)
        field = streams.get("magnetometer", streams.get("magnetometeruncalibrated"))
        at_rows: Array | None = None
        if field is not None and _near(t, field[0], NEAR["magnetometer"]).all():
            at_rows = _at(t, *field)
        elif field is not None:
            ignored["magnetic field with gaps"] += len(field[0])
        return t, acceleration, turning, at_rows

    def _acceleration(
        self, streams: dict[str, tuple[Array, Array]], ignored: Counter[str]
    ) -> tuple[Array, Array] | None:
        """Return acceleration with gravity, signs as Android has them, from what was switched on."""
        if "totalacceleration" in streams:
            return streams["totalacceleration"]
        if "accelerometer" in streams and "gravity" in streams:
            t, linear = streams["accelerometer"]
            beside = _near(t, streams["gravity"][0], NEAR["gravity"])
            ignored["acceleration without gravity"] += int(np.count_nonzero(~beside))
            t = t[beside]
            return t, self._sign * (linear[beside] + _at(t, *streams["gravity"]))
        if "accelerometeruncalibrated" in streams:
            t, raw = streams["accelerometeruncalibrated"]
            in_g = float(np.mean(np.linalg.norm(raw, axis=1))) < IN_G_BELOW
            return t, raw * -STANDARD_GRAVITY if in_g else raw
        if "accelerometer" in streams:
            ignored["acceleration without gravity"] += len(streams["accelerometer"][0])
        return None


def _seconds(entry: SensorLoggerEntry, place: str) -> float:
    return number(entry.time, f"{place}.time", (0.0, LATEST_CLOCK * 1e9, "ns")) / 1e9


def _row(entry: SensorLoggerEntry, place: str, kind: str) -> tuple[float, float, float, float] | None:
    values = entry.values
    largest, unit = RANGES[kind]
    allowed = (-largest, largest, unit)
    x, y, z = values.get("x"), values.get("y"), values.get("z")
    if x is None or y is None or z is None:
        return None
    place_of = f"{place}.values"
    return (
        _seconds(entry, place),
        number(x, f"{place_of}.x", allowed),
        number(y, f"{place_of}.y", allowed),
        number(z, f"{place_of}.z", allowed),
    )


def _radio_row(
    entry: SensorLoggerEntry,
    place: str,
    names: tuple[str, str],
    limits: Limits,
    rows: list[tuple[float, str, float]],
    ignored: Counter[str],
) -> None:
    address, level = (entry.values.get(name) for name in names)
    if address is None or level is None:
        ignored["entry without its values"] += 1
        return
    if not isinstance(address, str) or not 0 < len(address) <= limits.address_length:
        allowed = f"1 to {limits.address_length} characters"
        refuse(f"{place}.values.{names[0]}", "is no address", type(address).__name__, allowed)
    rows.append((_seconds(entry, place), address, number(level, f"{place}.values.{names[1]}", RSSI)))


def _in_order(rows: Sequence[tuple[float, ...]], ignored: Counter[str]) -> tuple[Array, Array]:
    """Return stamps (n,), increasing, and values (n, 3); of rows with one stamp the first stays."""
    table = np.array(rows)
    t, first = np.unique(table[:, 0], return_index=True)
    ignored["stamp told twice"] += len(table) - len(t)
    return t, table[first, 1:]


def _near(t: Array, other: Array, reach: float) -> NDArray[np.bool_]:
    """Return which of ``t`` have a stamp of ``other`` within ``reach`` before and after, or at one end."""
    after = np.clip(np.searchsorted(other, t), 0, len(other) - 1)
    before = np.clip(after - 1, 0, len(other) - 1)
    near: NDArray[np.bool_] = np.minimum(np.abs(other[after] - t), np.abs(other[before] - t)) <= reach
    return near


def _at(t: Array, other: Array, values: Array) -> Array:
    """Return ``values`` (n, 3) of stamps ``other``, linear in between, at the stamps ``t``."""
    return np.stack([np.interp(t, other, values[:, axis]) for axis in range(3)], axis=1)


def _check_rows(t: Array, acceleration: Array, rotation: Array, limits: Limits) -> None:
    if len(t) > limits.samples:
        refuse("payload", "too many samples of acceleration", len(t), f"at most {limits.samples}")
    if t[0] < t[-1] - limits.age:
        refuse("payload", "time spans too long", f"{t[-1] - t[0]:.3f} s", f"at most {limits.age:g} s in a push")
    if len(t) < ENOUGH_FOR_UNITS:
        return
    force, rate = (float(np.mean(np.linalg.norm(values, axis=1))) for values in (acceleration, rotation))
    low, high = GRAVITY_BETWEEN
    if not low <= force <= high:
        allowed = f"{low:g} to {high:g} m/s² on average"
        refuse("payload", "acceleration is not in m/s² with gravity", f"mean length {force:.2f}", allowed)
    if rate > FASTEST_ON_AVERAGE:
        allowed = f"at most {FASTEST_ON_AVERAGE:g} rad/s on average"
        refuse("payload", "gyroscope is not in rad/s", f"mean length {rate:.1f}", allowed)


def _batch(
    imu: tuple[Array, Array, Array, Array | None] | None,
    radio: dict[Literal["wifi", "ble"], list[tuple[float, str, float]]],
    limits: Limits,
    ignored: Counter[str],
) -> Batch | None:
    stamps = [row[0] for rows in radio.values() for row in rows]
    if imu is None and not stamps:
        return None
    newest = float(imu[0][-1]) if imu is not None else max(stamps)
    scans: list[RadioReadings] = []
    for kind, rows in radio.items():
        kept = [row for row in rows if newest - limits.age <= row[0] <= newest + AHEAD]
        ignored["radio of another time"] += len(rows) - len(kept)
        scans += [_scan(kind, group, limits) for group in _groups(kept)]
    if len(scans) > limits.scans:
        refuse("payload", "too many radio scans", len(scans), f"at most {limits.scans}")
    sent = max([newest, *(scan.t for scan in scans)])
    return Batch(sent=sent, seq=0, imu=None if imu is None else _columns(*imu), radio=scans)


def _groups(rows: Iterable[tuple[float, str, float]]) -> list[list[tuple[float, str, float]]]:
    """Cut readings into scans: a new one begins ``SCAN`` after the one before began."""
    groups: list[list[tuple[float, str, float]]] = []
    for row in sorted(rows):
        if not groups or row[0] >= groups[-1][0][0] + SCAN:
            groups.append([])
        groups[-1].append(row)
    return groups


def _scan(kind: Literal["wifi", "ble"], rows: list[tuple[float, str, float]], limits: Limits) -> RadioReadings:
    if len(rows) > limits.readings:
        refuse("payload", f"too many {kind} entries in one second", len(rows), f"at most {limits.readings}")
    return RadioReadings(t=rows[-1][0], kind=kind, address=[row[1] for row in rows], rssi=[row[2] for row in rows])


def _columns(t: Array, acceleration: Array, rotation: Array, field: Array | None) -> InertialColumns:
    columns = {"t": t.tolist()}
    for letter, values in (("a", acceleration), ("g", rotation), ("m", field)):
        if values is not None:
            columns |= {f"{letter}{axis}": values[:, i].tolist() for i, axis in enumerate("xyz")}
    return InertialColumns(**columns)
