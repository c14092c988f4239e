"""How well are a phone's stamps brought to the server's clock? Offsets, drifts and journeys drawn at random."""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from services.gateway.phones.clock import ClockAligner

__all__ = ["JOURNEYS", "MinimumDelay", "aligned", "measure"]

Array = NDArray[np.float64]

OFFSET, DRIFT = 30.0, 1e-4
PHONES = 200
SECONDS = 300
SETTLED = 30
"""Seconds after which stamps must be right."""
ABSENCE = 3600
"""Seconds without network; then everything measured meanwhile is sent at once, in batches of four minutes."""
FLUSHED = 240

JOURNEYS: dict[str, Callable[[np.random.Generator, int], Array]] = {
    "even": lambda rng, n: rng.uniform(0.02, 0.5, (n, 2)),
    "heavy_tailed": lambda rng, n: np.clip(0.02 + 0.08 * rng.pareto(1.5, (n, 2)), 0.02, 10.0),
    "slow_uplink": lambda rng, n: np.column_stack([rng.uniform(0.05, 0.5, n), rng.uniform(0.02, 0.1, n)]),
}
"""Seconds there and back of n requests, (n, 2)."""


class MinimumDelay:
    """The rival: the tightest bounds of the last two minutes and no drift (NTP's clock filter, RFC 5905 §10)."""

    drift = 0.0
    WINDOW = 120.0

    def __init__(self) -> None:
        self._upper: deque[tuple[float, float]] = deque()
        self._lower: deque[tuple[float, float]] = deque()

    def observe(self, sent: float, received: float, echo: tuple[float, float] | None = None) -> float:
        """Take the stamps of a request; see ``ClockAligner``."""
        self._upper.append((received, received - sent))
        if echo is not None:
            self._lower.append((received, echo[0] - echo[1]))
        for bounds in (self._upper, self._lower):
            while bounds and bounds[0][0] < received - self.WINDOW:
                bounds.popleft()
        return self.offset_at(sent)

    def offset_at(self, _t: float) -> float:
        """Return the offset, which is the same at any time."""
        upper = min(bound for _, bound in self._upper)
        return (upper + max(bound for _, bound in self._lower)) / 2.0 if self._lower else upper


def aligned(
    aligner: ClockAligner | MinimumDelay, journeys: Array, offset: float, drift: float, echo: bool
) -> tuple[Array, Array]:
    """Return the errors of stamps, s: those of a phone that posts every second, then of an hour flushed at once.

    Args:
        aligner: fresh.
        journeys: (n, 2) s; the last ``ABSENCE / FLUSHED`` are those of the flush.
        offset: of the phone's clock at the start, s; ``drift``: s per s.
        drift: see above.
        echo: whether replies are echoed.
    """
    flushes = ABSENCE // FLUSHED

    def phone(server: float) -> float:
        return server + offset + drift * (server - 1e9)

    last: tuple[float, float] | None = None
    live: list[float] = []
    flushed: list[float] = []
    for k, (up, down) in enumerate(journeys):
        absent = k - (len(journeys) - flushes)
        sent = 1e9 + k + (ABSENCE if absent >= 0 else 0)
        aligner.observe(phone(sent), sent + up, last)
        last = (sent + up, phone(sent + up + down)) if echo else None
        measured = np.array([sent - 0.5])
        if absent >= 0:
            measured = sent - ABSENCE + FLUSHED * absent + np.arange(0.0, FLUSHED, 10.0)
        errors = [aligner.offset_at(phone(t)) + phone(t) - t for t in measured]
        (flushed if absent >= 0 else live).extend(errors)
    return np.abs(live[SETTLED:]), np.abs(flushed)


def measure(seed: int) -> dict[str, float]:
    """Return 95th percentiles of the errors of aligned stamps, ms.

    ``clock_p95_ms`` is the worst of all kinds of journeys, with and without echo; the others name theirs.
    """
    figures: dict[str, float] = {}
    for name, draw in JOURNEYS.items():
        for echo in (True, False):
            errors: dict[str, list[Array]] = {"": [], "_flushed": [], "_rival": [], "_flushed_rival": []}
            for k in range(PHONES):
                rng = np.random.default_rng([seed, k])
                offset, drift = rng.uniform(-OFFSET, OFFSET), rng.uniform(-DRIFT, DRIFT)
                journeys = draw(rng, SECONDS + ABSENCE // FLUSHED)
                for rival, aligner in (("", ClockAligner()), ("_rival", MinimumDelay())):
                    live, flushed = aligned(aligner, journeys, offset, drift, echo)
                    errors[rival].append(live)
                    errors[f"_flushed{rival}"].append(flushed)
            for kind, found in errors.items():
                figures[f"clock{kind}_{name}{'' if echo else '_no_echo'}_p95_ms"] = 1000.0 * float(
                    np.percentile(np.concatenate(found), 95)
                )
    worst = {}
    for kind in ("", "_flushed", "_rival", "_flushed_rival"):
        mine = [
            value
            for name, value in figures.items()
            if any(name.startswith(f"clock{kind}_{journey}") for journey in JOURNEYS)
        ]
        worst[f"clock{kind}_p95_ms"] = max(mine)
    return worst | figures


if __name__ == "__main__":
    sys.stdout.write("".join(f"{name}: {value:.1f}\n" for name, value in measure(0).items()))
