"""What fusion answers to ``rescore``, as far as the gate reads it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import msgspec

__all__ = ["DeviceTrial", "Trial", "pooled", "read_answer"]


class DeviceTrial(msgspec.Struct, frozen=True, kw_only=True):
    """One phone in a trial."""

    scans: int = 0
    gain: float | None = None
    """Nats per withheld reading, candidate minus active."""


class Trial(msgspec.Struct, frozen=True, kw_only=True):
    """A candidate beside the active model on held-out time; ``error`` alone where nothing could be tried.

    ``gain`` is in nats per withheld reading, candidate minus active, ``gain_error`` its standard error; ``scans`` were
    withheld, over ``seconds``; ``tracks_gain`` with its error is the part of it that is due to other tracks bearing the
    names, judged by both models; ``active_named`` and ``candidate_named`` are the shares of withheld readings that were
    taken while a track bore the phone's name; computing it ``took`` so many seconds.
    """

    error: str | None = None
    scans: int = 0
    seconds: float = 0.0
    took: float = 0.0
    gain: float | None = None
    gain_error: float | None = None
    active_named: float = 0.0
    candidate_named: float | None = None
    tracks_gain: float = 0.0
    tracks_gain_error: float | None = None
    devices: dict[str, DeviceTrial] = {}

    @property
    def spread(self) -> float | None:
        """Standard error of the gain; where fusion tells none, from how much the phones disagree."""
        if self.gain_error is not None:
            return self.gain_error
        rows = [(one.scans, one.gain) for one in self.devices.values() if one.gain is not None and one.scans > 0]
        if len(rows) < 2 or self.gain is None:
            return None
        total = sum(scans for scans, _ in rows)
        squares = sum((scans / total * (gain - self.gain)) ** 2 for scans, gain in rows)
        return math.sqrt(squares * len(rows) / (len(rows) - 1))


def read_answer(answer: Mapping[str, Any]) -> Trial:
    """Return the trial of an answer; what is no answer becomes a trial with an ``error``."""
    try:
        trial = msgspec.convert(answer, Trial)
    except msgspec.ValidationError as error:
        return Trial(error=f"fusion's answer is not understood: {error}")
    numbers = (
        *(trial.gain, trial.gain_error, trial.tracks_gain, trial.tracks_gain_error),
        *(trial.candidate_named, trial.active_named, trial.seconds, trial.took),
    )
    if trial.error is None and not all(number is None or math.isfinite(number) for number in numbers):
        return Trial(error="fusion's answer is not understood: a number is not finite")
    return trial


def pooled(trials: Sequence[Trial]) -> Trial:
    """Return one trial over the time of several that do not overlap, each counted by its scans.

    Raises:
        ValueError: there is none, or one of them tried nothing.
    """
    if len(trials) == 1 and trials[0].error is None:
        return trials[0]
    if not trials or any(one.error is not None or one.gain is None for one in trials):
        raise ValueError("trials: one that tried nothing, or none at all; allowed: one or more with a gain")
    weight = [one.scans for one in trials]
    total = sum(weight)
    devices: dict[str, list[tuple[float, float]]] = {}
    for one in trials:
        for name, device in one.devices.items():
            if device.gain is not None:
                devices.setdefault(name, []).append((device.scans, device.gain))
    named = [one.active_named if one.candidate_named is None else one.candidate_named for one in trials]
    return Trial(
        scans=total,
        seconds=sum(one.seconds for one in trials),
        gain=_mean([(scans, one.gain or 0.0) for scans, one in zip(weight, trials, strict=True)]),
        gain_error=_error([one.spread for one in trials], weight),
        tracks_gain=_mean([(scans, one.tracks_gain) for scans, one in zip(weight, trials, strict=True)]),
        tracks_gain_error=_error([one.tracks_gain_error for one in trials], weight),
        active_named=_mean([(scans, one.active_named) for scans, one in zip(weight, trials, strict=True)]),
        candidate_named=_mean(list(zip(weight, named, strict=True))),
        devices={
            name: DeviceTrial(scans=int(sum(scans for scans, _ in rows)), gain=_mean(rows))
            for name, rows in devices.items()
        },
    )


def _mean(rows: Sequence[tuple[float, float]]) -> float:
    total = sum(weight for weight, _ in rows)
    return sum(weight * value for weight, value in rows) / total if total else 0.0


def _error(errors: Sequence[float | None], weight: Sequence[int]) -> float | None:
    """Return the standard error of a weighted mean; None where that of a part is not known."""
    known = [error * scans for error, scans in zip(errors, weight, strict=True) if error is not None]
    total = sum(weight)
    return math.hypot(*known) / total if len(known) == len(errors) and total else None
