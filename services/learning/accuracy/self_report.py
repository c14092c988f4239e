"""Self-reported accuracy: what live names and places are worth, judged by what had not been seen when they were told.

A named position is off by two things. Its track's place errs as fusion says it does. And the name may be wrong, and
then the phone is where somebody else is: how likely that is tells what the phone says in the *next* seconds, held
against the track it was named on and all others (``claims``), over all recent names (``name_shares``). Bounded: the
last minute of the bus, and some hundreds of claims.
"""

from __future__ import annotations

import math
import zlib
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.accuracy.claims import Claim, claim_of
from services.learning.accuracy.name_shares import right_probabilities
from services.learning.tracks.along import along
from services.learning.tracks.crowd import Crowd, followed_in, others_of
from services.learning.tracks.phones import PhoneRows, Phones
from services.learning.tracks.radio_evidence import RadioBelief
from services.learning.tracks.stretch import SAME, Stretch
from shared.learning_report import AccuracyReport
from shared.messages import MotionBatch, RadioScan, TrackFrame
from shared.radio import PathLoss, ShadowingMap
from shared.site import Site, camera_views

__all__ = ["SelfReport"]

Array = NDArray[np.float64]

HORIZON = 8.0
"""Seconds after a name was told whose evidence judges it: later tracks pass to others, and a right name looks wrong."""
LATE = 8.0
"""Seconds waited for what phones tell late."""
KEPT = 2.0 * (HORIZON + LATE)
"""Seconds kept of a phone."""
CLAIMS = 600
"""Claims remembered."""
AGAIN = 4.0
"""Seconds between two claims of a phone, at least."""
PER_SECOND = 1.0
"""Claims judged per second, at most; where there are more names, fewer of them are."""
OLDEST = 3600.0
"""Seconds after which a claim no longer counts."""
HEARD = 5.0
"""Seconds since a phone last told anything for which it counts as heard."""
TOGETHER = 4.0
"""Claims that are right or wrong together: what is told every few seconds is judged by much the same evidence."""
SIGMAS = 1.28
"""Standard deviations of the share of wrong names, between which (80 %) the p90 is looked at …"""
UNSURE = 2.0
"""… and if it differs by more than this factor, it is not told: names are wrong in about a tenth of the time, and
whether it is a little less or more decides between centimetres and metres."""
FEWEST = 10
"""Claims from which on anything is reported."""
MEMORY = 900.0
"""Seconds after which what was counted of named time weighs 1/e."""
RAYLEIGH = np.sqrt(-np.log(1.0 - (np.arange(5) + 0.5) / 5.0))
"""Five equally likely lengths of an error, in units of its root mean square."""
EVERY = 1.0
"""Seconds between two kept pictures of everybody."""


@dataclass(frozen=True)
class _Everybody(Crowd):
    """Also (n, 3) covariances, xx, xy and yy in m², and the names: track and probability."""

    covariance: Array
    named: dict[str, tuple[int, float]]


class SelfReport:
    """Judges one area's names; feed it messages in the order in which they come.

    Args:
        points: ids of the area's access points.
        elsewhere: (e, 2) places of the floor where no camera looks.
    """

    def __init__(self, points: tuple[str, ...], elsewhere: Array) -> None:
        self._elsewhere = elsewhere
        self._pictures: deque[_Everybody] = deque()
        self._phones = Phones(points, KEPT)
        self._claims: deque[Claim] = deque(maxlen=CLAIMS)
        self._heard, self._named, self._seconds = 0.0, 0.0, 0.0

    @classmethod
    def of(cls, site: Site, area: str) -> SelfReport:
        """Return the report of one area of a site.

        Raises:
            KeyError: the site has no such area.
        """
        floor = site.area(area).floor
        plan = site.floor(floor).plan()
        views = camera_views(site, area, plan)
        axes = [np.arange(low, high, 1.0) for low, high in zip(views.lower, views.upper, strict=True)]
        places = np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)
        hidden = plan.contains(places) & (views.everywhere.depth_at(places) <= 0.0)
        return cls(tuple(point.id for point in site.access_points if point.floor == floor), places[hidden])

    def take_frame(self, frame: TrackFrame) -> None:
        """Take in who is where, as told live."""
        last = self._pictures[-1].t if self._pictures else -math.inf
        if frame.t < last - LATE:
            self._pictures.clear()  # a clock set back
            self._phones.clear()
        elif frame.t < last + EVERY - SAME:
            return
        self._phones.take_time(frame.t)
        rows, ids, places = followed_in(frame)
        named: dict[str, tuple[int, float]] = {}
        for row in rows:
            device = frame.device[row]
            if device is not None:
                named[device] = (frame.track[row], frame.probability[row])
        covariance = np.array([frame.covariance[row] for row in rows], float).reshape(-1, 3)
        self._pictures.append(_Everybody(frame.t, ids, places, covariance, named))
        heard = sum(phone.newest >= frame.t - HEARD for phone in self._phones.values())
        kept = math.exp(-EVERY / MEMORY)
        self._heard, self._named = kept * self._heard + max(heard, len(named)), kept * self._named + len(named)
        self._seconds += len(named) * EVERY

    def take_scan(self, scan: RadioScan) -> None:
        """Take in what a phone heard."""
        self._phones.take_scan(scan)

    def take_motion(self, batch: MotionBatch) -> None:
        """Take in how a phone walked; a batch may replace what was told before."""
        self._phones.take_motion(batch)

    def forget(self, device: str) -> None:
        """Forget a phone whose owner withdrew consent."""
        self._phones.pop(device, None)
        for picture in self._pictures:
            picture.named.pop(device, None)

    def judge(self, radio: PathLoss, shadowing: ShadowingMap | None, belief: Callable[[str], RadioBelief]) -> int:
        """Judge the names that have become old enough; return how many. To be called about once a second.

        Args:
            radio: the active model of the area's access points.
            shadowing: its map.
            belief: what earlier stretches tell of access points and of a phone (``QualityJudge.belief``).
        """
        judged = 0
        while self._pictures and self._pictures[-1].t - self._pictures[0].t >= HORIZON + LATE:
            told = self._pictures[0]
            # Each phone in its turn, whether it was named long since or just now: claims are a fair sample of the time.
            turn = math.ceil(max(AGAIN, len(told.named) / PER_SECOND))
            for device, (track, probability) in sorted(told.named.items()):
                phone = self._phones.get(device)
                if phone is not None and (round(told.t / EVERY) + zlib.crc32(device.encode())) % turn == 0:
                    after = self._after(device, phone, track, probability)
                    if after is not None:
                        self._claims.append(claim_of(after, radio, shadowing, belief(device), self._elsewhere))
                        judged += 1
            self._pictures.popleft()
        return judged

    def report(self) -> AccuracyReport:
        """Return how far off named positions are believed to be."""
        named = self._named / self._heard if self._heard else None
        newest = self._claims[-1].t if self._claims else 0.0
        claims = [claim for claim in self._claims if claim.t >= newest - OLDEST]
        if len(claims) < FEWEST:
            return AccuracyReport(named=named, seconds=self._seconds)
        right = right_probabilities(
            np.array([claim.told for claim in claims]), np.array([claim.ratio for claim in claims])
        )
        p50, p90 = _quantiles(claims, right, (0.5, 0.9))
        wrong = float(1.0 - right.mean())
        spread = math.sqrt((wrong * (1.0 - wrong) + float((right * (1.0 - right)).mean())) / (len(claims) / TOGETHER))
        likely = [max(wrong + side * SIGMAS * spread, 0.0) / max(wrong, 1e-9) for side in (-1.0, 1.0)]
        low, high = (_quantiles(claims, 1.0 - np.minimum(scale * (1.0 - right), 1.0), (0.9,))[0] for scale in likely)
        error, weight = _errors(claims, right)
        return AccuracyReport(
            rms=math.sqrt(float(weight @ error**2)),
            p50=p50,
            p90=p90 if high <= UNSURE * low else None,
            named=named,
            right=float(right.mean()),
            seconds=self._seconds,
        )

    def _after(self, device: str, phone: PhoneRows, track: int, probability: float) -> Stretch | None:
        """Return what a track did in the ``HORIZON`` after the oldest picture; None where it ended at once."""
        until = self._pictures[0].t + HORIZON
        own = [(picture, picture.row_of(track)) for picture in self._pictures if picture.t <= until]
        about = [(picture, row) for picture, row in own if row is not None]
        if len(about) < 2:
            return None
        t = np.array([picture.t for picture, _ in about])
        place = np.array([picture.place[row] for picture, row in about])
        covariance = np.array([picture.covariance[row] for picture, row in about])[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
        others = others_of(self._pictures, track, t, place)
        return along(device, phone, track, t, place, covariance, np.full(len(t), probability), others=others)


def _errors(claims: Sequence[Claim], right: Array) -> tuple[Array, Array]:
    """Return errors (k,) in ascending order, metres, and how likely each is: as tracks err where names are right, as
    far as their phones may be where not."""
    errors, weights = [], []
    for claim, probability in zip(claims, right.tolist(), strict=True):
        errors += [RAYLEIGH * math.sqrt(claim.variance), claim.away]
        weights += [np.full(len(RAYLEIGH), probability / len(RAYLEIGH)), (1.0 - probability) * claim.weight]
    error, weight = np.concatenate(errors), np.concatenate(weights)
    order = np.argsort(error)
    return error[order], weight[order] / weight.sum()


def _quantiles(claims: Sequence[Claim], right: Array, shares: Sequence[float]) -> list[float]:
    error, weight = _errors(claims, right)
    found: list[float] = np.interp(shares, np.cumsum(weight) - 0.5 * weight, error).tolist()
    return found
