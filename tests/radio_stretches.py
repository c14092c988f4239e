"""Stretches of people who walk through a hall whose radio is made up."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from services.learning.proposal import Proposal
from services.learning.radio.lessons import RadioLessons
from services.learning.tracks.stretch import Stretch
from shared.messages import RadioModelUpdate
from shared.radio import PathLoss, RadioModel, unpack_radio_model
from shared.site import Site

Array = NDArray[np.float64]

T0 = 1_700_000_000.0
PHONES = {"a": 2.0, "b": -3.0, "c": 0.0}
"""What each reads too much, dB."""


class Hall:
    """Its true radio: ``loss``, and dB more at (n, 2) places per access point, from ``heard``."""

    def __init__(self, loss: PathLoss, seed: int = 1) -> None:
        self.loss = loss
        self.rng = np.random.default_rng(seed)
        self.more: Callable[[Array], Array] = lambda places: np.zeros((len(places), len(loss.names)))
        self.dead: set[int] = set()

    def level(self, places: Array) -> Array:
        """Return (n, m) dBm without noise."""
        return self.loss.rssi(places) + self.more(places)

    def stretch(
        self, device: str, start: float, seconds: float = 60.0, offset: float = 0.0, *, still: bool = False
    ) -> Stretch:
        """Return a minute of somebody who walks along a random line, there and back, and is heard once a second."""
        t = T0 + start + np.arange(0.0, seconds, 0.2)
        ends = self.rng.uniform((1.0, 1.0), (23.0, 13.0), (2, 2))
        length = float(np.hypot(*(ends[1] - ends[0])))
        along = np.abs((0.9 * (t - t[0]) / length + 1.0) % 2.0 - 1.0) if not still else np.zeros(len(t))
        place = ends[0] + along[:, None] * (ends[1] - ends[0])
        rows = np.arange(0, len(t), 5)
        facing = self.rng.normal(0.0, 1.5, (2, len(self.loss.names)))[(np.diff(along, prepend=0.0) > 0).astype(int)]
        heard = (
            self.level(place[rows]) + offset + facing[rows] + self.rng.normal(0.0, 2.0, (len(rows), facing.shape[1]))
        )
        points = [point for point in range(facing.shape[1]) if point not in self.dead]
        return _stretch(device, t, place, rows, points, heard[:, points])


def _stretch(
    device: str, t: Array, place: Array, rows: NDArray[np.int64], points: Sequence[int], heard: Array
) -> Stretch:
    none, ones = np.empty(0), np.ones(len(t))
    scans, count = len(rows), len(points)
    return Stretch(
        device=device, track=1, t=t, place=place, covariance=np.tile(0.02 * np.eye(2), (len(t), 1, 1)),
        probability=0.95 * ones, seen=ones > 0, sight=0.0 * ones, scan_t=np.repeat(t[rows], count),
        point=np.tile(np.array(points, np.int64), scans), level=heard.ravel(),
        scan_place=np.repeat(place[rows], count, axis=0), scan_spread=np.full(scans * count, 0.15), step_t=none,
        length=none, length_variance=none, heading=none, heading_variance=none, walk=np.empty(0, np.int64),
    )  # fmt: skip


def hall_of(site: Site, seed: int = 1) -> Hall:
    """Return a hall that sends otherwise than its site file says, with a shaded corner."""
    loss = PathLoss.of([point for point in site.access_points if point.floor == "ground"])
    off = np.array([4.0, -3.0, 2.0, 0.0, -4.0, 3.0])
    hall = Hall(dataclasses.replace(loss, power_1m=loss.power_1m + off), seed)
    hall.more = lambda places: -5.0 * ((places[:, :1] > 16.0) & (places[:, 1:] > 8.0)) * np.ones((1, 6))
    return hall


def teach(lessons: RadioLessons, hall: Hall, minutes: range, phones: dict[str, float] | None = None) -> list[Proposal]:
    """Return what was proposed while phones walked; every minute's stretches come when the minute is over."""
    proposals: list[Proposal] = []
    for minute in minutes:
        for device, offset in (phones or PHONES).items():
            lessons.learn(hall.stretch(device, 60.0 * minute, offset=offset))
        now = T0 + 60.0 * (minute + 1)
        for proposal in lessons.propose(now, now):
            proposals.append(proposal)
            assert isinstance(proposal.model, RadioModelUpdate)
            lessons.activated(proposal.model)
    return proposals


def model_of(proposal: Proposal, site: Site, lessons: RadioLessons) -> RadioModel:
    assert isinstance(proposal.model, RadioModelUpdate)
    assert proposal.model.model is not None
    return unpack_radio_model(proposal.model.model, site.site, lessons.points)


def off_by(model: RadioModel, hall: Hall, seed: int = 9) -> NDArray[np.float64]:
    """Return by how much a model is off at random places, (n, m) dB."""
    places = np.random.default_rng(seed).uniform((1.0, 1.0), (23.0, 13.0), (200, 2))
    error: NDArray[np.float64] = model.path_loss.rssi(places) + model.shadowing.at(places)[0] - hall.level(places)
    return error - np.median(error)


def rms(error: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(error**2)))
