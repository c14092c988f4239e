"""The default tracker: anonymous positions from the cameras, names from phones' radio and steps."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

import msgspec
import numpy as np

from services.fusion.area_view import AreaView
from services.fusion.evidence.identity import IdentityLayer
from services.fusion.evidence.identity_settings import IdentitySettings
from services.fusion.evidence.revision import Reviser
from services.fusion.evidence.unseen import UnseenRows, with_rows
from services.fusion.positions.anonymous import AnonymousLayer, AnonymousSettings
from services.fusion.snapshot import encode_snapshot
from services.fusion.tracker import Chunk, TrackerStateError
from shared.messages import Revision, TrackFrame, pack_covariances

__all__ = ["AnonymousTracker", "EvidenceTracker"]

LEAST_RIVAL = 0.01
"""Probability below which a runner-up is not worth telling."""


class AnonymousTracker:
    """Positions only: everybody stays anonymous."""

    name = "anonymous"
    cycle = 0.0

    def __init__(self, view: AreaView, settings: AnonymousSettings | None = None) -> None:
        self.positions = AnonymousLayer(view, settings)

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume one chunk."""
        self.positions.begin_chunk()
        for frame in chunk.frames:
            self.positions.observe(frame)
        return self._frame(chunk)

    def retune(self, view: AreaView) -> None:
        """Go on under another radio model, which says nothing about anonymous people."""
        self.positions.view = view

    def revision(self) -> Revision | None:
        """Return nothing: what was said stands."""
        return None

    def ignored(self) -> dict[str, int]:
        """Return how much could not be used so far, by reason."""
        return dict(self.positions.ignored)

    def complaints(self) -> list[str]:
        """Return which cameras' clocks are to be set right."""
        return self.positions.clocks.complaints()

    def snapshot(self) -> Callable[[], bytes]:
        """Copy all the tracker knows; calling the result encodes the copy."""
        return partial(encode_snapshot, {"tracker": self.name, **self._state()})

    def state(self) -> bytes:
        """Return all the tracker knows, as JSON."""
        return self.snapshot()()

    def restore(self, state: bytes) -> None:
        """Go on from a state of the same tracker."""
        try:
            parts = msgspec.json.decode(state)
            if parts["tracker"] != self.name:
                raise TrackerStateError(f"a state of tracker {parts['tracker']!r}, expected {self.name!r}")
            self._restore(parts)
        except TrackerStateError:
            raise
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise TrackerStateError(f"not a state of tracker {self.name!r}: {error}") from error

    def _state(self) -> dict[str, Any]:
        return {"positions": self.positions.state()}

    def _restore(self, parts: dict[str, Any]) -> None:
        self.positions.restore(parts["positions"])

    def _frame(self, chunk: Chunk) -> TrackFrame:
        tracks = self.positions.tracks
        told = self.positions.told().nonzero()[0]
        x, y, vx, vy = tracks.mean.take(told, axis=0).T.tolist()
        fed = tracks.fed.take(told).tolist()
        count = len(told)
        columns: dict[str, Any] = {
            "track": tracks.ids[told].tolist(),
            "device": [None] * count,
            "probability": [1.0] * count,
            "runner_up": [None] * count,
            "runner_up_probability": [0.0] * count,
            "former": [[] for _ in range(count)],
            "sources": self.positions.names_of(fed),
        }
        self._name(columns)
        return TrackFrame(
            t=max((frame.t for frame in chunk.frames if math.isfinite(frame.t)), default=chunk.t_start),
            area=self.positions.view.area,
            chunk=chunk.index,
            tracker=self.name,
            floor=[self.positions.view.floor] * count,
            x=x,
            y=y,
            vx=vx,
            vy=vy,
            covariance=pack_covariances(tracks.spread().take(told, axis=0)),
            state=["confirmed" if mask else "coasting" for mask in fed],
            quality=tracks.quality[told].tolist(),
            **columns,
        )

    def _name(self, columns: dict[str, Any]) -> None:
        """Fill in who the tracks are; nobody knows here."""


class EvidenceTracker(AnonymousTracker):
    """Positions at camera rate; on them, names as phones tell what they hear and how they walk."""

    name = "evidence"

    def __init__(
        self,
        view: AreaView,
        settings: AnonymousSettings | None = None,
        identity: IdentitySettings | None = None,
    ) -> None:
        super().__init__(view, settings)
        self.identity = IdentityLayer(view, identity)
        self.unseen = UnseenRows()
        self.reviser = Reviser()
        self._heard: set[str] = set()
        self._revision: Revision | None = None

    def step(self, chunk: Chunk) -> TrackFrame:
        """Consume one chunk."""
        self.positions.begin_chunk()
        for seen in chunk.frames:
            self.positions.observe(seen)
        tracks = self.positions.tracks
        sure = tracks.confirmed
        t = self.positions.t
        self._heard = set()
        if math.isfinite(t):
            if t < self.identity.columns.history.newest:
                self.reviser, self.unseen = Reviser(), UnseenRows()
            self._heard = self.identity.step(
                t, tracks.ids[sure], tracks.mean[sure, :2], tracks.missed[sure] > 0.5, chunk.scans, chunk.motions
            )
        for erasure in chunk.erasures:
            self.identity.erase(erasure.device)
            self.reviser.erase(erasure.device)
            self.unseen.erase(erasure.device)
            self._heard.discard(erasure.device)
        frame = self._frame(chunk)
        self._revision = self.reviser.revise(chunk.index, self.name, frame, self.identity)
        return frame

    def retune(self, view: AreaView) -> None:
        """Go on under another radio model."""
        super().retune(view)
        self.identity.retune(view)

    def revision(self) -> Revision | None:
        """Return where the last step changed what the steps before it had said."""
        return self._revision

    def ignored(self) -> dict[str, int]:
        """Return how much could not be used so far, by reason."""
        return {**super().ignored(), **self.identity.ignored}

    def _frame(self, chunk: Chunk) -> TrackFrame:
        frame = super()._frame(chunk)
        rows = self.unseen.rows(self.identity, set(frame.track), self.positions.new_id)
        return with_rows(frame, rows, self.positions.view.floor)

    def _name(self, columns: dict[str, Any]) -> None:
        layer = self.identity
        if not columns["track"] or not any(device is not None for device in layer.devices):
            return
        places = layer.columns.of(np.array(columns["track"]))
        chances = layer.probability[:, places]
        owner = np.full(len(layer.columns.tracks), -1)
        owner[layer.given[layer.given >= 0]] = np.flatnonzero(layer.given >= 0)
        owners = owner[places]
        owned = np.flatnonzero(owners >= 0)
        sure = np.maximum(1.0 - chances.sum(axis=0), 0.0)
        sure[owned] = chances[owners[owned], owned]
        columns["probability"] = np.minimum(sure, 1.0).tolist()
        rivals = chances.copy()
        rivals[owners[owned], owned] = -1.0
        best = rivals.argmax(axis=0)
        rated = np.minimum(rivals[best, np.arange(len(places))], 1.0).tolist()
        for index, (row, rival) in enumerate(zip(owners.tolist(), best.tolist(), strict=True)):
            columns["former"][index] = layer.former.get(columns["track"][index], [])
            if row >= 0:
                columns["device"][index] = layer.devices[row]
                if layer.devices[row] in self._heard:
                    columns["sources"][index].append(layer.devices[row])
            if rated[index] > LEAST_RIVAL and layer.devices[rival] is not None:
                columns["runner_up"][index] = layer.devices[rival]
                columns["runner_up_probability"][index] = rated[index]

    def _state(self) -> dict[str, Any]:
        return {
            **super()._state(),
            "identity": self.identity.state(),
            "reviser": self.reviser.state(),
            "unseen": self.unseen.state(),
        }

    def _restore(self, parts: dict[str, Any]) -> None:
        # Restored into fresh ones first: a broken state leaves the tracker as it was.
        positions = AnonymousLayer(self.positions.view, self.positions.settings)
        positions.restore(parts["positions"])
        identity = IdentityLayer(self.positions.view, self.identity.settings)
        identity.restore(parts["identity"])
        reviser, unseen = Reviser.restored(parts["reviser"]), UnseenRows.restored(parts["unseen"])
        self.positions, self.identity, self.reviser, self.unseen = positions, identity, reviser, unseen
        self._revision = None
