"""From climbs to figures: errors by stage, what each stage gains, where the best learning rate lies, how right lessons
are."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

from benchmarks.learning_ladder import RATES, STAGES, TRACKERS, Climb
from benchmarks.position_error import percentiles
from services.fusion.registry import DEFAULT_TRACKER

__all__ = ["ladder_figures", "lesson_figures", "quality_minutes", "rate_figures", "stage_errors"]

Array = NDArray[np.float64]


def stage_errors(areas: Sequence[Climb], tracker: str, stage: str) -> Array:
    """Return (w,) metres: all errors of one tracker at one stage, all areas and splits together."""
    return np.concatenate([rung.errors[stage] for area in areas for rung in area.rungs[tracker]])


def ladder_figures(areas: Sequence[Climb], prefix: str) -> dict[str, float | None]:
    """Return ``PREFIX_p70_STAGE``, ``PREFIX_mean_STAGE`` and, from the second stage on, ``PREFIX_p70_gain_STAGE`` …."""
    figures: dict[str, float | None] = {}
    for tracker, suffix in TRACKERS.items():
        before: dict[str, float | None] = {}
        for stage in STAGES:
            errors = stage_errors(areas, tracker, stage)
            p50, p70, p90 = percentiles(errors)
            now = {"p50": p50, "p70": p70, "p90": p90, "mean": float(errors.mean()) if len(errors) else None}
            figures |= {f"{prefix}_{name}_{stage}{suffix}": value for name, value in now.items()}
            for name in ("p70", "p90"):
                old, new = before.get(name), now[name]
                if old and new is not None:
                    figures[f"{prefix}_{name}_gain_{stage}{suffix}"] = 1.0 - new / old
            before = now
    return figures


def rate_figures(areas: Sequence[Climb], prefix: str) -> dict[str, float | None]:
    """Return the chosen learning rate, the best in truth, and how much worse than that the chosen one is in truth."""
    curves = [curve for area in areas for curve in area.curves]
    rmse = np.array([curve.rmse for curve in curves])
    chosen = np.array([curve.chosen for curve in curves])
    loss = rmse[np.arange(len(curves)), chosen] / rmse.min(axis=1) - 1.0
    return {
        f"{prefix}_rate_chosen": float(np.exp(np.log(np.array(RATES)[chosen]).mean())),
        f"{prefix}_rate_best": RATES[int(np.argmin(rmse.mean(axis=0)))],
        f"{prefix}_rate_loss": float(loss.mean()),
    }


def lesson_figures(areas: Sequence[Climb]) -> dict[str, float | None]:
    """Return how right the learned radio and strides are, beside what the truth itself would have taught."""
    figures: dict[str, float | None] = {}
    for tracker, suffix in TRACKERS.items():
        rungs = [rung for area in areas for rung in area.rungs[tracker]]
        learned, fitted = (
            float(np.sqrt(np.mean(np.concatenate([getattr(rung, name) for rung in rungs]) ** 2)))
            for name in ("learned", "fitted")
        )
        strides = np.concatenate([rung.strides for rung in rungs])
        figures |= {
            f"radio_rmse_db{suffix}": learned,
            f"radio_rmse_excess_db{suffix}": learned - fitted,
            f"stride_error{suffix}": float(strides[:, 0].mean()) if len(strides) else None,
            f"stride_way_error{suffix}": float(strides[:, 1].mean()) if len(strides) else None,
            f"strides_learned{suffix}": float(len(strides)),
        }
        minutes = quality_minutes(areas, tracker)
        if len(minutes) > 2:
            quality, seconds, rmse, _ = minutes.T
            figures[f"quality_spearman{suffix}"] = float(spearmanr(quality, rmse).statistic)
            figures[f"quality_spearman_per_s{suffix}"] = float(spearmanr(quality / seconds, rmse).statistic)
    stretches = np.concatenate([rung.stretches for area in areas for rung in area.rungs[DEFAULT_TRACKER]])
    rmse, good = stretches[np.isfinite(stretches).all(axis=1)].T
    figures["good_tracks"] = float((good > 0.0).mean()) if len(good) else None
    for name, which in (("good", good > 0.0), ("refused", good == 0.0)):
        figures[f"{name}_tracks_p90"] = percentiles(rmse[which])[2]
    return figures


def quality_minutes(areas: Sequence[Climb], tracker: str) -> Array:
    """Return (k, 4) of one tracker's phones, a minute at a time, as ``Rung.minutes`` has them."""
    minutes = np.concatenate([rung.minutes for area in areas for rung in area.rungs[tracker]])
    known: Array = minutes[np.isfinite(minutes).all(axis=1)]
    return known
