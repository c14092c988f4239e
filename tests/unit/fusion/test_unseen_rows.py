"""A device no camera sees goes on under its last track's number, never under or from one that is still seen."""

from types import SimpleNamespace
from typing import Any

import numpy as np

from services.fusion.evidence.unseen import UnseenRows


def layer(alive: list[int], chain: list[int]) -> Any:
    """One device, lately left by a camera; ``alive``: the tracks that are seen now."""
    return SimpleNamespace(
        settings=SimpleNamespace(told=60.0, claim_scans=3, largest_sigma=5.0),
        columns=SimpleNamespace(
            history=SimpleNamespace(newest=10.0), tracks=np.array([1, 2]), alive=np.isin([1, 2], alive)
        ),
        devices=["phone"],
        given=np.array([-1]),
        told=np.array([9.0]),
        scans=np.array([10]),
        estimates={0: (np.array([3.0, 3.0]), np.eye(2), 0.9)},
        chains=[chain],
        view=SimpleNamespace(everywhere=SimpleNamespace(depth_at=lambda places: np.ones(len(places)))),
    )


def test_who_is_still_seen_is_in_nobodys_past() -> None:
    rows = UnseenRows()
    (row,) = rows.rows(layer(alive=[2], chain=[1, 2]), {2}, lambda: 77)
    assert (row.track, row.former) == (77, [1])
    (row,) = rows.rows(layer(alive=[], chain=[1, 2]), set(), lambda: 78)
    assert (row.track, row.former) == (77, [1, 2])
