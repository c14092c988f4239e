"""One name that was told, and what spoke for it and against it afterwards."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.learning.tracks.compare import compare
from services.learning.tracks.radio_evidence import RadioBelief
from services.learning.tracks.stretch import Stretch
from shared.radio import PathLoss, ShadowingMap

__all__ = ["Claim", "claim_of"]

Array = NDArray[np.float64]

TRUST = 0.6
"""Share of the nats that is believed, one place against another: noise that is not Gaussian makes them too large."""
HEEDED = 0.3
"""Share of the ratio that is believed, right against wrong: a track may pass to somebody else within the time, and then
what its phone says contradicts a name that was right."""
ELSEWHERE = 0.3
"""Probability, of a wrong name, that its phone is where no camera looks."""
NEAR = 2.0
"""Metres at which a person is 1/e as likely to be mistaken for another: radio tells people apart by where they are."""
TINY = 1e-12
KEPT = 6
"""Wrong places kept of a claim, the likeliest."""


@dataclass(frozen=True)
class Claim:
    """A name on a track at one time.

    Attributes:
        t: seconds since the epoch.
        told: probability of the name being right, as fusion said.
        variance: m², of the track's place, both axes together.
        ratio: log-likelihood of what the phone said in the next seconds with the name right, less that with it wrong,
            as far as it is believed.
        away: (k,) metres from the track to where the phone else may have been.
        weight: (k,) how likely each of these is if the name is wrong; sum 1.
    """

    t: float
    told: float
    variance: float
    ratio: float
    away: Array
    weight: Array


def claim_of(
    after: Stretch,
    radio: PathLoss,
    shadowing: ShadowingMap | None,
    belief: RadioBelief,
    elsewhere: Array,
) -> Claim:
    """Return the claim that ``after``'s first row makes, judged by all of it.

    Args:
        after: the track from the time of the claim on, with what the phone said meanwhile, whoever bore the name then.
        radio: the active model.
        shadowing: its map.
        belief: what earlier stretches tell.
        elsewhere: (e, 2) places where no camera looks.
    """
    compared = compare(after, radio, shadowing, belief)
    others = compared.others
    # Nats are against a phone that may be anywhere: somebody who is elsewhere has none.
    nats = TRUST * np.concatenate([compared.total[others], [0.0]])
    here = after.place[0]
    beside = np.exp(-compared.away_first[others] / NEAR)
    hidden = np.hypot(*(elsewhere - here).T)
    hidden_share = np.exp(-(hidden - hidden.min(initial=np.inf)) / NEAR) if len(hidden) else np.zeros(0)
    share = np.append((1.0 - ELSEWHERE) * beside / max(float(beside.sum()), TINY), ELSEWHERE)
    logs = np.log(share + TINY) + nats
    most = float(logs.max())
    wrong = most + math.log(float(np.exp(logs - most).sum()))
    weight = np.exp(logs - wrong)
    beyond = math.sqrt(float(hidden_share @ hidden**2) / float(hidden_share.sum())) if len(hidden) else 0.0
    away = np.append(compared.away_first[others], beyond)
    likeliest = np.argsort(weight)[-KEPT:]
    return Claim(
        t=float(after.t[0]),
        told=float(after.probability[0]),
        variance=float(np.trace(after.covariance[0])),
        ratio=HEEDED * (TRUST * float(compared.total[0]) - wrong),
        away=away[likeliest],
        weight=weight[likeliest] / weight[likeliest].sum(),
    )
