"""Does quality tell where a device was told right? Its minutes, how good each looks and how far off it was."""

from __future__ import annotations

import math
from collections import defaultdict
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion_run import FusionRun
from benchmarks.learning_stretches import cut_of, heard_of
from benchmarks.revised import said_later
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.learning.tracks.along import along
from services.learning.tracks.compare import compare
from services.learning.tracks.phones import PhoneRows, Phones
from services.learning.tracks.quality import QualityJudge
from services.learning.tracks.sight import SightScore
from shared.messages import DetectionFrame, MotionBatch, RadioScan, TrackFrame

__all__ = ["DeviceMinutes", "device_minutes"]

Array = NDArray[np.float64]

LEAST_TOLD = 0.5
"""Share of a minute for which a device must be told to be somewhere."""


@dataclass(frozen=True)
class DeviceMinutes:
    """What was told of devices, a minute at a time, wrong names and times without a camera among it: (k,) each.

    Attributes:
        seconds: of the minute for which the device was told to be somewhere.
        sight: nats by which cameras spoke for the tracks that bore its name; a second on none counts as missed.
        radio: nats by which its readings fit the way it was told to go, against no places.
        walk: nats by which its steps do.
        named: share of the seconds in which it was told on a track.
        rmse: metres from its carrier, root mean square.
    """

    seconds: Array
    sight: Array
    radio: Array
    walk: Array
    named: Array
    rmse: Array

    @property
    def printed(self) -> Array:
        """Q of [ravel-thesis §8.1, Eq. 5.1], of the device as the filter follows it."""
        return self.sight + self.radio + self.walk


def device_minutes(record: WorldRecord, run: FusionRun, minute: float = 60.0) -> DeviceMinutes:
    """Return what was told of each device in each minute of a run, how good it looks and how right it was.

    The study's Fig. 5.4 scores what its filter follows, and that is the device, not a track: cameras' part is the
    track's that bears the name then, log(1 - p_d) a second where none does, and radio and steps are held against the
    way told. Minutes with less than ``LEAST_TOLD`` of telling are left out.
    """
    truth, view = record.truth, AreaView.of(record.site, record.area)
    devices = [device for device in truth.device if device is not None]
    t = np.arange(run.frames[0].t, run.frames[-1].t, 1.0)
    said = said_later(t, devices, run.frames, run.revisions)
    sight, detected, phones = _heard(record, run, view, t)
    missed = math.log(1.0 - detected)
    judge, stretches = QualityJudge(len(view.radio.names)), iter(cut_of(record, run, view))
    stretch = next(stretches, None)
    rows = []
    for begin in np.arange(t[0], t[-1] - minute + 1.0, minute):
        while stretch is not None and stretch.t[-1] <= begin:
            judge.judge(stretch, view.radio)
            stretch = next(stretches, None)
        during = np.flatnonzero((t >= begin) & (t < begin + minute))
        for number, device in enumerate(devices):
            told = during[np.isfinite(said.position[during, number, 0])]
            carrier = truth.position[:, list(truth.device).index(device)]
            away = np.hypot(*(said.position[told, number] - _at(truth.t, carrier, t[told])).T)
            told, away = told[np.isfinite(away)], away[np.isfinite(away)]
            if len(told) < LEAST_TOLD * minute:
                continue
            track, place = said.track[told, number], said.position[told, number]
            nats = sum(
                sight.get((int(one), int(at)), 0.0) if one > 0 else missed for one, at in zip(track, told, strict=True)
            )
            unknown = np.zeros((len(told), 2, 2)), np.zeros(len(told))
            way = along(device, phones.get(device, PhoneRows()), 0, t[told], place, *unknown)
            compared = compare(way, view.radio, None, judge.belief(device))
            rmse = math.sqrt(float((away**2).mean()))
            rows.append((len(told), nats, compared.radio[0], compared.walk[0], (track > 0).mean(), rmse))
    return DeviceMinutes(*np.array(rows, float).reshape(-1, 6).T)


def _heard(
    record: WorldRecord, run: FusionRun, view: AreaView, t: Array
) -> tuple[dict[tuple[int, int], float], float, Phones]:
    """Return the nats cameras spoke for each track up to each of (n,) seconds, how much of people they see, and what
    phones said."""
    sight, nats = SightScore(view.views), defaultdict[tuple[int, int], float](float)
    phones = Phones(view.radio.names, math.inf)
    for _, message in heard_of(record, run):
        match message:
            case DetectionFrame():
                sight.take_detections(message)
            case RadioScan():
                phones.take_scan(message)
            case MotionBatch():
                phones.take_motion(message)
            case TrackFrame():
                phones.take_time(message.t)
                second = int(np.searchsorted(t, message.t))
                for track, gain in sight.score(message).items():
                    nats[track, second] += gain
    return nats, float(np.mean(list(sight.detected().values()))), phones


def _at(known: Array, place: Array, t: Array) -> Array:
    return np.column_stack([np.interp(t, known, place[:, axis]) for axis in (0, 1)])
