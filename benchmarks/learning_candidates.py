"""Radio models of random quality, as the life of a site brings them forth: good, stale, wrong, poisoned."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from msgspec.structs import replace

from benchmarks.fusion_run import FusionRun
from benchmarks.radio_training import learn_from_run, warmed_up
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from shared.messages import RadioScan

__all__ = ["KINDS", "candidate_of", "poisoned", "until"]

KINDS = ("learned", "perturbed", "swapped", "stale", "little", "malicious")
LITTLE = 60.0
"""Seconds of which somebody in a hurry learns."""
INVENTED = (-85.0, -30.0)
"""dBm, between which a malicious phone invents what it heard."""


def candidate_of(
    kind: str, record: WorldRecord, run: FusionRun, found: AreaView, turn: float, rng: np.random.Generator
) -> AreaView:
    """Return an area's view with a candidate of one kind.

    Args:
        kind: of ``KINDS``. ``learned`` from all since ``turn``; ``perturbed``: the same with errors of its constants;
            ``swapped``: with everybody's name on somebody else's track; ``stale``: from what lies before ``turn``, when
            something changed; ``little``: from one minute; ``malicious`` as ``learned``, of a record that was
            ``poisoned``.
        record: the training part.
        run: of a tracker over it.
        found: the site as found.
        turn: seconds since the epoch.
        rng: decides the errors.
    """
    end = run.frames[-1].t
    match kind:
        case "stale":
            return _taught(record, until(run, 0.0, turn), found)
        case "little":
            return _taught(record, until(run, end - LITTLE, end), found)
        case "swapped":
            return _taught(record, _renamed(until(run, turn, end), sorted(record.scans)), found)
        case "perturbed":
            return _perturbed(_taught(record, until(run, turn, end), found), rng)
        case _:
            return _taught(record, until(run, turn, end), found)


def _taught(record: WorldRecord, run: FusionRun, found: AreaView) -> AreaView:
    """Return what a run teaches whoever believes every name."""
    return warmed_up(found, learn_from_run(run, record.scans, found, record.site.site))


def until(run: FusionRun, begin: float, end: float) -> FusionRun:
    """Return the part of a run from ``begin`` to ``end``, seconds since the epoch."""
    return FusionRun(
        [frame for frame in run.frames if begin <= frame.t <= end],
        [revision for revision in run.revisions if begin <= revision.t <= end],
        [],
    )


def poisoned(record: WorldRecord, device: str, rng: np.random.Generator) -> WorldRecord:
    """Return the record in which one phone invents whatever it says it heard, the same again and again."""
    level = dict(zip([point.id for point in record.site.access_points], rng.uniform(*INVENTED, 100), strict=False))

    def invented(scan: RadioScan) -> RadioScan:
        return replace(scan, rssi=[float(level[name]) for name in scan.access_point])

    arrivals = [
        (t, invented(said) if isinstance(said, RadioScan) and said.device == device else said)
        for t, said in record.arrivals
    ]
    scans = {
        name: [invented(scan) for scan in scans] if name == device else scans for name, scans in record.scans.items()
    }
    return dataclasses.replace(record, arrivals=arrivals, scans=scans)


def _renamed(run: FusionRun, devices: Sequence[str]) -> FusionRun:
    """Return the run with each device's name in the place of the one before it."""
    other: dict[str | None, str | None] = dict(zip(devices, [*devices[1:], *devices[:1]], strict=True))
    frames = [replace(frame, device=[other.get(name) for name in frame.device]) for frame in run.frames]
    revisions = [
        replace(revision, device=[other.get(name) or name for name in revision.device]) for revision in run.revisions
    ]
    return FusionRun(frames, revisions, run.seconds)


def _perturbed(view: AreaView, rng: np.random.Generator) -> AreaView:
    size = rng.uniform(0.0, 6.0)
    points = len(view.radio.names)
    radio = dataclasses.replace(
        view.radio,
        power_1m=view.radio.power_1m + rng.normal(0.0, size, points),
        exponent=view.radio.exponent + rng.normal(0.0, size / 20.0, points),
    )
    return dataclasses.replace(view, radio=radio)
