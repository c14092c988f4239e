"""What is told of devices that no camera sees: a row each, carried by their steps and radio alone."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from services.fusion.evidence.identity import IdentityLayer
from shared.messages import TrackFrame, pack_covariances

__all__ = ["UnseenRow", "UnseenRows", "with_rows"]

Array = NDArray[np.float64]

NEAR = 3.0
"""Metres outside the cameras' view within which a device is told: farther off it is another area's."""


@dataclass(frozen=True, slots=True)
class UnseenRow:
    """One device: its track id, (2,) place in metres, (2, 2) covariance in m², the probability of its being there."""

    device: str
    track: int
    place: Array
    covariance: Array
    probability: float
    former: list[int]


class UnseenRows:
    """Which track id stands for which device while no camera sees it: its last track's, or a fresh one."""

    def __init__(self) -> None:
        self._ids: dict[str, int] = {}

    def rows(self, layer: IdentityLayer, told: set[int], new_id: Callable[[], int]) -> list[UnseenRow]:
        """Return the rows of this moment.

        Args:
            layer: who is where.
            told: ids of the tracks that cameras see.
            new_id: gives a track id that nobody has.
        """
        alive = set(layer.columns.tracks[layer.columns.alive].tolist())
        rows = []
        kept: dict[str, int] = {}
        for row in _told(layer):
            device = layer.devices[row]
            if device is None:
                continue
            place, covariance, probability = layer.estimates[row]
            chain = layer.chains[row]
            track = self._ids.get(device, 0)
            if not track or track in alive or track in told:
                last = chain[-1] if chain else 0
                track = last if last and last not in alive and last not in told else new_id()
            kept[device] = track
            # Who is still seen is somebody else by now: this row comes of none of them.
            former = [one for one in chain if one != track and one not in alive and one not in told]
            rows.append(UnseenRow(device, track, place, covariance, probability, former))
        self._ids = kept
        return rows

    def erase(self, device: str) -> None:
        """Forget a device."""
        self._ids.pop(device, None)

    def state(self) -> dict[str, Any]:
        """Return a copy."""
        return dict(self._ids)

    @classmethod
    def restored(cls, state: dict[str, Any]) -> UnseenRows:
        """Return what ``state()`` was taken of."""
        rows = cls()
        rows._ids = {str(device): int(track) for device, track in state.items()}
        return rows


def _told(layer: IdentityLayer) -> list[int]:
    """Return the rows of the devices that no camera sees and that are known well enough to be told, in order."""
    s, t = layer.settings, layer.columns.history.newest
    fresh = (layer.given < 0) & (t - layer.told <= s.told) & (layer.scans >= s.claim_scans)
    rows = [row for row in np.flatnonzero(fresh).tolist() if row in layer.estimates]
    if not rows:
        return []
    places, covariances, probability = zip(*(layer.estimates[row] for row in rows), strict=True)
    largest = np.linalg.eigvalsh(np.array(covariances))[:, -1]
    near = layer.view.everywhere.depth_at(np.array(places)) > -NEAR
    known = near & (largest <= s.largest_sigma**2) & (np.array(probability) >= 0.5)
    return [row for row, good in zip(rows, known.tolist(), strict=True) if good]


def with_rows(frame: TrackFrame, rows: list[UnseenRow], floor: str) -> TrackFrame:
    """Return the frame with rows for the devices no camera sees."""
    if not rows:
        return frame
    count = len(rows)
    return msgspec.structs.replace(
        frame,
        track=[*frame.track, *(row.track for row in rows)],
        floor=[*frame.floor, *[floor] * count],
        x=[*frame.x, *(float(row.place[0]) for row in rows)],
        y=[*frame.y, *(float(row.place[1]) for row in rows)],
        covariance=[*frame.covariance, *pack_covariances(np.array([row.covariance for row in rows]))],
        vx=[*frame.vx, *[0.0] * count],
        vy=[*frame.vy, *[0.0] * count],
        state=[*frame.state, *["unseen"] * count],
        device=[*frame.device, *(row.device for row in rows)],
        probability=[*frame.probability, *(row.probability for row in rows)],
        runner_up=[*frame.runner_up, *[None] * count],
        runner_up_probability=[*frame.runner_up_probability, *[0.0] * count],
        former=[*frame.former, *(row.former for row in rows)],
        sources=[*frame.sources, *([row.device] for row in rows)],
        quality=[*frame.quality, *[0.0] * count],
    )
