"""What goes wrong, and when? Faults on demand, applied to what cameras and phones of a healthy world would have sent.

Every draw is a pure function of seed, fault and message number, so that a world is the same however it is cut into
blocks, and one more fault changes nothing about the others. What is lost stays lost; what is late comes later than it
was measured, never earlier. Nothing here reads a clock.
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Iterator, Sequence
from typing import Annotated, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from services.simulator.phones.phone_batch import ClockJump, Inertial, PhoneBatch
from shared.keys import is_identifier
from shared.messages import DetectionFrame
from shared.site.site_file import Number, Part

__all__ = [
    "CameraClock",
    "CameraFaults",
    "CameraOff",
    "DuplicateBatches",
    "Fault",
    "FramesLate",
    "PhoneClockFault",
    "PhoneFaults",
    "PhoneGone",
    "SwappedBatches",
    "unknown_phones",
]

_CATCHING_UP = 2.0  # seconds at least in which a phone that is back sends what waited
_ALL = "*"


def _camera(name: str) -> str:
    if name != _ALL and not is_identifier(name):
        raise ValueError("must be a camera of the site, or '*' for each of them")
    return name


def _phone(value: object) -> object:
    # YAML's true is not phone 1.
    if isinstance(value, bool) or not (isinstance(value, str) or (isinstance(value, int) and value >= 0)):
        raise ValueError("must be a person's id, the place of a phone counted from 0, or '*' for all of them")
    return value


_Camera = Annotated[str, AfterValidator(_camera), Field(description="a camera of the site; *: each of them")]
_Phone = Annotated[int | str, BeforeValidator(_phone)]


class _During(Part):
    """From when to when, world seconds."""

    start: Number = Field(0.0, ge=0, description="when it begins, s")
    end: Number | None = Field(None, gt=0, description="when it is over, s; null: never")

    @model_validator(mode="after")
    def _in_order(self) -> _During:
        if self.end is not None and self.end <= self.start:
            raise ValueError(f"end is {self.end:g}, allowed is after start = {self.start:g} s")
        return self

    def covers(self, t: float) -> bool:
        """Whether it is on at world time ``t``."""
        return self.start <= t and (self.end is None or t < self.end)


class CameraOff(_During):
    """A camera says nothing."""

    kind: Literal["camera-off"]
    camera: _Camera


class FramesLate(_During):
    """Some frames come late, after later ones."""

    kind: Literal["frames-late"]
    camera: _Camera
    share: Number = Field(0.1, ge=0, le=1, description="of the frames that are late")
    delay: tuple[Number, Number] = Field((0.1, 1.0), description="least and greatest delay, s")

    @model_validator(mode="after")
    def _delays_in_order(self) -> FramesLate:
        _check_range("delay", self.delay, 600.0)
        return self


class CameraClock(Part):
    """A camera's clock is wrong: its frames are stamped ahead of the truth by an offset that grows."""

    kind: Literal["camera-clock"]
    camera: _Camera
    offset: Number = Field(0.0, ge=-86_400, le=86_400, description="at world second zero, s")
    drift_ppm: Number = Field(0.0, ge=-10_000, le=10_000, description="by which the clock is fast")


class _OfPhone(Part):
    phone: _Phone = Field(_ALL, description="a person's id, or the place of a phone counted from 0; *: each of them")


class PhoneGone(_OfPhone):
    """A phone is off or out of reach."""

    kind: Literal["phone-gone"]
    start: Number = Field(ge=0, description="when it goes, s")
    end: Number = Field(gt=0, description="when it is back, s")
    lost: bool = Field(True, description="true: nothing is measured meanwhile; false: it is measured and sent later")

    @model_validator(mode="after")
    def _in_order(self) -> PhoneGone:
        if self.end <= self.start:
            raise ValueError(f"end is {self.end:g}, allowed is after start = {self.start:g} s")
        return self

    def caught_up(self, t: float) -> float:
        """Return when what should happen at ``t`` does: what waited goes out in quick order once the phone is back."""
        hurry = max(_CATCHING_UP, 0.1 * (self.end - self.start))
        if not self.start <= t < self.end + hurry:
            return t
        return self.end + hurry * (t - self.start) / (self.end + hurry - self.start)


class PhoneClockFault(_OfPhone):
    """A phone's clock jumps and runs faster or slower from then on."""

    kind: Literal["phone-clock"]
    offset: Number = Field(0.0, ge=-1e7, le=1e7, description="by which it jumps ahead, s")
    drift_ppm: Number = Field(0.0, ge=-10_000, le=10_000, description="by which it is faster from then on")
    at: Number = Field(0.0, ge=0, description="when, s")


class DuplicateBatches(_OfPhone):
    """Some batches are sent twice, as an app does that has not heard the reply."""

    kind: Literal["duplicate-batches"]
    share: Number = Field(0.1, ge=0, le=1, description="of the batches that come twice")
    after: tuple[Number, Number] = Field((0.5, 3.0), description="how long after the first the second comes, s")

    @model_validator(mode="after")
    def _after_in_order(self) -> DuplicateBatches:
        _check_range("after", self.after, 3600.0)
        return self


class SwappedBatches(_OfPhone):
    """Some batches are overtaken by the one or two that follow them."""

    kind: Literal["swapped-batches"]
    share: Number = Field(0.1, ge=0, le=1, description="of the batches that are overtaken")
    delay: tuple[Number, Number] = Field((1.2, 2.5), description="by which they come later, s")

    @model_validator(mode="after")
    def _delays_in_order(self) -> SwappedBatches:
        _check_range("delay", self.delay, 3600.0)
        return self


AnyFault = CameraOff | FramesLate | CameraClock | PhoneGone | PhoneClockFault | DuplicateBatches | SwappedBatches
Fault = Annotated[AnyFault, Field(discriminator="kind")]


class CameraFaults:
    """The faults of all cameras.

    Args:
        faults: of cameras and phones; those of phones are no concern here.
        seed: decides which frames.
    """

    def __init__(self, faults: Sequence[AnyFault], seed: int) -> None:
        self._faults = [
            (fault, number)
            for number, fault in enumerate(faults)
            if isinstance(fault, CameraOff | FramesLate | CameraClock)
        ]
        self._seed = seed

    def arrivals(self, camera: str, frames: Sequence[DetectionFrame]) -> list[tuple[float, DetectionFrame]]:
        """Return when each frame arrives, in order of arrival, and what it says; lost frames are left out.

        Args:
            camera: whose frames they are.
            frames: in order; ``t`` in world seconds, at which a healthy frame arrives.
        """
        arriving = [(frame.t, frame) for frame in frames]
        mine = [(fault, number) for fault, number in self._faults if fault.camera in (camera, _ALL)]
        if not mine or not frames:
            return arriving
        when = np.array([frame.t for frame in frames])
        kept = np.ones(len(frames), bool)
        delay, ahead = np.zeros(len(frames)), np.zeros(len(frames))
        seq = np.array([frame.seq for frame in frames])
        for fault, number in mine:
            if isinstance(fault, CameraClock):
                ahead += fault.offset + 1e-6 * fault.drift_ppm * when
                continue
            on = np.array([fault.covers(t) for t in when.tolist()])
            if isinstance(fault, CameraOff):
                kept &= ~on
            else:
                late = on & (self._draw(number, "share", camera, seq) < fault.share)
                delay += np.where(late, _within(fault.delay, self._draw(number, "delay", camera, seq)), 0.0)
        arriving = [
            (t + waits, frame if not shift else msgspec.structs.replace(frame, t=frame.t + shift))
            for (t, frame), keeps, waits, shift in zip(arriving, kept, delay.tolist(), ahead.tolist(), strict=True)
            if keeps
        ]
        return sorted(arriving, key=lambda entry: entry[0])

    def _draw(self, number: int, what: str, camera: str, seq: NDArray[np.int64]) -> NDArray[np.float64]:
        return _uniform(_key(self._seed, str(number), what, camera), seq)


class PhoneFaults:
    """The faults of all phones.

    Args:
        faults: of cameras and phones; those of cameras are no concern here.
        seed: decides which batches.
        persons: who carries the phones, in the order in which faults count them.

    Raises:
        ValueError: a fault names a phone that does not exist.
    """

    def __init__(self, faults: Sequence[AnyFault], seed: int, persons: Sequence[str]) -> None:
        self._seed = seed
        self._of: dict[str, list[tuple[AnyFault, int]]] = {person: [] for person in persons}
        for number, fault in enumerate(faults):
            if isinstance(fault, _OfPhone):
                meant = _meant(fault.phone, persons)
                if meant is None:
                    raise ValueError(_nobodys(fault.phone, number, persons))
                for person in meant:
                    self._of[person].append((fault, number))
        self._gone = {
            person: sorted((fault for fault, _ in found if isinstance(fault, PhoneGone)), key=lambda gone: gone.start)
            for person, found in self._of.items()
        }

    def arrivals(self, batches: Sequence[PhoneBatch]) -> list[PhoneBatch]:
        """Return the batches as they arrive, in order of arrival; copies bear the number of what they copy."""
        arriving: list[PhoneBatch] = []
        for batch in batches:
            arriving += self._through(batch)
        return sorted(arriving, key=lambda batch: batch.arrival)

    def _through(self, batch: PhoneBatch) -> list[PhoneBatch]:
        faults = self._of.get(batch.person, [])
        copies: list[PhoneBatch] = []
        # First what is measured, then when it is sent, then what the network makes of it.
        for fault, _ in faults:
            if isinstance(fault, PhoneClockFault):
                jump = ClockJump(fault.at, fault.offset, 1e-6 * fault.drift_ppm)
                clock = dataclasses.replace(batch.clock, jumps=(*batch.clock.jumps, jump))
                batch = dataclasses.replace(batch, clock=clock)
            elif isinstance(fault, PhoneGone) and fault.lost:
                found = _without(batch, fault.start, fault.end)
                if found is None:
                    return []
                batch = found
        batch = self._put_off(batch)
        for fault, number in faults:
            if isinstance(fault, SwappedBatches) and self._draw(number, "share", batch) < fault.share:
                delay = _within(fault.delay, np.array([self._draw(number, "delay", batch)]))
                batch = dataclasses.replace(batch, arrival=batch.arrival + float(delay[0]))
        for fault, number in faults:
            if isinstance(fault, DuplicateBatches) and self._draw(number, "share", batch) < fault.share:
                after = _within(fault.after, np.array([self._draw(number, "after", batch)]))
                copies.append(self._put_off(_later(batch, float(after[0]))))
        return [batch, *copies]

    def _put_off(self, batch: PhoneBatch) -> PhoneBatch:
        """Return the batch as it is sent where its phone is off at times: what waits for one end may meet the next."""
        for gone in self._gone.get(batch.person, []):
            if batch.sent >= gone.start:
                sent, arrival = gone.caught_up(batch.sent), gone.caught_up(batch.arrival)
                if (sent, arrival) != (batch.sent, batch.arrival):
                    batch = dataclasses.replace(batch, sent=sent, arrival=arrival)
        return batch

    def _draw(self, number: int, what: str, batch: PhoneBatch) -> float:
        key = _key(self._seed, str(number), what, batch.person)
        return float(_uniform(key, np.array([batch.seq]))[0])


def unknown_phones(faults: Sequence[AnyFault], persons: Sequence[str]) -> Iterator[str]:
    """Yield, in words, what is wrong with every fault of a phone that does not exist.

    Args:
        faults: of cameras and phones.
        persons: who carries the phones, in the order in which faults count them.
    """
    for number, fault in enumerate(faults):
        if isinstance(fault, _OfPhone) and _meant(fault.phone, persons) is None:
            yield _nobodys(fault.phone, number, persons)


def _meant(phone: int | str, persons: Sequence[str]) -> Sequence[str] | None:
    """Return whose phones are meant; None: there is no such phone."""
    if phone == _ALL:
        return persons
    if isinstance(phone, int):
        return [persons[phone]] if phone < len(persons) else None
    return [phone] if phone in persons else None


def _nobodys(phone: int | str, number: int, persons: Sequence[str]) -> str:
    if isinstance(phone, int):
        problem, known = f"there is no phone {phone}", f"0 to {len(persons) - 1}"
    else:
        more = ", …" if len(persons) > 20 else ""
        problem, known = f"{phone!r} carries no phone", ", ".join(persons[:20]) + more
    return f"faults[{number}].phone: {problem}; allowed: {known if persons else 'nobody'}, or '*' for all"


def _later(batch: PhoneBatch, delay: float) -> PhoneBatch:
    return dataclasses.replace(batch, sent=batch.sent + delay, arrival=batch.arrival + delay)


def _without(batch: PhoneBatch, start: float, end: float) -> PhoneBatch | None:
    """Return the batch without what was measured in [start, end); None if nothing is left."""
    inertial = batch.inertial
    if inertial is not None:
        kept = (inertial.t < start) | (inertial.t >= end)
        if not kept.all():
            inertial = Inertial(inertial.t[kept], inertial.values[kept]) if kept.sum() >= 2 else None
    scans = tuple(scan for scan in batch.scans if not start <= scan.t < end)
    if inertial is batch.inertial and len(scans) == len(batch.scans):
        return batch
    return dataclasses.replace(batch, inertial=inertial, scans=scans) if inertial is not None or scans else None


def _check_range(name: str, value: tuple[float, float], most: float) -> None:
    low, high = value
    if not 0.0 <= low <= high <= most:
        raise ValueError(f"{name} is [{low:g}, {high:g}], allowed is 0 <= least <= greatest <= {most:g} s")


def _within(bounds: tuple[float, float], share: NDArray[np.float64]) -> NDArray[np.float64]:
    return bounds[0] + (bounds[1] - bounds[0]) * share


def _key(seed: int, *names: str) -> np.uint64:
    key = np.random.SeedSequence([seed, *(zlib.crc32(name.encode()) for name in names)]).generate_state(1, np.uint64)
    return np.uint64(key[0])


def _uniform(key: np.uint64, index: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return numbers in [0, 1) that look random, one for each (key, index): SplitMix64 (Steele et al., 2014)."""
    with np.errstate(over="ignore"):
        z = key + index.astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z = z ^ (z >> np.uint64(31))
    uniform: NDArray[np.float64] = (z >> np.uint64(11)).astype(float) / 2.0**53
    return uniform
