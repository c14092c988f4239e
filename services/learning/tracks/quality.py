"""How good is a stretch, and may it teach?

Quality is the sum of [ravel-thesis §8.1, Eq. 5.1] over the whole composite: what cameras say for the track
(``sight.SightScore``), what the phone's radio says for its places against no places at all (the clutter of §6.5a), and
what its steps say for its way. Beside the sum stands the rate per second, which does not depend on how long the stretch
is. What decides is split: cameras' part says how well somebody was followed, the phone's part whether it was its
carrier. The phone's part has a threshold chosen from the data, and ``swaps`` looks for what a high score may hide.
"""

from __future__ import annotations

import hashlib
import itertools
from collections import Counter, OrderedDict, deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.compare import Comparison, compare
from services.learning.tracks.radio_evidence import RadioBelief
from services.learning.tracks.radio_habits import RadioHabits
from services.learning.tracks.sight import SightScore
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.swaps import AMBIGUOUS, CONTRADICTIONS, doubt
from services.learning.tracks.threshold import REFUSED, Threshold
from services.learning.tracks.verdict import Verdict
from shared.learning_report import TrackLessons
from shared.radio import PathLoss, ShadowingMap

__all__ = ["QualityJudge", "SightScore"]

Integers = NDArray[np.int64]

SHORTEST = 8.0
"""Seconds below which nothing can be said."""
PART = 15.0
"""Seconds of a part of a stretch that is judged by itself."""
FIRST = 0.3
"""Nats per second of the phone's part that are enough until the data tell."""
LIAR = 3
"""Stretches of a phone's last ``REMEMBERED`` that contradict its radio and are as many as those that do not: none of
what it tells is believed until that is past."""
REMEMBERED = 10
PHONES = 500
"""Phones of which that is remembered."""
SHORT, HARDLY_SEEN = "too short to judge", "cameras saw too little of the person"
UNTOLD = frozenset({SHORT, HARDLY_SEEN, AMBIGUOUS})
"""Nothing speaks against these; only it is not sure."""
LEAST_SEEN = 0.5
"""Share of the time cameras must have seen the track."""
MISFITS, ENOUGH_MISFIT = 40, 5
"""Stretches whose misfit tells what is usual, good or not: most are right, and after a change it must not take long."""
RECENT = 200
"""Stretches told of in the report."""


class QualityJudge:
    """Judges the stretches of one area, in order of time.

    Args:
        points: how many access points the area has.
        seed: of which other person a phone is held against to see what a wrong name scores.
    """

    def __init__(self, points: int, seed: int = 0) -> None:
        self._points = points
        self._habits = RadioHabits(points)
        self._threshold = Threshold(FIRST)
        self._contradicted: OrderedDict[str, deque[bool]] = OrderedDict()
        self._rng = np.random.default_rng(seed)
        self._recent: deque[tuple[str, float]] = deque(maxlen=RECENT)
        self._misfit: deque[float] = deque(maxlen=MISFITS)
        self._model: tuple[PathLoss, ShadowingMap | None] | None = None
        self._mark = ""

    def judge(self, stretch: Stretch, radio: PathLoss, shadowing: ShadowingMap | None = None) -> Verdict:
        """Return what is thought of a stretch.

        Args:
            stretch: of the area; stretches come in order of time.
            radio: the active model of its access points, in the order of ``stretch.point``.
            shadowing: the active model's map, if it has one.
        """
        if self._model is None or self._model[0] is not radio or self._model[1] is not shadowing:
            mark = _mark(radio, shadowing)
            if mark != self._mark:
                self._habits.begin_anew(mapped=shadowing is not None)
            self._model, self._mark = (radio, shadowing), mark
        belief = self._habits.belief(stretch.device)
        whole = compare(stretch, radio, shadowing, belief)
        printed = float(stretch.sight.sum() + whole.total[0])
        rate = printed / max(stretch.seconds, 1e-9)
        reason = _too_little(stretch)
        if not reason:
            usual = float(np.median(self._misfit)) if len(self._misfit) >= ENOUGH_MISFIT else 1.0
            reason = doubt(whole, self._parts(stretch, belief), usual)
            score, other = _score(whole, reason), self._other_score(whole, usual)
            reason = self._decided(stretch.device, reason, score)
            if whole.fit is not None:
                self._threshold.add(score, other)
                self._misfit.append(float(whole.fit.chi2[0]) / whole.fit.readings)
                if not reason:
                    self._habits.learn(stretch.device, whole.fit)
        self._habits.hear(stretch.point, stretch.level)
        self._recent.append((reason, rate))
        return Verdict(printed, rate, not reason, reason, reason in UNTOLD and not self._liar(stretch.device))

    def belief(self, device: str) -> RadioBelief:
        """Return what good stretches tell so far of access points and of a phone, beyond the active model."""
        return self._habits.belief(device)

    def lessons(self) -> TrackLessons:
        """Return how many of the last stretches were good, and why the others were not."""
        good = [rate for reason, rate in self._recent if not reason]
        return TrackLessons(
            good=len(good),
            refused=dict(Counter(reason for reason, _ in self._recent if reason)),
            threshold=self.threshold,
            quality=float(np.median(good)) if good else None,
        )

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent."""
        self._habits.forget(device)
        self._contradicted.pop(device, None)

    def state(self) -> dict[str, Any]:
        """Return all it knows, as what ``msgspec.json`` encodes."""
        return {
            "model": self._mark,
            "habits": self._habits.state(),
            "threshold": self._threshold.state(),
            "contradicted": [[device, list(told)] for device, told in self._contradicted.items()],
            "recent": [list(row) for row in self._recent],
            "misfit": list(self._misfit),
        }

    def restore(self, state: Mapping[str, Any], columns: Integers | None = None) -> None:
        """Go on from ``state()``.

        Args:
            state: see there.
            columns: (k,) which access point here each of the k of the state is; −1: none; None: they are the same.

        Raises:
            ValueError: it is no such state, or of other access points; the judge is then unchanged.
        """
        try:
            self._restore(state, columns)
        except (KeyError, TypeError, AttributeError) as error:
            raise ValueError(f"not a state of a judge of stretches: {error}") from error

    @property
    def threshold(self) -> float | None:
        """Nats per second of the phone's part that are enough; None where nothing is."""
        value = self._threshold.value
        return value if np.isfinite(value) else None

    def _restore(self, state: Mapping[str, Any], columns: Integers | None) -> None:
        habits, threshold = RadioHabits(self._points), Threshold(FIRST)
        mark = str(state["model"])
        habits.restore(state["habits"], columns)
        threshold.restore(state["threshold"])
        contradicted = OrderedDict(
            (str(device), deque([bool(one) for one in told], maxlen=REMEMBERED))
            for device, told in state["contradicted"]
        )
        recent = [(str(reason), float(rate)) for reason, rate in state["recent"]]
        misfit = [float(one) for one in state["misfit"]]
        self._habits, self._threshold, self._contradicted = habits, threshold, contradicted
        self._model, self._mark = None, mark
        self._recent, self._misfit = deque(recent, maxlen=RECENT), deque(misfit, maxlen=MISFITS)

    def _parts(self, stretch: Stretch, belief: RadioBelief) -> list[Comparison]:
        if stretch.seconds < 2.0 * PART:
            return []
        borders = np.linspace(stretch.t[0], stretch.t[-1], int(stretch.seconds // PART) + 1).tolist()
        return [compare(stretch, *self._active(), belief, begin, end) for begin, end in itertools.pairwise(borders)]

    def _other_score(self, whole: Comparison, usual: float) -> float | None:
        """Return what the phone would score on somebody else's track; None where nobody was about."""
        others = whole.others
        if not len(others):
            return None
        wrong = whole.as_if_on(int(self._rng.choice(others)))
        return _score(wrong, doubt(wrong, (), usual))

    def _decided(self, device: str, reason: str, score: float) -> str:
        if self._lies(device, reason in CONTRADICTIONS):
            return "this phone's radio was wrong too often lately"
        if reason:
            return reason
        if not np.isfinite(self._threshold.value):
            return "no phone here fits its own track better than it fits others"
        return "" if score >= self._threshold.value else "radio and steps fit too little of the way"

    def _lies(self, device: str, contradicted: bool) -> bool:
        """Note whether a stretch contradicted a phone's radio; return whether too many of its last ones did."""
        told = self._contradicted.pop(device, None) or deque(maxlen=REMEMBERED)
        told.append(contradicted)
        self._contradicted[device] = told
        while len(self._contradicted) > PHONES:
            self._contradicted.popitem(last=False)
        return self._liar(device)

    def _liar(self, device: str) -> bool:
        told = self._contradicted.get(device, ())
        return sum(told) >= LIAR and 2 * sum(told) >= len(told)

    def _active(self) -> tuple[PathLoss, ShadowingMap | None]:
        if self._model is None:
            raise RuntimeError("no stretch was judged yet")
        return self._model


def _too_little(stretch: Stretch) -> str:
    if stretch.seconds < SHORTEST:
        return SHORT
    return HARDLY_SEEN if stretch.seen.mean() < LEAST_SEEN else ""


def _score(comparison: Comparison, reason: str) -> float:
    """Return nats per second of the phone's part, or ``REFUSED``."""
    return REFUSED if reason else float(comparison.total[0]) / comparison.seconds


def _mark(radio: PathLoss, shadowing: ShadowingMap | None) -> str:
    """Return what tells this model from others, also after a restart."""
    parts = [radio.positions, radio.power_1m, radio.exponent, *([] if shadowing is None else [shadowing.mean])]
    order = np.argsort(radio.names)  # the same model where the site file lists its access points otherwise
    return hashlib.blake2b(b"".join(part[order].tobytes() for part in parts), digest_size=8).hexdigest()
