"""Which pairs of a track and a border matter now, and how surely must somebody be beyond a border?"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from services.geofence.evidence import SURE
from services.geofence.pairs import Frame, Pairs
from services.geofence.zone_index import ZoneIndex

__all__ = ["Borders"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

_NARROW = 0.5
"""Of the half width of an area that is the margin's most: who is in the middle of a narrow one is in it."""


class Borders:
    """The borders of a site and how surely somebody must be beyond them.

    Args:
        index: where they are.
        margin: metres outside of a border in which somebody inside is not taken to have left.
        min_seconds: for which somebody must surely be on the other side.
        confidence: (borders,) how probable it must be that somebody is inside, or beyond the line; None: a half.
    """

    def __init__(self, index: ZoneIndex, margin: float, min_seconds: float, confidence: Floats | None = None) -> None:
        self.index = index
        self.margin = margin
        self.min_seconds = min_seconds
        self.margins: Floats = np.minimum(margin, _NARROW * index.half_width)
        """(borders,) metres."""
        half = np.full(len(index), 0.5)
        self.demands: Floats = np.asarray(ndtri(half if confidence is None else confidence), float)
        """(borders,) standard deviations that ``confidence`` asks for."""

    def matter(self, frame: Frame, held: Ints, slots: int) -> tuple[Ints, Pairs]:
        """Return the pairs that may change or matter now: (m,) codes, sorted, each once, and what is known of them.

        Args:
            frame: the tracks.
            held: codes of the pairs that mattered before.
            slots: how many there are.
        """
        index, count = self.index, len(self.index)
        step = np.where(frame.known, np.hypot(frame.x - frame.before_x, frame.y - frame.before_y), 0.0)
        row, border, depth, edge = index.nearby(frame.x, frame.y, frame.floor)
        nx, ny = index.normals(edge)
        xx, xy, yy = frame.covariance[row].T
        sigma = np.sqrt(np.maximum(nx * nx * xx + 2.0 * nx * ny * xy + ny * ny * yy, 0.0))
        sure = self.margins[border] + SURE * sigma
        away = np.where(index.is_line[border], np.abs(depth), -depth)
        near = np.flatnonzero((away < np.maximum(sure, step[row])) | (away == 0.0))
        row, border, depth, sigma = row[near], border[near], depth[near], sigma[near]
        code = frame.slot[row] * count + border
        # What mattered before matters still; what a long step cut does too.
        row_of = np.full(slots, -1)
        row_of[frame.slot] = np.arange(len(frame.slot))
        held = held[row_of[held // max(count, 1)] >= 0] if len(held) else held
        long = np.flatnonzero(step > index.reach)
        if len(long):
            which, cut = index.cut(frame.segments[long], frame.floor[long])
            held = np.concatenate([held, frame.slot[long[which]] * count + cut])
        codes = np.sort(np.concatenate([code, held]), kind="stable")  # both come nearly sorted
        codes = codes[np.append(True, codes[1:] != codes[:-1])[: len(codes)]]
        place = np.searchsorted(codes, code)
        rows, borders_of = row_of[codes // max(count, 1)], codes % max(count, 1)
        depths, sigmas = np.full(len(codes), np.nan), frame.spread[rows]
        depths[place], sigmas[place] = depth, sigma
        # Beyond reach, and on another floor no less: there nothing of an area is near.
        far = np.flatnonzero(np.isnan(depths))
        same = index.floor[borders_of[far]] == frame.floor[rows[far]]
        depths[far] = np.where(same, index.depth(borders_of[far], frame.x[rows[far]], frame.y[rows[far]]), -np.inf)
        # Whoever lies inside of an area has touched it, whether a step led there or not.
        open_question = index.is_line[borders_of] | (depths < 0.0)
        cutting = np.flatnonzero(frame.known[rows] & (np.abs(depths) <= step[rows]) & open_question)
        net, crossed, share = np.zeros(len(codes), np.int64), np.zeros(len(codes), np.bool_), np.ones(len(codes))
        if len(cutting):
            segments = frame.segments[rows[cutting]]
            net[cutting], crossed[cutting], share[cutting] = index.crossed(borders_of[cutting], segments)
        margin = self.margins[borders_of]
        pairs = Pairs(
            rows, borders_of, depths, sigmas, margin, margin + SURE * sigmas, self.demands[borders_of],
            index.half_width[borders_of] <= frame.spread[rows], net, crossed, share,
        )  # fmt: skip
        return codes, pairs
