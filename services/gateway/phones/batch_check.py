"""Is this batch one that a phone could have measured? Everything is checked before anything is used."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

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
RANGES = {"a": (-400.0, 400.0, "m/s²"), "g": (-50.0, 50.0, "rad/s"), "m": (-10_000.0, 10_000.0, "µT")}
GRAVITY_BETWEEN = (4.0, 30.0)
ENOUGH_FOR_GRAVITY = 50


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
    if len(scan.address) != len(scan.rssi):
        refuse(f"{place}.rssi", "columns differ in length", len(scan.rssi), f"{len(scan.address)}, as address has")
    if len(scan.address) > limits.readings:
        refuse(f"{place}.address", "too many readings", len(scan.address), f"at most {limits.readings} in a scan")
    _check_times(np.array([scan.t]), f"{place}.t", sent, limits, single=True)
    for index, rssi in enumerate(scan.rssi):
        if not -130.0 <= rssi <= 20.0:
            refuse(f"{place}.rssi[{index}]", "is no signal strength", rssi, "-130 to 20 dBm")
    for index, address in enumerate(scan.address):
        if not 0 < len(address) <= limits.address_length:
            refuse(f"{place}.address[{index}]", "is no address", address, f"1 to {limits.address_length} characters")


def _check_imu(imu: InertialColumns, sent: float, limits: Limits) -> InertialSamples:
    count = len(imu.t)
    if not 2 <= count <= limits.samples:
        refuse("imu.t", "wrong number of samples", count, f"2 to {limits.samples} (leave imu out when there are none)")
    given = [name for name in ("mx", "my", "mz") if getattr(imu, name)]
    names = ["ax", "ay", "az", "gx", "gy", "gz", *(("mx", "my", "mz") if given else ())]
    for name in names:
        if len(getattr(imu, name)) != count:
            refuse(f"imu.{name}", "columns differ in length", len(getattr(imu, name)), f"{count}, as imu.t has")
    t = np.array(imu.t)
    _check_times(t, "imu.t", sent, limits)
    columns = {name: _within(getattr(imu, name), f"imu.{name}", RANGES[name[0]]) for name in names}
    acceleration = _stack(columns, "ax", "ay", "az")
    if count >= ENOUGH_FOR_GRAVITY:
        mean = float(np.mean(np.sqrt(np.einsum("ij,ij->i", acceleration, acceleration))))
        low, high = GRAVITY_BETWEEN
        if not low <= mean <= high:
            refuse("imu.ax", "not in m/s² with gravity", f"mean length {mean:.2f}", f"{low:g} to {high:g} on average")
    field = _stack(columns, "mx", "my", "mz") if given else None
    return InertialSamples(t, acceleration, _stack(columns, "gx", "gy", "gz"), field)


def _stack(columns: dict[str, Array], *names: str) -> Array:
    return np.stack([columns[name] for name in names], axis=1)


def _within(values: Sequence[float], place: str, allowed: tuple[float, float, str]) -> Array:
    column = np.array(values)
    low, high, unit = allowed
    bad = ~((column >= low) & (column <= high))
    if bad.any():
        index = int(np.argmax(bad))
        refuse(f"{place}[{index}]", "is out of range", float(column[index]), f"{low:g} to {high:g} {unit}")
    return column


def _check_times(t: Array, place: str, sent: float, limits: Limits, single: bool = False) -> None:
    bad = ~((t >= max(0.0, sent - limits.age)) & (t <= sent + AHEAD))
    if bad.any():
        index = int(np.argmax(bad))
        allowed = f"{limits.age:g} s before sent ({sent:.3f}) to {AHEAD:g} s after it, on the same clock"
        refuse(place if single else f"{place}[{index}]", "is no time of this batch", float(t[index]), allowed)
