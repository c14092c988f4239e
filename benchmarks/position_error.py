"""How far off is each person, window by window? The errors of the original studies, and their distribution.

Estimates are (n, k, 2), metres, at the n times of a truth, for its k carriers in the order of ``Truth.carriers()``; NaN
where there is none (``benchmarks.track_reading`` makes them from published tracks).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from benchmarks.track_reading import windows_of
from benchmarks.world_record import Truth

__all__ = [
    "FieldOfViewErrors",
    "WindowErrors",
    "centre_of",
    "error_cdf",
    "field_of_view_errors",
    "hold",
    "percentiles",
    "window_rmse",
]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WindowErrors:
    """Errors of k devices in w windows.

    Attributes:
        rmse: (w, k) metres; NaN where the person was never to be scored.
        located: (w, k) share of the scored times at which there was an estimate, not one held; NaN likewise.
        scored: (w, k) number of scored times.
    """

    rmse: Array
    located: Array
    scored: NDArray[np.int64]

    def figures(self, prefix: str = "") -> dict[str, float | None]:
        """Return the median, 70 and 90 % of the windows' RMSE, and the share of all scored time located, by name."""
        p50, p70, p90 = percentiles(self.rmse)
        count = int(self.scored.sum())
        share = float(np.nansum(self.located * self.scored)) / count if count else None
        return {f"{prefix}p50": p50, f"{prefix}p70": p70, f"{prefix}p90": p90, f"{prefix}located": share}


def window_rmse(
    truth: Truth, estimate: Array, centre: Array, window: float = 60.0, *, out_of_view: bool = False
) -> WindowErrors:
    """Return the root mean squared error of each device in each window.

    As in [ravel-thesis §11.1]: sqrt(mean ‖estimate − truth‖²) per target and one-minute window; distributions are read
    over all these values. What the studies leave open is decided so: a time without an estimate is not left out, but
    the last estimate is held, and before the first one the centre of the view is assumed. Times at which the person is
    out of view (or not about at all) are left out; a window in which that leaves any time counts like every other.

    Args:
        truth: of n times with k carriers.
        estimate: (n, k, 2).
        centre: (2,) metres, what is assumed before the first estimate; ``centre_of`` the view.
        window: seconds; windows count from the first time of the truth.
        out_of_view: score the times out of view as well, as long as it is known where the person is.

    Raises:
        ValueError: the estimate does not have the truth's times and carriers.
    """
    position, in_view = _carried(truth, estimate)
    scored = np.isfinite(position).all(axis=2) & (in_view | out_of_view)
    own = np.isfinite(estimate).all(axis=2)
    squared = np.where(scored, ((hold(estimate, centre) - position) ** 2).sum(axis=2), 0.0)
    number = windows_of(truth.t, window)
    count = _sums(number, scored.astype(np.float64))
    with np.errstate(invalid="ignore"):  # 0 / 0 is NaN on purpose
        rmse = np.sqrt(_sums(number, squared) / count)
        located = _sums(number, (scored & own).astype(np.float64)) / count
    return WindowErrors(rmse, located, count.astype(np.int64))


@dataclass(frozen=True)
class FieldOfViewErrors:
    """The errors of [ravel-thesis §11.1] for estimates that may also say "out of view" (NaN); each (w, k).

    Attributes:
        offline: metres, mean over the times at which truth and estimate are both in view; NaN where they never are.
        false_in: share of the window's times estimated in view while the person is not.
        false_out: share estimated out of view while the person is in it.
        online: metres at the last time of the window; NaN unless both are in view then.
    """

    offline: Array
    false_in: Array
    false_out: Array
    online: Array

    @property
    def overlap(self) -> Array:
        """The overlap error, false positives + false negatives."""
        return self.false_in + self.false_out

    def figures(self, prefix: str = "") -> dict[str, float | None]:
        """Return the figures the study reports, by name."""
        offline_median, _, offline_p90 = percentiles(self.offline)
        return {
            f"{prefix}offline_median": offline_median,
            f"{prefix}offline_p90": offline_p90,
            f"{prefix}overlap_zero_share": float((self.overlap == 0.0).mean()) if self.overlap.size else None,
            f"{prefix}overlap_max": float(self.overlap.max()) if self.overlap.size else None,
            f"{prefix}online_median": percentiles(self.online)[0],
        }


def field_of_view_errors(truth: Truth, estimate: Array, window: float = 60.0) -> FieldOfViewErrors:
    """Return offline, overlap and online error per window and device [ravel-thesis §11.1].

    For the online error to be what its name says, the estimate at the last time of a window must come from that window
    and what lies before it; the offline error is meant for an estimate that used the whole window.

    Raises:
        ValueError: the estimate does not have the truth's times and carriers.
    """
    position, in_view = _carried(truth, estimate)
    really, said = in_view & np.isfinite(position).all(axis=2), np.isfinite(estimate).all(axis=2)
    both = really & said
    error = np.where(both, np.linalg.norm(estimate - position, axis=2), np.nan)
    number = windows_of(truth.t, window)
    frames = np.bincount(number).astype(np.float64)[:, None]
    last = np.searchsorted(number, np.arange(len(frames)), side="right") - 1
    with np.errstate(invalid="ignore"):
        return FieldOfViewErrors(
            offline=_sums(number, np.where(both, error, 0.0)) / _sums(number, both.astype(np.float64)),
            false_in=_sums(number, (said & ~really).astype(np.float64)) / frames,
            false_out=_sums(number, (really & ~said).astype(np.float64)) / frames,
            online=error[last],
        )


def hold(estimate: Array, start: Array) -> Array:
    """Return (n, k, 2) estimates in which the last one is held through gaps; before the first there is ``start``."""
    known = np.isfinite(estimate).all(axis=2)
    last = np.maximum.accumulate(np.where(known, np.arange(1, len(estimate) + 1)[:, None], 0), axis=0)
    padded = np.concatenate([np.broadcast_to(start, (1, *estimate.shape[1:])), estimate])
    return np.take_along_axis(padded, last[:, :, None], axis=0)


def centre_of(view: Array) -> Array:
    """Return the (2,) centroid of the convex hull of (c, 2) corners."""
    centre = shapely.MultiPoint(view).convex_hull.centroid
    return np.array([centre.x, centre.y])


def percentiles(errors: Array) -> tuple[float | None, float | None, float | None]:
    """Return the median, the 70 and the 90 % percentile of what is not NaN (linear between values); None of nothing."""
    values = errors[~np.isnan(errors)]
    if not len(values):
        return None, None, None
    p50, p70, p90 = np.percentile(values, [50.0, 70.0, 90.0])
    return float(p50), float(p70), float(p90)


def error_cdf(errors: Array) -> tuple[Array, Array]:
    """Return the sorted errors (NaN left out) and the share of errors not larger than each, both (m,)."""
    values = np.sort(errors[~np.isnan(errors)])
    return values, np.arange(1, len(values) + 1) / max(len(values), 1)


def _carried(truth: Truth, estimate: Array) -> tuple[Array, NDArray[np.bool_]]:
    carriers = truth.carriers()
    expected = len(truth.t), len(carriers), 2
    if estimate.shape != expected:
        raise ValueError(f"estimate has the shape {estimate.shape}; the truth's times and carriers make {expected}")
    return truth.position[:, carriers], truth.in_view[:, carriers]


def _sums(number: NDArray[np.int64], values: Array) -> Array:
    """Return (w, k) sums of (n, k) values by number of window."""
    sums = np.zeros((int(number[-1]) + 1 if len(number) else 0, values.shape[1]))
    np.add.at(sums, number, values)
    return sums
