"""An area's radio, learned from good stretches as they come; proposes a model when there is something to propose."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.proposal import Proposal
from services.learning.radio.evidence import RadioEvidence
from services.learning.radio.hearing import RecentHearing
from services.learning.radio.shifts import Shift, find_shifts
from services.learning.radio.wording import reading_words, silent_words
from services.learning.tracks.stretch import Stretch
from shared.learning_report import AccessPointFit, ModelKind
from shared.messages import Message, RadioModelFile, RadioModelUpdate
from shared.radio import (
    PathLoss,
    RadioFit,
    RadioModel,
    RadioModelError,
    RadioPrior,
    Visits,
    Whereabouts,
    fit_radio,
    locate_access_point,
    pack_radio_model,
    unpack_radio_model,
)
from shared.site import Site

__all__ = ["RadioLessonSettings", "RadioLessons"]

Array = NDArray[np.float64]

MARGIN = 3.0
"""Metres around the floor for which the map is made, as fusion believes positions so far outside."""
FULL = 0.02
"""How much of an access point's evidence stays where it no longer hangs, or in the lee of a new wall."""
REACH = 2.0
"""Metres around a block that reads otherwise in which older evidence goes."""


@dataclass(frozen=True)
class RadioLessonSettings:
    """How the radio is learned.

    Attributes:
        half_life: seconds of people about after which a visit counts half.
        every: seconds between two proposals.
        after_change: the same after something changed.
        visits: new ones that make a proposal worth while, and as many
        spots: square metres must have been visited lately.
        recent: seconds against which the last readings are held.
        moved: metres from which an access point counts as moved, if readings also say so by ``moved_nats``.
        moved_nats: see above.
        known: metres to which a position must be known before it is told.
    """

    half_life: float = 2700.0
    every: float = 300.0
    after_change: float = 60.0
    visits: int = 150
    spots: int = 12
    recent: float = 300.0
    moved: float = 2.0
    moved_nats: float = 8.0
    known: float = 3.0


@dataclass(frozen=True)
class _Change:
    """What was found of an access point: ``by`` dB since ``since``; ``state`` what kind of change."""

    state: Literal["changed", "moved"]
    since: float
    by: float
    words: str


class RadioLessons:
    """Learns the radio of one area; see ``Learner``.

    Args:
        site: as its file says; of it only what trackers may know is used.
        area: id of the area.
        settings: see there.
        prior: what is believed of the radio beforehand.
    """

    kind: ModelKind = "radio"

    def __init__(
        self, site: Site, area: str, settings: RadioLessonSettings | None = None, prior: RadioPrior | None = None
    ) -> None:
        floor = site.area(area).floor
        x0, y0, x1, y1 = site.floor(floor).plan().outline.bounds
        self.area, self._site = area, site.site
        self._settings, self._prior = settings or RadioLessonSettings(), prior or RadioPrior()
        self._lower, self._upper = np.array([x0, y0]) - MARGIN, np.array([x1, y1]) + MARGIN
        self._file = self._guess = PathLoss.of([point for point in site.access_points if point.floor == floor])
        self._evidence = RadioEvidence(len(self.points), self._prior)
        self._hearing = RecentHearing(len(self.points))
        self._active: RadioModel | None = None
        self._changes: dict[int, _Change] = {}
        self._located: dict[int, Whereabouts] = {}
        self._offsets: dict[str, float] = {}
        self._reference: RadioFit | None = None
        self._taught, self._proposed, self._reviewed = -np.inf, -np.inf, -np.inf

    @property
    def points(self) -> tuple[str, ...]:
        """The access points in the order in which stretches name them."""
        return self._file.names

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch that may teach."""
        self._evidence.take(stretch)
        if len(stretch.scan_t):
            self._hearing.take(stretch, self._expected(stretch.scan_place)[0])

    def forget(self, device: str) -> None:
        """Forget a device; what many phones taught together stays."""
        self._evidence.forget(device)
        self._hearing.forget(device)
        self._offsets.pop(device, None)
        self._reference = None

    def offsets(self) -> Mapping[str, float]:
        """Return by how many dB each phone hears more than others, as last learned."""
        return dict(self._offsets)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Return what the evidence up to ``until`` teaches, where there is enough that is new."""
        self.review(now)
        settings = self._settings
        changed = [change for change in self._changes.values() if change.since > self._taught]
        wait = settings.after_change if changed else settings.every
        if now < self._proposed + wait or not self.points:
            return ()
        visits, age, kept = self._evidence.visits(until=until)
        new = visits.where(visits.t > self._taught)
        spots = len(np.unique(np.floor(new.place), axis=0))
        least = settings.visits // 3 if changed else settings.visits
        if len(new) < least or spots < settings.spots:
            return ()
        fit = self._fit(visits, age, kept)
        self._proposed, before = now, self._taught
        self._taught = until
        self._offsets = dict(zip(self._evidence.devices, fit.offset.tolist(), strict=False))
        located = [self.points[point] for point in sorted(self._located)]
        file = pack_radio_model(fit.model, located)
        question = msgspec.json.encode({"kind": "radio", "model": file, "since": until})
        fresh = visits.t > before
        evidence = {
            "readings": float(len(visits)),
            "new_readings": float(fresh.sum()),
            "phones": float(len(np.unique(visits.device))),
            "visit_sigma": fit.visit,
            "drift_sigma": fit.drift,
            "residual": _sigma(fit.error[fresh]),
            "residual_active": _sigma(self._error(new, fit.offset)),
        }
        update = RadioModelUpdate(t=now, area=self.area, version=0, model=file, reason="")
        reason = "; ".join(change.words for change in changed) or "people walked where the radio is to be learned"
        return (
            Proposal(
                "radio", self.area, self.area, msgspec.structs.replace(update, reason=reason), until, question,
                evidence=evidence, reason=reason,
            ),
        )  # fmt: skip

    def activated(self, model: Message) -> None:
        """Hold what is heard from now on against this model; one that does not fit the site is passed over."""
        if not isinstance(model, RadioModelUpdate) or model.area != self.area:
            return
        try:
            self._active = None if model.model is None else unpack_radio_model(model.model, self._site, self.points)
        except RadioModelError:
            return
        if model.model is not None:
            self._changes = {point: change for point, change in self._changes.items() if change.since > self._taught}

    def review(self, now: float) -> None:
        """Look for access points that read otherwise than they did, at most every half minute."""
        if now < self._reviewed + 30.0:
            return
        self._reviewed = now
        settings = self._settings
        if self._reference is None:
            self._reference = self._refit(now - settings.recent)
            return
        recent, _, _ = self._evidence.visits(since=now - settings.recent)
        error = _own_offsets(recent, self._error(recent, self._reference.offset, self._reference.model))
        rows = np.arange(len(recent))
        unknown = self._reference.model.shadowing.at(recent.place)[1][rows, recent.point]
        shared = max(self._reference.visit, 2.0)
        shifts = find_shifts(recent, error, unknown, shared, now) if len(recent) else []
        for shift in shifts:
            self._take_change(shift, now)
        self._reference = self._refit(now if shifts else now - settings.recent)

    def fits(self, now: float) -> list[AccessPointFit]:
        """Return how each access point stands."""
        recent, _, _ = self._evidence.visits(since=now - 2.0 * self._settings.recent)
        offset = np.array([self._offsets.get(device, np.nan) for device in self._evidence.devices])
        error = self._error(recent, np.nan_to_num(offset))
        error = np.where(np.isnan(offset[recent.device]), _own_offsets(recent, error), error)
        return [self._fit_of(point, error[recent.point == point], now) for point in range(len(self.points))]

    def state(self) -> dict[str, Any]:
        """Return all it knows."""
        return {
            "evidence": self._evidence.state(),
            "positions": self._guess.positions.tolist(),
            "located": {str(point): [*w.place.tolist(), *w.covariance.ravel().tolist(), w.gain]
                        for point, w in self._located.items()},
            "changes": {str(point): dataclasses.asdict(change) for point, change in self._changes.items()},
            "offsets": dict(self._offsets),
            "taught": self._taught if np.isfinite(self._taught) else None,
            "active": None if self._active is None else pack_radio_model(self._active),
        }  # fmt: skip

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``.

        Raises:
            ValueError: it is no such state; nothing is changed then.
        """
        evidence = RadioEvidence(len(self.points), self._prior)
        try:
            positions = np.array(state["positions"], float)
            if positions.shape != self._file.positions.shape or not np.isfinite(positions).all():
                raise ValueError(f"positions: found shape {positions.shape}; allowed: {self._file.positions.shape}")
            located = {
                self._known(point): Whereabouts(
                    np.array(row[:2], float), np.array(row[2:6], float).reshape(2, 2), row[6]
                )
                for point, row in state["located"].items()
            }
            changes = {
                self._known(point): msgspec.convert(change, _Change) for point, change in state["changes"].items()
            }
            offsets = {str(device): float(offset) for device, offset in state["offsets"].items()}
            taught = -np.inf if state["taught"] is None else float(state["taught"])
            file = None if state["active"] is None else msgspec.convert(state["active"], RadioModelFile)
            active = None if file is None else unpack_radio_model(file, self._site, self.points)
            evidence.restore(state["evidence"])
        except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
            raise ValueError(f"radio lessons of area {self.area}: {error!r}") from error
        self._evidence, self._located, self._changes, self._offsets = evidence, located, changes, offsets
        self._guess = dataclasses.replace(self._file, positions=positions)
        self._taught, self._active, self._reference = taught, active, None

    def _known(self, point: str) -> int:
        number = int(point)
        if not 0 <= number < len(self.points):
            raise ValueError(f"access point {point}: allowed: 0 to {len(self.points) - 1}")
        return number

    def _fit(self, visits: Visits, age: Array, kept: Array) -> RadioFit:
        faded = kept * 0.5 ** (age / self._settings.half_life)
        return fit_radio(
            self._guess, self._lower, self._upper, visits, kept=faded, prior=self._prior,
            devices=len(self._evidence.devices), site=self._site,
        )  # fmt: skip

    def _refit(self, until: float) -> RadioFit:
        return self._fit(*self._evidence.visits(until=until))

    def _expected(self, places: Array, model: RadioModel | None = None) -> tuple[Array, Array]:
        """Return levels (n, m) and their variance at (n, 2) places, by a model or the active one."""
        model = model or self._active
        if model is None:
            return self._file.rssi(places), np.full((len(places), len(self.points)), self._prior.power**2)
        mean, variance = model.shadowing.at(places)
        return model.path_loss.rssi(places) + mean, variance

    def _error(self, visits: Visits, offset: Array, model: RadioModel | None = None) -> Array:
        """Return heard − foretold − offset, (n,) dB; a phone that came since has none yet."""
        rows = np.arange(len(visits))
        known = np.append(offset, np.zeros(max(0, len(self._evidence.devices) - len(offset))))
        error: Array = visits.level - self._expected(visits.place, model)[0][rows, visits.point] - known[visits.device]
        return error

    def _take_change(self, shift: Shift, now: float) -> None:
        point, name = shift.point, self.points[shift.point]
        where = self._locate(point, shift.since)
        here = self._guess.positions[point]
        settings = self._settings
        if where is not None and where.gain > settings.moved_nats and where.error < settings.known:
            away = float(np.hypot(*(where.place - here[:2])))
            if away > max(settings.moved, 2.5 * where.error):
                positions = self._guess.positions.copy()
                positions[point, :2] = where.place
                self._guess = dataclasses.replace(self._guess, positions=positions)
                self._evidence.fade(point, shift.since, FULL)
                self._located[point] = where
                self._changes[point] = _Change(
                    "moved", now, shift.by, reading_words(name, shift.by, shift.since, moved=away)
                )
                return
        if shift.whole:
            self._evidence.shift(point, shift.since, shift.by)
            self._evidence.fade(point, shift.since, 0.5)
        else:
            self._evidence.fade(point, shift.since, FULL, shift.places, REACH)
        words = reading_words(name, shift.by, shift.since, whole=shift.whole)
        self._changes[point] = _Change("changed", now, shift.by, words)

    def _locate(self, point: int, since: float) -> Whereabouts | None:
        visits, _, _ = self._evidence.visits(since=since)
        mine = visits.where(visits.point == point)
        if self._reference is None or len(mine) < self._settings.spots:
            return None
        offset = np.append(self._reference.offset, np.zeros(len(self._evidence.devices)))[mine.device]
        weight = mine.weight / (1.0 + max(self._reference.visit, 2.0) ** 2 * mine.weight)
        return locate_access_point(
            mine.place, mine.level - offset, weight, self._lower, self._upper,
            height=float(self._guess.positions[point, 2]), power=float(self._file.power_1m[point]),
            exponent=float(self._file.exponent[point]), asked=self._guess.positions[point, :2], prior=self._prior,
        )  # fmt: skip

    def _fit_of(self, point: int, error: Array, now: float) -> AccessPointFit:
        name = self.points[point]
        loss = self._file if self._active is None else self._active.path_loss
        enough = len(error) >= self._settings.spots
        state: Literal["fine", "few readings", "changed", "moved", "silent"] = "fine" if enough else "few readings"
        words = ""
        change, where = self._changes.get(point), self._located.get(point)
        since = self._hearing.silent(point, now)
        if since is not None:
            state, words = "silent", silent_words(name, since)
        elif change is not None:
            state, words = change.state, change.words
        told = where is not None and where.error < self._settings.known
        return AccessPointFit(
            access_point=name,
            power_1m=float(loss.power_1m[point]),
            path_loss_exponent=float(loss.exponent[point]),
            sigma=_sigma(error) if enough else None,
            bias=float(np.median(error)) if enough else None,
            readings=len(error),
            state=state,
            position=(*where.place.tolist(), float(loss.positions[point, 2])) if told and where else None,
            position_error=where.error if told and where else None,
            words=words,
        )


def _sigma(error: Array) -> float:
    """Return the robust standard deviation of (n,) errors about their median, dB."""
    return float(1.4826 * np.median(np.abs(error - np.median(error)))) if len(error) else 0.0


def _own_offsets(visits: Visits, error: Array) -> Array:
    """Return the errors (n,) with what each phone reads too much lately taken off: the median over access points."""
    error = error.copy()
    for device in np.unique(visits.device).tolist():
        mine = np.flatnonzero(visits.device == device)
        medians = [np.median(error[mine[visits.point[mine] == point]]) for point in np.unique(visits.point[mine])]
        error[mine] -= np.median(medians)
    return error
