"""The truth of PETS 2009 S2.L1, view 1: who stands where in metres in each frame, and who is wholly in the picture."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from shared.settings import data_folder

__all__ = ["FRAMES", "FRAMES_PER_S", "PetsTruth"]

FRAMES = 795
FRAMES_PER_S = 7.0
WIDTH, HEIGHT = 768, 576


@dataclass(frozen=True)
class PetsTruth:
    """Rows sorted by frame; frames count from 0 here, so that time since the clip's start is ``frame / 7``.

    Attributes:
        frame, person: (n,) integers.
        position: (n, 2) metres.
        in_view: (n,) whether the feet are inside the picture.
    """

    frame: NDArray[np.int64]
    person: NDArray[np.int64]
    position: NDArray[np.float64]
    in_view: NDArray[np.bool_]

    @classmethod
    def load(cls, folder: Path | None = None) -> PetsTruth:
        """Read ``pets09-s2l1/gt/gt.txt`` of the data folder."""
        rows = np.loadtxt((folder or data_folder()) / "pets09-s2l1" / "gt" / "gt.txt", delimiter=",")
        rows = rows[np.lexsort((rows[:, 1], rows[:, 0]))]
        # MOT boxes count pixels from 1.
        foot_x, foot_y = rows[:, 2] + rows[:, 4] / 2 - 1, rows[:, 3] + rows[:, 5] - 1
        return cls(
            frame=rows[:, 0].astype(np.int64) - 1,
            person=rows[:, 1].astype(np.int64),
            position=rows[:, 7:9],
            in_view=(foot_x >= 0) & (foot_x <= WIDTH - 1) & (foot_y >= 0) & (foot_y <= HEIGHT - 1),
        )

    def at(self, person: int, elapsed: float) -> tuple[float, float] | None:
        """Return where ``person`` is ``elapsed`` seconds into the clip; None while not in view."""
        mine = np.flatnonzero((self.person == person) & self.in_view)
        frame = elapsed * FRAMES_PER_S
        after = int(np.searchsorted(self.frame[mine], frame))
        if after == len(mine) or (after == 0 and self.frame[mine[0]] != frame):
            return None
        if self.frame[mine[after]] == frame:
            x, y = self.position[mine[after]]
            return float(x), float(y)
        before, following = mine[after - 1], mine[after]
        if self.frame[following] - self.frame[before] > 1:
            return None
        share = frame - self.frame[before]
        x, y = (1 - share) * self.position[before] + share * self.position[following]
        return float(x), float(y)
