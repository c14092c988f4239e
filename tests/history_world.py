"""What history's tests have in common: frames of people who walk, a store of its own."""

import math
from collections.abc import Sequence
from pathlib import Path

from sqlalchemy import Engine

from services.history.database import migrate, open_history
from services.history.entries import Entry
from services.history.store import Store
from shared.messages import TrackFrame

MINUTE = 60.0
NOON = 1767268800.0
"""1 January 2026, 12:00 UTC."""


def frame(
    t: float,
    people: Sequence[tuple[int, float, float, str | None]],
    unseen: Sequence[str] = (),
    former: dict[int, list[int]] | None = None,
    area: str = "hall",
) -> TrackFrame:
    """Everybody at ``t``: track, x, y and device."""
    n = len(people)
    former = former or {}
    return TrackFrame(
        t=t,
        area=area,
        chunk=int(t),
        tracker="test",
        track=[track for track, _, _, _ in people],
        floor=["ground"] * n,
        x=[x for _, x, _, _ in people],
        y=[y for _, _, y, _ in people],
        covariance=[(0.04, 0.0, 0.04)] * n,
        vx=[0.0] * n,
        vy=[0.0] * n,
        state=["unseen" if device in unseen else "confirmed" for _, _, _, device in people],
        device=[device for _, _, _, device in people],
        probability=[0.9] * n,
        runner_up=[None] * n,
        runner_up_probability=[0.0] * n,
        former=[former.get(track, []) for track, _, _, _ in people],
        sources=[[] for _ in range(n)],
        quality=[1.0] * n,
    )


def walker(t: float, start: float = NOON) -> tuple[float, float]:
    """Where somebody is who goes round in the hall at 1 m/s."""
    angle = (t - start) / 4.0
    return 10.0 + 4.0 * math.cos(angle), 6.0 + 4.0 * math.sin(angle)


def fresh(folder: Path, name: str = "history.db") -> Engine:
    """An engine of a new SQLite database with the tables."""
    url = f"sqlite:///{folder / name}"
    migrate(url)
    return open_history(url)


def bring_in(engine: Engine, entries: Sequence[Entry], name: str = "") -> None:
    """Put entries into a database as a file of the spool."""
    name = name or f"{id(entries)}"
    assert Store(engine).apply(name, entries, [name]).refused == []
