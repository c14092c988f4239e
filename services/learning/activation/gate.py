"""Does a candidate go live? A pure decision on what fusion says of it and the active model on held-out time.

It must be hard to fool. A gain has to be larger than chance makes it *and* large enough to be worth a change; no phone
alone may carry it, since one that posts invented radio would be that phone; none may be ruined for it; and no names may
be lost, for whoever is named less often is wrong less often too. Where there is too little to tell, it says so.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from services.learning.activation.answer import DeviceTrial, Trial, pooled
from services.learning.proposal import Proposal

__all__ = ["Gate", "GateSettings", "Ruling"]

LATER = ("busy", "scans:", "somebody withdrew", "fusion of area", "camera ")
"""How those answers begin that say nothing of the candidate."""


@dataclass(frozen=True)
class GateSettings:
    """What a candidate has to show; gains in nats per withheld reading.

    Attributes:
        least_gain: what is less is not worth a change.
        at_once: standard errors by which the gain must be above nought on one stretch of held-out time alone …
        errors: … and over two or more: what wins twice is less likely chance. Chosen where no candidate that made the
            tracker worse came near (docs/learning.md).
        astray: standard errors by which tracks made under it may seem worse, whichever of both models judges them.
        hopeless: standard errors above nought below which, after two stretches, no further time is waited for; after
            one it is waited for whatever is above nought.
        looks: stretches of held-out time on which a candidate that is better, but not surely, is tried at most.
        least_scans: withheld scans without which nothing is decided.
        least_seconds: of held-out time.
        alone: by how much more a candidate must show that one phone alone speaks for: gain, scans.
        heard: withheld scans from which a phone counts as a witness of its own.
        without_best: share of the margin that must remain without the phone that gains most.
        ruined: loss of one phone that no gain of others outweighs.
        names: share of readings that may lose their name.
    """

    least_gain: float = 0.003
    at_once: float = 2.0
    errors: float = 1.25
    astray: float = 1.0
    hopeless: float = 0.5
    looks: int = 6
    least_scans: int = 60
    least_seconds: float = 80.0
    alone: float = 2.0
    heard: int = 15
    without_best: float = 0.25
    ruined: float = 0.1
    names: float = 0.01


@dataclass(frozen=True)
class Ruling:
    """What the gate says.

    Attributes:
        outcome: ``later`` where there was too little to tell; ``more`` where further held-out time is to be added.
        reason: in plain words; names no phone, since it is kept.
        gain: nats per withheld reading, or as the learner counts.
        margin: what it had to be.
        evidence: numbers by name.
    """

    outcome: Literal["activate", "refuse", "later", "more"]
    reason: str
    gain: float | None = None
    margin: float | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)


class Gate:
    """Rules on candidates.

    Args:
        settings: what they have to show.
    """

    def __init__(self, settings: GateSettings | None = None) -> None:
        self._settings = settings or GateSettings()

    def of_its_own(self, proposal: Proposal) -> Ruling:
        """Rule on a candidate that its learner has scored on held-out data itself."""
        gain, margin = proposal.gain, proposal.margin
        if gain is None or margin is None or not (math.isfinite(gain) and math.isfinite(margin) and margin > 0.0):
            return Ruling("refuse", "nothing tells whether it is better: neither a question nor a gain and its margin")
        if gain > margin:
            return Ruling("activate", f"wins by {gain:.3g}, more than the {margin:.3g} asked for", gain, margin)
        return Ruling("refuse", f"wins by {gain:.3g}, not more than the {margin:.3g} asked for", gain, margin)

    def of_trials(self, proposal: Proposal, trials: Sequence[Trial]) -> Ruling:
        """Rule on a candidate that fusion has tried, the latest time last; earlier ones were ruled ``more``."""
        trial = trials[-1]
        if trial.error is not None:
            if trial.error.startswith(LATER):
                return Ruling("later", trial.error)
            return Ruling("refuse", f"fusion cannot try it: {trial.error}")
        if trial.gain is None:
            return Ruling("later", f"fusion of area {proposal.area} scored no candidate")
        wanted, looks, trial = self._settings, len(trials), pooled(trials)
        witnesses = {name: one for name, one in trial.devices.items() if one.scans >= wanted.heard}
        stricter = wanted.alone if len(witnesses) < 2 else 1.0
        evidence = _evidence(trial, len(witnesses))
        if trial.scans < stricter * wanted.least_scans or trial.seconds < wanted.least_seconds:
            return Ruling(
                "later",
                f"too little held-out data: {trial.scans} scans in {trial.seconds:.0f} s; allowed: "
                f"{stricter * wanted.least_scans:.0f} or more in {wanted.least_seconds:.0f} s or more",
            )
        spread = trial.spread
        if spread is None:
            return Ruling("refuse", "one phone alone was heard, and nothing tells how sure its gain is", trial.gain)
        # What made a candidate urgent spoke for it before the trial, on other time: that was the first look.
        errors = wanted.errors if looks > 1 or proposal.urgent else wanted.at_once
        margin = stricter * max(wanted.least_gain, errors * spread)
        fault = self._fault(trial, margin, witnesses)
        gain = trial.gain or 0.0
        least = wanted.hopeless * spread if looks > 1 else 0.0
        if fault and least < gain <= margin and looks < wanted.looks:
            words = f"better by {gain:.3g} nats per reading, but not surely: tried again on what comes now"
            return Ruling("more", words, gain, margin, evidence)
        if fault:
            return Ruling("refuse", fault, trial.gain, margin, evidence)
        words = f"wins by {trial.gain:.3g} nats per reading, more than the {margin:.3g} asked for"
        return Ruling("activate", words, trial.gain, margin, evidence)

    def _fault(self, trial: Trial, margin: float, witnesses: Mapping[str, DeviceTrial]) -> str:
        """Return why a candidate does not go live; empty where it does."""
        wanted, gain = self._settings, trial.gain or 0.0
        if not gain > margin:
            alone = " (one phone alone speaks for it)" if len(witnesses) < 2 else ""
            return f"wins by {gain:.3g} nats per reading, not more than the {margin:.3g} asked for{alone}"
        strayed = trial.tracks_gain_error is not None and trial.tracks_gain < -wanted.astray * trial.tracks_gain_error
        if strayed:
            return f"names would be worse: {-trial.tracks_gain:.3g} nats per reading are lost where tracks bear others"
        lost = trial.active_named - (trial.active_named if trial.candidate_named is None else trial.candidate_named)
        if lost > wanted.names:
            return f"names would be lost: {100 * lost:.1f} % of readings had one before and none after"
        if len(witnesses) > 1:
            rest = _without_best(trial.devices)
            if not rest > wanted.without_best * margin:
                return f"one phone alone carries the gain: without it {rest:.3g} nats per reading remain"
        worst = min((one.gain for one in witnesses.values() if one.gain is not None), default=0.0)
        if worst < -wanted.ruined:
            return f"one phone would be worse off by {-worst:.3g} nats per reading, whatever others gain"
        return ""


def _without_best(devices: Mapping[str, DeviceTrial]) -> float:
    """Return the gain per reading of all phones but the one that gains most in all."""
    rows = [(one.scans, one.gain) for one in devices.values() if one.gain is not None and one.scans > 0]
    if len(rows) < 2:
        return -math.inf
    rows.sort(key=lambda row: row[0] * row[1])
    rest = rows[:-1]
    return sum(scans * gain for scans, gain in rest) / sum(scans for scans, _ in rest)


def _evidence(trial: Trial, witnesses: int) -> dict[str, float]:
    told: dict[str, float | None] = {
        "held-out scans": float(trial.scans),
        "held-out seconds": trial.seconds,
        "phones heard": float(witnesses),
        "standard error of the gain": trial.spread,
        "named before": trial.active_named,
        "named after": trial.candidate_named,
    }
    return {name: value for name, value in told.items() if value is not None}
