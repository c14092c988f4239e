"""An area's radio, learned from good stretches as they come; proposes a model when there is something to propose."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.learning.proposal import Proposal
from services.learning.radio.by_name import columns_today
from services.learning.radio.changes import Changes
from services.learning.radio.doubts import SURE, agreement, believed, doubted, doubts, is_doubted
from services.learning.radio.evidence import RadioEvidence
from services.learning.radio.hearing import RecentHearing
from services.learning.radio.lesson_settings import RadioLessonSettings
from services.learning.radio.live_radio import LiveRadio, heard_beyond, own_offsets
from services.learning.radio.placing import Placing
from services.learning.radio.shifts import Shift, find_shifts
from services.learning.radio.standing import Known, robust_sigma, standing
from services.learning.radio.suspicions import news_to, supposed
from services.learning.radio.wording import believed_words, doubted_words
from services.learning.report_draft import ReportDraft
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
    fit_radio,
    pack_radio_model,
)
from shared.site import Site

__all__ = ["RadioLessons"]

Array = NDArray[np.float64]

MARGIN = 3.0
"""Metres around the floor for which the map is made, as fusion believes positions so far outside."""
REVIEW = 30.0
"""Seconds between two looks for changes."""
AGAIN = 3600.0
"""Seconds until a doubt is told again that did not go live, or did not stay so."""
SHARED = 2.0
"""dB that a visit's readings have in common at least, where few visits have shown it yet."""


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
        self._file = PathLoss.of([point for point in site.access_points if point.floor == floor])
        self._evidence = RadioEvidence(len(self.points), self._prior)
        self._hearing = RecentHearing(len(self.points))
        self._live = LiveRadio(self._file, site.site)
        self._placing = Placing(self._file, self._lower, self._upper, self._prior)
        self._changes = Changes(self._file, self._lower, self._upper, self._prior)
        self._offsets: dict[str, float] = {}
        self._reference: RadioFit | None = None
        self._suspects: dict[int, float] = {}
        self._alarming: list[Shift] = []
        self._alarmed = -np.inf
        self._looked, self._lived, self._distrusted = False, -np.inf, -np.inf
        self._numbers = 0
        self._heard = -np.inf
        self._taught, self._proposed, self._reviewed = -np.inf, -np.inf, -np.inf

    @property
    def points(self) -> tuple[str, ...]:
        """The access points in the order in which stretches name them."""
        return self._file.names

    def learn(self, stretch: Stretch) -> None:
        """Take in a stretch that may teach."""
        self._evidence.take(stretch)
        self._heard = max(self._heard, float(stretch.t[-1]))
        if len(stretch.scan_t):
            self._hearing.take(stretch, self._live.expected(stretch.scan_place))

    def learn_doubtful(self, stretch: Stretch) -> None:
        """Take in a stretch whose name is in doubt; it draws the map, but says nothing of changes."""
        self._evidence.take(stretch, doubtful=True)

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
        changed = [change for change in self._changes.found.values() if change.found > self._taught]
        wait = settings.after_change if changed else settings.every
        if 0.0 <= now - self._proposed < wait or not self.points:
            return ()
        visits, age, kept = self._teaching(until=until)
        new = visits.where(visits.t > self._taught)
        spots = len(np.unique(np.floor(new.place), axis=0))
        least = settings.visits // 3 if changed else settings.visits
        if len(new) < least or spots < settings.spots:
            return ()
        fit = self._fit(visits, age, kept)
        self._proposed, before = now, self._taught
        self._taught = until
        self._offsets = dict(zip(self._evidence.devices, fit.offset.tolist(), strict=False))
        reason = "; ".join(change.words for change in changed) or "people walked where the radio is to be learned"
        fresh = visits.t > before
        evidence = {
            "new_readings": float(fresh.sum()),
            "residual": robust_sigma(fit.error[fresh]),
            "residual_active": robust_sigma(self._live.beyond(self._live.of_placed(new), fit.offset)),
        }
        return (self._proposal(fit, visits, now, until, reason, evidence),)

    def alarms(self, now: float) -> Sequence[Proposal]:
        """Return what is to be believed if what only seems to have changed has changed; see ``Alert``."""
        self.review(now)
        if (distrust := self._distrust(now)) is not None:
            return (distrust,)
        if not self._alarming or 0.0 <= now - self._alarmed < self._settings.after_change:
            return ()
        self._alarmed = now
        visits, age, kept = self._teaching()
        believed = [shift for shift in self._alarming if shift.point not in self._believed(now)]
        visits, kept = supposed(visits, kept, believed)
        names = ", ".join(self.points[shift.point] for shift in self._alarming)
        reason = f"what is heard of {names} seems to have changed"
        return (self._proposal(self._fit(visits, age, kept), visits, now, now, reason, {}, urgent=True),)

    def _distrust(self, now: float) -> Proposal | None:
        """Return the live model with access points doubted that read otherwise, or believed that do not after all."""
        live, looked = self._live.model, self._looked
        self._looked = False
        if live is None or not looked or self._reference is None:
            return None
        if self._lived < self._distrusted and 0.0 <= now - self._distrusted < AGAIN:
            return None
        if new := doubts(live, self._alarming):
            words = doubted_words(*(self.points[shift.point] for shift in new))
            return self._of_itself(doubted(live, new), now, min(shift.nats for shift in new), words)
        questioned = [point for point in range(len(self.points)) if is_doubted(live, point)]
        if not questioned:
            return None
        recent, _, _ = self._teaching(since=max(now - self._settings.recent, self._lived), sure=True)
        told = self._live.of_placed(recent)
        error = own_offsets(told, self._live.beyond(told, np.zeros(0)))
        shared = max(self._reference.visit, SHARED)
        nats = {point: agreement(live, told, error, shared, point) for point in questioned}
        again = [point for point in nats if nats[point] > SURE]
        if not again:
            return None
        words = believed_words(*(self.points[point] for point in again))
        return self._of_itself(believed(live, again), now, min(nats[point] for point in again), words)

    def _of_itself(self, model: RadioModel, now: float, nats: float, words: str) -> Proposal:
        """Return a proposal that is decided by what was heard since the live model was taught."""
        self._distrusted = now
        update = RadioModelUpdate(t=now, area=self.area, version=0, model=pack_radio_model(model), reason=words)
        return Proposal(
            "radio", self.area, self.area, update, now, gain=nats, margin=SURE, reason=words, urgent=True
        )  # fmt: skip

    def _believed(self, now: float) -> set[int]:
        """Return the access points whose change the evidence says already."""
        return {point for point, change in self._changes.found.items() if change.found > now - REVIEW}

    def _proposal(
        self,
        fit: RadioFit,
        visits: Visits,
        now: float,
        until: float,
        reason: str,
        evidence: Mapping[str, float],
        *,
        urgent: bool = False,
    ) -> Proposal:
        located = [self.points[point] for point in sorted(self._changes.located)]
        file = pack_radio_model(fit.model, located)
        question = msgspec.json.encode({"kind": "radio", "model": file, "since": until})
        evidence = {
            "readings": float(len(visits)),
            "phones": float(len(np.unique(visits.device))),
            "visit_sigma": fit.visit,
            "drift_sigma": fit.drift,
            **evidence,
        }
        update = RadioModelUpdate(t=now, area=self.area, version=0, model=file, reason=reason)
        return Proposal(
            "radio", self.area, self.area, update, until, question, evidence=evidence, reason=reason, urgent=urgent
        )

    def activated(self, model: Message) -> None:
        """Hold what is heard from now on against this model; one that does not fit the site is passed over."""
        if not isinstance(model, RadioModelUpdate) or model.area != self.area:
            return
        try:
            self._live.take(model.model)
            self._lived = model.t
        except RadioModelError:
            return

    def review(self, now: float) -> None:
        """Look for access points that read otherwise than they did, and for places, every ``REVIEW`` seconds."""
        if 0.0 <= now - self._reviewed < REVIEW:
            return
        self._reviewed = now
        settings = self._settings
        if self._reference is None or self._numbers != self._evidence.renumbered:
            self._reference = self._refit(now - settings.recent)
            return
        recent, _, _ = self._teaching(since=now - settings.recent, sure=True)
        error = own_offsets(recent, heard_beyond(self._reference.model, recent, self._reference.offset))
        rows = np.arange(len(recent))
        unknown = self._reference.model.shadowing.at(recent.place)[1][rows, recent.point]
        shared = max(self._reference.visit, SHARED)
        before, _, _ = self._teaching(until=now - settings.recent)
        asked = recent, error, unknown, shared, before, now
        early = find_shifts(*asked, early=True) if len(recent) else []
        shifts = find_shifts(*asked) if early else []
        twice = [
            shift for shift in shifts if shift.nats > SURE or self._suspects.get(shift.point, 0.0) * shift.by > 0.0
        ]
        self._looked = True
        self._alarming = [] if self._live.model is None else [shift for shift in early if self._is_news(recent, shift)]
        self._suspects = {shift.point: shift.by for shift in shifts}
        for point, where in self._placing.look(self._evidence, self._reference).items():
            self._changes.place(point, where, now)
        edited = self._changes.take(twice, self._evidence, self._reference, now)
        self._reference = self._refit(now if edited else now - settings.recent)

    def _is_news(self, recent: Visits, shift: Shift) -> bool:
        """Whether the live model does not know of a shift yet."""
        told = self._live.of_placed(recent)
        return news_to(told, own_offsets(told, self._live.beyond(told, np.zeros(0))), shift)

    def fits(self, now: float) -> list[AccessPointFit]:
        """Return how each access point stands."""
        recent, _, _ = self._evidence.visits(since=now - 2.0 * self._settings.recent, sure=True)
        offset = np.array([self._offsets.get(device, np.nan) for device in self._evidence.devices])
        recent = self._live.of_placed(recent)
        error = self._live.beyond(recent, np.nan_to_num(offset))
        error = np.where(np.isnan(offset[recent.device]), own_offsets(recent, error), error)
        return [
            standing(
                point, self._live.loss, error[recent.point == point], self._settings.spots, self._known(point, now)
            )
            for point in range(len(self.points))
        ]

    def tell(self, draft: ReportDraft) -> None:
        """Add how access points stand, and by how much phones hear more than others."""
        if np.isfinite(self._heard):
            draft.area(self.area, access_points=self.fits(self._heard))
        for device, offset in self._offsets.items():
            draft.device(device, radio_offset=offset)

    def state(self) -> dict[str, Any]:
        """Return all it knows."""
        return {
            "access_points": list(self.points),
            "evidence": self._evidence.state(),
            "changes": self._changes.state(),
            "offsets": dict(self._offsets),
            "taught": self._taught if np.isfinite(self._taught) else None,
            "active": None if self._live.model is None else pack_radio_model(self._live.model),
        }  # fmt: skip

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``, access points known again by their names; what is of one that is no more goes.

        Raises:
            ValueError: it is no such state; nothing is changed then.
        """
        evidence = RadioEvidence(len(self.points), self._prior)
        changes = Changes(self._file, self._lower, self._upper, self._prior)
        live = LiveRadio(self._file, self._site)
        try:
            columns = columns_today(state["access_points"], self.points)
            changes.restore(state["changes"], columns)
            offsets = {str(device): float(offset) for device, offset in state["offsets"].items()}
            taught = -np.inf if state["taught"] is None else float(state["taught"])
            file = None if state["active"] is None else msgspec.convert(state["active"], RadioModelFile)
            with suppress(RadioModelError):  # of other access points: fusion passes over it, too
                live.take(file)
            evidence.restore(state["evidence"], columns)
        except (KeyError, TypeError, IndexError, AttributeError, ValueError) as error:
            raise ValueError(f"radio lessons of area {self.area}: {error!r}") from error
        self._evidence, self._changes, self._offsets = evidence, changes, offsets
        self._taught, self._live, self._reference = taught, live, None

    def _fit(self, visits: Visits, age: Array, kept: Array) -> RadioFit:
        faded = kept * 0.5 ** (age / self._settings.half_life)
        return fit_radio(
            self._changes.guess, self._lower, self._upper, visits, kept=faded, prior=self._prior,
            devices=len(self._evidence.devices), site=self._site,
        )  # fmt: skip

    def _refit(self, until: float) -> RadioFit:
        self._numbers = self._evidence.renumbered
        return self._fit(*self._teaching(until=until))

    def _teaching(
        self, since: float = -np.inf, until: float = np.inf, *, sure: bool = False
    ) -> tuple[Visits, Array, Array]:
        """Return visits as ``RadioEvidence.visits`` does, of the access points whose place is known by now."""
        visits, age, kept = self._evidence.visits(since, until, sure=sure)
        placed = self._changes.guess.placed[visits.point]
        return visits.where(placed), age[placed], kept[placed]

    def _known(self, point: int, now: float) -> Known:
        where, place = self._changes.located.get(point), self._changes.guess.positions[point]
        return Known(
            filed=bool(self._file.placed[point]),
            visits=self._evidence.count(point),
            silent=self._hearing.silent(point, now),
            change=self._changes.found.get(point),
            doubted=self._live.model is not None and is_doubted(self._live.model, point),
            place=None if where is None else (float(place[0]), float(place[1]), float(place[2])),
            place_error=self._placing.unclear.get(point) if where is None else where.error,
        )
