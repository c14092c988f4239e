"""Where is each device: on one of the tracks, somewhere on the floor unseen, or far away? One Bayes filter per device.

A device's probability is spread over the columns (camera tracks), the cells of the floor (nobody sees it there) and
"far". Evidence multiplies; what happens to tracks lets probability flow: the end of a track leaves it at the place
where the track was lost, to be carried on by the phone's own steps (dead reckoning); a track born where an unseen
device may be takes it up, against the chance that a stranger was born there; tracks that meet may exchange persons.
Every hypothesis remembers which track it was on in the last seconds, so that the past can be revised.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from services.fusion.evidence.floor_grid import FloorGrid
from services.fusion.snapshot import of_shape, unpack

__all__ = ["UNSEEN", "Beliefs", "Flow"]

Array = NDArray[np.float64]
Integers = NDArray[np.int64]

SLOTS = 26
"""Slots of 0.2 s of which a hypothesis knows its past: what a revision may reach back."""
UNSEEN = 0
"""In a lineage, in place of a track's id."""
LEAST = 1e-12
WORTH = 1e-4
"""Probability from which it is worth noting where it came from."""


@dataclass(frozen=True)
class Flow:
    """How probability flows between tracks and floor; rates are per second."""

    stranger_density: float = 0.01
    """People per m² without any of the known phones who are unseen and may be born as a track; on a wide floor not
    more in all than there are tracks."""
    far: float = 0.05
    """Probability that a new device is far away, and rates of going and coming."""
    far_rate: float = 0.002
    near_rate: float = 0.01
    swap_rate: float = 0.2
    """Rate at which two tracks at the same place exchange persons, and its range in metres."""
    swap_range: float = 0.6
    leak: float = 0.002
    """Rate at which a track is not its person's any more, and what a track adds that no camera sees while its person
    walks."""
    leak_coasting: float = 0.1
    pickup: float = 1.0
    """Rate at which an unseen person is taken for the track that stands there."""
    seen_walking: float = 1.0
    """Rate at which a person who walks in view gets a track; one who stands there may have faded."""
    seen_still: float = 0.3
    seen_untold: float = 0.03
    """The same of a device that tells nothing of its walk: it may lie anywhere, with nobody to be seen."""
    outside_rate: float = 0.5
    """Rate at which who is ``outside`` the floor goes on to be far."""
    lost_sigma: float = 0.5
    """Metres by which the end of a track may be off its person, and the beginning of one."""
    born_sigma: float = 0.7


class Beliefs:
    """The filters of d devices over k columns and n cells.

    Attributes:
        share: (d, k), probability of each column.
        floor: (d, rows, columns), of each cell.
        far: (d,).
        rest: (d, 2), metres by which the floor's density is off its cells' centres.
        spread: (d,), variance in m² by which the floor's density is yet to be blurred.
        lineage: (d, k + 1, SLOTS), ids of the tracks each hypothesis was on; the last one is "unseen".
    """

    def __init__(self, grid: FloorGrid, flow: Flow) -> None:
        self.grid, self.flow = grid, flow
        self.share = np.zeros((0, 0))
        self.floor = np.zeros((0, *grid.shape))
        self.far = np.zeros(0)
        self.rest = np.zeros((0, 2))
        self.spread = np.zeros(0)
        self.lineage = np.zeros((0, 1, SLOTS), np.int64)
        self.slot = -1

    def resize(self, devices: int, tracks: int) -> None:
        """Make room for more."""
        d, k = self.share.shape
        for name, shape in (
            ("share", (devices, tracks)),
            ("floor", (devices, *self.grid.shape)),
            ("far", (devices,)),
            ("rest", (devices, 2)),
            ("spread", (devices,)),
        ):
            old = getattr(self, name)
            new = np.zeros(shape)
            new[tuple(slice(0, size) for size in old.shape)] = old
            setattr(self, name, new)
        lineage = np.zeros((devices, tracks + 1, SLOTS), np.int64)
        lineage[:d, :k], lineage[:d, tracks] = self.lineage[:, :k], self.lineage[:, k]
        self.lineage = lineage

    def open(self, row: int, alive: Integers) -> None:
        """Know nothing of a device."""
        open_cells = self.grid.open
        unseen = np.where(self.grid.viewed, 0.3, np.where(self.grid.outside, 0.3, 1.0)) * open_cells
        people = self.strangers(len(alive)) * self.grid.cell**2 * unseen.sum() + len(alive)
        self.share[row] = 0.0
        self.share[row, alive] = (1.0 - self.flow.far) / max(people, 1.0)
        self.far[row] = self.flow.far
        rest = 1.0 - self.flow.far - float(self.share[row].sum())
        self.floor[row] = unseen * (max(rest, 0.05) / max(float(unseen.sum()), 1.0))
        self.rest[row], self.spread[row] = 0.0, 0.0
        self.lineage[row] = UNSEEN
        self.normalise(row)

    def forget(self, row: int) -> None:
        """Believe nothing of a device."""
        for name in _BY_DEVICE:
            getattr(self, name)[row] = 0.0
        self.share[row], self.lineage[row] = 0.0, UNSEEN

    def strangers(self, tracks: int) -> float:
        """Return how many unseen people without a known phone there are per m² while cameras follow ``tracks``."""
        return min(self.flow.stranger_density, (tracks + 1.0) / max(self.grid.area, 1.0))

    def normalise(self, row: int) -> None:
        """Let a device's probabilities sum to one."""
        total = float(self.share[row].sum() + self.floor[row].sum() + self.far[row])
        self.share[row] /= total
        self.floor[row] /= total
        self.far[row] /= total

    def weigh(self, row: int, columns: Integers, tracks: Array, cells: Array, far: float) -> None:
        """Multiply by likelihoods given as logarithms: of (n,) columns, of all cells (flat) and of "far"."""
        best = max(float(tracks.max(initial=-math.inf)), float(cells.max()), far)
        self.share[row, columns] *= np.exp(np.maximum(tracks - best, -30.0))
        self.floor[row] *= np.exp(np.maximum(cells - best, -30.0)).reshape(self.grid.shape)
        self.far[row] = max(float(self.far[row]) * math.exp(max(far - best, -30.0)), LEAST)
        self.normalise(row)

    def favour(self, row: int, columns: Integers, evidence: Array) -> None:
        """Multiply columns by what speaks for them, in nats, against being on no track.

        A track whose path meanwhile is not known was born since: the better another suits, the less it is the
        device's.
        """
        best = max(float(evidence.max(initial=0.0)), 0.0)
        self.share[row] *= math.exp(-best)
        self.share[row, columns] *= np.exp(evidence)
        self.share[row, columns] *= math.exp(best)
        self.normalise(row)

    def walk(self, row: int, displacement: Array, variance: float) -> None:
        """Carry the unseen device on by what its steps say: (2,) metres, off by ``variance`` m² along each axis."""
        grid = self.grid
        self.rest[row] += displacement
        self.spread[row] += variance
        cells = np.round(self.rest[row] / grid.cell).astype(int).tolist()
        before = float(self.floor[row].sum())
        if cells[0] or cells[1]:
            self.floor[row] = grid.shift(self.floor[row], *cells)
            self.rest[row] -= np.array(cells) * grid.cell
        if self.spread[row] > (0.5 * grid.cell) ** 2:
            self.floor[row] = grid.blur(self.floor[row], math.sqrt(float(self.spread[row])))
            self.spread[row] = 0.0
        # What walked off the floor is far; what walked into an obstacle is wrong and dies with it.
        self.far[row] += 0.2 * max(before - float(self.floor[row].sum()), 0.0)
        self.normalise(row)

    def begin(self, column: int, place: Array, rows: Integers, tracks: int) -> None:
        """A track was born beside ``tracks`` others: it may be any unseen device that can be there."""
        kernel = self.grid.kernel(place, self.flow.born_sigma)
        self.share[:, column] = 0.0
        if not len(rows):
            return
        density = self.floor[rows].reshape(len(rows), -1) @ kernel
        chance = density / (density + self.strangers(tracks))
        self.share[rows] *= (1.0 - chance)[:, None]
        self.floor[rows] *= (1.0 - chance)[:, None, None]
        self.far[rows] *= 1.0 - chance
        self.share[rows, column] = chance
        self.lineage[rows, column] = self.lineage[rows, -1]

    def end(self, column: int, place: Array, rows: Integers) -> None:
        """A track was lost: its person is where it was last."""
        if not len(rows):
            return
        mass = self.share[rows, column]
        self.share[:, column] = 0.0
        kernel = self.grid.kernel(place, self.flow.lost_sigma) * self.grid.open.ravel()
        kernel /= max(float(kernel.sum()), 1e-300)
        heavier = mass > self.floor[rows].sum(axis=(1, 2))
        self.floor[rows] += (mass[:, None] * kernel).reshape(len(rows), *self.grid.shape)
        self.lineage[rows[heavier], -1] = self.lineage[rows[heavier], column]

    def pass_time(
        self,
        rows: Integers,
        alive: Integers,
        places: Array,
        coasting: NDArray[np.bool_],
        walking: Array,
        told: NDArray[np.bool_],
        elapsed: float,
    ) -> None:
        """Let probability flow for ``elapsed`` seconds.

        Args:
            rows: (d,), the devices.
            alive: (k,), columns of living tracks, (k, 2) ``places``, ``coasting``: whether no camera sees it now.
            walking: (d,), whether the device walked of late: 0 to 1; (d,) whether it ``told`` of its walk at all.
            told: see there.
            elapsed: seconds.
        """
        f = self.flow
        cells = self.grid.cells_at(places)
        size = self.grid.shape[1]
        around = np.array([-size - 1, -size, -size + 1, -1, 0, 1, size - 1, size, size + 1])
        near = np.minimum(np.maximum(cells[:, None] + around, 0), self.grid.shape[0] * size - 1)
        floor = self.floor[rows].reshape(len(rows), -1)
        share = self.share[np.ix_(rows, alive)]
        picked = floor[:, near].sum(axis=2) * min(f.pickup * elapsed, 0.5)
        # A still person's track may rest unseen for long; one who walks has left it.
        leak = f.leak + f.leak_coasting * walking[:, None] * coasting
        leaked = share * np.minimum(leak * elapsed, 0.5)
        keep = np.ones_like(floor)
        hazard = np.where(told, f.seen_still + (f.seen_walking - f.seen_still) * walking, f.seen_untold)
        keep[:, self.grid.viewed.ravel()] = np.exp(-hazard * elapsed)[:, None]
        floor *= keep
        outside = floor[:, self.grid.outside.ravel()]
        floor[:, self.grid.outside.ravel()] = outside * math.exp(-f.outside_rate * elapsed)
        gone = outside.sum(axis=1) * -math.expm1(-f.outside_rate * elapsed)
        device, index = np.nonzero(picked > np.maximum(share, WORTH))
        self.lineage[rows[device], alive[index]] = self.lineage[rows[device], -1]
        best = leaked.argmax(axis=1) if len(alive) else np.zeros(len(rows), np.int64)
        if len(alive):
            strongest = leaked[np.arange(len(rows)), best]
            taken = np.flatnonzero(strongest > floor.sum(axis=1))
            self.lineage[rows[taken], -1] = self.lineage[rows[taken], alive[best[taken]]]
        np.add.at(floor.T, cells, leaked.T)
        away = f.far_rate * elapsed * floor.sum(axis=1)
        back = f.near_rate * elapsed * self.far[rows]
        floor += back[:, None] * self.grid.indoors
        self.far[rows] += away - back + gone
        self.floor[rows] = floor.reshape(len(rows), *self.grid.shape)
        self.share[np.ix_(rows, alive)] = share + picked - leaked
        self._exchange(rows, alive, places, elapsed)
        total = self.share[rows].sum(axis=1) + floor.sum(axis=1) + self.far[rows]
        self.share[rows] /= total[:, None]
        self.floor[rows] /= total[:, None, None]
        self.far[rows] /= total

    def _exchange(self, rows: Integers, alive: Integers, places: Array, elapsed: float) -> None:
        """Tracks that meet may have exchanged persons: let each flow into the other."""
        f = self.flow
        if len(alive) < 2:
            return
        dx = places[:, 0, None] - places[None, :, 0]
        dy = places[:, 1, None] - places[None, :, 1]
        flow = min(elapsed, 1.0) * f.swap_rate * np.exp(-(dx * dx + dy * dy) / f.swap_range**2)
        np.fill_diagonal(flow, 0.0)
        source, target = np.nonzero(flow > 1e-3)
        if not len(source):
            return
        share = self.share[np.ix_(rows, alive)]
        flowing = share[:, source] * flow[source, target]
        leaving = np.zeros(len(alive))
        np.add.at(leaving, source, flow[source, target])
        mixed = share * (1.0 - np.minimum(leaving, 0.5))
        np.add.at(mixed.T, target, flowing.T)
        stays = share[:, target] * (1.0 - np.minimum(leaving[target], 0.5))
        device, pair = np.nonzero(flowing > np.maximum(stays, WORTH))
        past = self.lineage[rows[device], alive[source[pair]]]
        self.lineage[rows[device], alive[target[pair]]] = past
        self.share[np.ix_(rows, alive)] = mixed

    def remember(self, slot: int, tracks: Integers) -> None:
        """Note of a new slot which track each hypothesis is on; ``tracks`` (k,) are the columns' ids."""
        for number in range(max(self.slot + 1, slot - SLOTS + 1), slot + 1):
            self.lineage[:, :-1, number % SLOTS] = tracks
            self.lineage[:, -1, number % SLOTS] = UNSEEN
        self.slot = slot

    def state(self, rows: Integers, columns: Integers) -> dict[str, Any]:
        """Return copies of what is kept of these devices and columns."""
        lineage = self.lineage[np.ix_(rows, np.append(columns, self.share.shape[1]))]
        return {
            **{name: getattr(self, name)[rows] for name in _BY_DEVICE},
            "share": self.share[np.ix_(rows, columns)],
            "lineage": lineage,
            "slot": self.slot,
        }

    def restore(self, state: dict[str, Any], rows: Integers, columns: Integers) -> None:
        """Go on from ``state()``, the arrays having room already."""
        for name in _BY_DEVICE:
            array = getattr(self, name)
            array[rows] = of_shape(unpack(state[name]), array[rows].shape)
        self.share[np.ix_(rows, columns)] = of_shape(unpack(state["share"]), (len(rows), len(columns)))
        self.lineage[np.ix_(rows, np.append(columns, self.share.shape[1]))] = unpack(state["lineage"])
        self.slot = int(state["slot"])


_BY_DEVICE = ("floor", "far", "rest", "spread")
