"""Is this batch one that a phone could have measured? Everything is checked before anything is used."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain

import numpy as np
from numpy.typing import NDArray

from services.gateway.errors import refuse
from services.gateway.protocol import Batch, RadioReadings
from services.gateway.reckoning.dead_reckoning import InertialSamples
from shared.messages import InertialColumns

__all__ = ["Limits", "check_batch"]

Array = NDArray[np.float64]

LATEST_CLOCK = 1e11
"""s; beyond it the clock counts milliseconds."""
AHEAD = 2.0
RANGES = {"a": (400.0, "m/s²"), "g": (50.0, "rad/s"), "m": (10_000.0, "µT")}
LARGEST = {
    (turned, compass): np.repeat([RANGES[kind][0] for kind in "a" + "g" * turned + "m" * compass], 3)[:, None]
    for turned in (False, True)
    for compass in (False, True)
}
"""By whether there is a gyroscope and a compass: (columns, 1)."""
SLOWEST = 0.2
"""s between samples, by the median: 5 Hz; between fewer nobody could tell steps."""
ENOUGH_FOR_UNITS = 50
"""Samples whose mean tells in which unit they are."""
GRAVITY_BETWEEN = (4.0, 30.0)
FASTEST_ON_AVERAGE = 17.0
"""rad/s; nobody turns a phone so for a second, while a walk in degrees/s is beyond it."""
WEAKEST, STRONGEST = -130.0, 20.0


@dataclass(frozen=True, slots=True)
class Limits:
    """How much one batch may hold."""

    samples: int = 12_000
    scans: int = 200
    readings: int = 500
    """Per scan."""
    address_length: int = 128
    age: float = 3600.0
    """Seconds before ``sent``."""


def check_batch(batch: Batch, limits: Limits) -> InertialSamples | None:
    """Return the inertial samples as arrays (None where the batch has none).

    Raises:
        RequestError: naming the first field that is wrong.
    """
    if not 0.0 <= batch.sent <= LATEST_CLOCK:
        refuse("sent", "is no time in seconds", batch.sent, f"0 to {LATEST_CLOCK:g} s (not milliseconds)")
    if not 0 <= batch.seq < 2**53:
        refuse("seq", "is out of range", batch.seq, "0 to 2^53")
    if batch.echo is not None:
        for name in ("replied", "arrived"):
            value = getattr(batch.echo, name)
            if not 0.0 <= value <= LATEST_CLOCK:
                refuse(f"echo.{name}", "is no time in seconds", value, f"0 to {LATEST_CLOCK:g} s")
    if batch.imu is None and not batch.radio:
        refuse("body", "the batch is empty", allowed="imu, radio or both")
    if len(batch.radio) > limits.scans:
        refuse("radio", "too many scans", len(batch.radio), f"at most {limits.scans}")
    for index, scan in enumerate(batch.radio):
        _check_scan(scan, f"radio[{index}]", batch.sent, limits)
    return None if batch.imu is None else _check_imu(batch.imu, batch.sent, limits)


def _check_scan(scan: RadioReadings, place: str, sent: float, limits: Limits) -> None:
    address, rssi = scan.address, scan.rssi
    if len(address) != len(rssi):
        refuse(f"{place}.rssi", "columns differ in length", len(rssi), f"{len(address)}, as address has")
    if len(address) > limits.readings:
        refuse(f"{place}.address", "too many readings", len(address), f"at most {limits.readings} in a scan")
    if not _earliest(sent, limits) <= scan.t <= sent + AHEAD:
        _refuse_time(scan.t, f"{place}.t", sent, limits)
    if address and not (min(rssi) >= WEAKEST and max(rssi) <= STRONGEST):
        index = next(index for index, value in enumerate(rssi) if not WEAKEST <= value <= STRONGEST)
        refuse(f"{place}.rssi[{index}]", "is no signal strength", rssi[index], f"{WEAKEST:g} to {STRONGEST:g} dBm")
    for index, text in enumerate(address):
        if not 0 < len(text) <= limits.address_length:
            refuse(f"{place}.address[{index}]", "is no address", text, f"1 to {limits.address_length} characters")


def _check_imu(imu: InertialColumns, sent: float, limits: Limits) -> InertialSamples:
    count = len(imu.t)
    if not 2 <= count <= limits.samples:
        refuse("imu.t", "wrong number of samples", count, f"2 to {limits.samples} (leave imu out when there are none)")
    turned, compass = bool(imu.gx or imu.gy or imu.gz), bool(imu.mx or imu.my or imu.mz)
    names = ("ax", "ay", "az") + ("gx", "gy", "gz") * turned + ("mx", "my", "mz") * compass
    columns = [getattr(imu, name) for name in names]
    for name, column in zip(names, columns, strict=True):
        if len(column) != count:
            refuse(f"imu.{name}", "columns differ in length", len(column), f"{count}, as imu.t has")
    t = _array(imu.t, count)
    if not (t.min() >= _earliest(sent, limits) and t.max() <= sent + AHEAD):
        index = int(np.argmin((t >= _earliest(sent, limits)) & (t <= sent + AHEAD)))
        _refuse_time(float(t[index]), f"imu.t[{index}]", sent, limits)
    spacing = np.diff(np.sort(t))
    if 2 * np.count_nonzero(spacing > SLOWEST) > len(spacing):
        usual = f"{np.median(spacing):.3g} s apart (median)"
        refuse(
            "imu.t", "samples are too far apart", usual, f"at most {SLOWEST:g} s; 50 to 100 samples a second are best"
        )
    values = _array(chain.from_iterable(columns), len(columns) * count).reshape(-1, count)
    allowed = np.abs(values) <= LARGEST[turned, compass]  # False for NaN
    if not allowed.all():
        row, index = (int(place) for place in np.unravel_index(np.argmin(allowed), allowed.shape))
        largest, unit = RANGES[names[row][0]]
        value = float(values[row, index])
        refuse(f"imu.{names[row]}[{index}]", "is out of range", value, f"{-largest:g} to {largest:g} {unit}")
    force, rate, field = values[:3], values[3:6] if turned else None, values[-3:] if compass else None
    if count >= ENOUGH_FOR_UNITS:
        _check_units(force, rate)
    return InertialSamples(t, force.T, None if rate is None else rate.T, None if field is None else field.T)


def _check_units(force: Array, rate: Array | None) -> None:
    usual = _rms(force)
    low, high = GRAVITY_BETWEEN
    if not low <= usual <= high:
        refuse("imu.ax", "not in m/s² with gravity", f"mean length {usual:.2f}", f"{low:g} to {high:g} on average")
    if rate is not None and _rms(rate) > FASTEST_ON_AVERAGE:
        allowed = f"at most {FASTEST_ON_AVERAGE:g} on average (degrees/s x 0.01745)"
        refuse("imu.gx", "not in rad/s", f"mean length {_rms(rate):.1f}", allowed)


def _rms(columns: Array) -> float:
    return math.sqrt(float(np.vdot(columns, columns)) / columns.shape[1])


def _earliest(sent: float, limits: Limits) -> float:
    return max(0.0, sent - limits.age)


def _refuse_time(t: float, place: str, sent: float, limits: Limits) -> None:
    allowed = f"{limits.age:g} s before sent ({sent:.3f}) to {AHEAD:g} s after it, on the same clock"
    refuse(place, "is no time of this batch", t, allowed)


@lru_cache(maxsize=256)
def _packer(count: int) -> struct.Struct:
    return struct.Struct(f"{count}d")


def _array(values: Iterable[float], count: int) -> Array:
    """Return numbers as an array, three times as quickly as NumPy does it: nothing is asked about each one's type."""
    return np.frombuffer(_packer(count).pack(*values))
