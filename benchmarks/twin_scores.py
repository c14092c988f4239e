"""How well do plain methods and trackers do in one scenario of the twin? The errors of all its areas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines.figures import baseline_window_errors
from benchmarks.fusion_run import run_fusion
from benchmarks.identity_metrics import IdentityScore, score_identity
from benchmarks.position_error import centre_of, error_cdf, percentiles, window_rmse
from benchmarks.radio_training import train_radio, warmed_up
from benchmarks.track_reading import named_positions, windows_of
from benchmarks.world_record import Truth, WorldRecord
from benchmarks.world_run import load, record_world, with_access_points
from benchmarks.world_survey import survey_world
from services.fusion.area_view import AreaView

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["TwinScores", "draw_cdfs", "figures_of", "score_twin", "used_access_points"]

Array = NDArray[np.float64]

FUSION = "evidence"
"""The shipped tracker, by its name among the methods …"""
METHODS = {FUSION: FUSION, "rbmcda": "rbmcda", "forces": "rbmcda-forces"}
"""… and all that name phones: tracker by method."""
WARM = f"{FUSION}_warm"
"""The shipped one where other people taught it the site's radio on another day."""
OTHERS = 1000
"""Added to the seed of a world: that of the people who teach."""
ROUNDS = 1
"""Of teaching: for twenty minutes of an area one takes about half a minute."""
NAMES = {
    "radio": "radio only (Horus)",
    "vision": "vision only, 1 Hz (RBMCDA)",
    "cv": "vision only, every frame",
    "evloc": "EV-Loc",
    "rbmcda": "particle filter (RBMCDA)",
    "forces": "particle filter, social forces",
    FUSION: "shipped fusion",
    WARM: "shipped fusion, radio learned",
}


@dataclass
class TwinScores:
    """Errors in one scenario, all areas together.

    Attributes:
        errors: (w,) metres per method, one per person and one-minute window.
        half: the same, of minutes at least half of which the person was in view.
        identity: of the names on the shipped tracker's tracks; None where nobody named any.
    """

    errors: dict[str, Array] = field(default_factory=dict)
    half: dict[str, Array] = field(default_factory=dict)
    identity: IdentityScore | None = None


def score_twin(
    scenario: str,
    seed: int,
    seconds: float | None = None,
    *,
    fusion: bool = True,
    access_points: int | None = None,
    taught: float | None = None,
) -> TwinScores:
    """Make a world and return how far off every method is.

    Args:
        scenario: a shipped one's name.
        seed: of the world.
        seconds: how much of it; None: all.
        fusion: run the trackers that name phones too.
        access_points: how many of the site's the tracker is given; None: all. Horus always has all of them.
        taught: for how many seconds of another day other people teach the site's radio, through the tracker's own
            tracks; None: the shipped tracker is scored on the site as found only.
    """
    described, site = load(scenario)
    records = record_world(described, site, seed, seconds=seconds, motion=fusion)
    teachers = record_world(described, site, seed, seconds=taught, people=seed + OTHERS) if taught else {}
    scores = TwinScores()
    identities = []
    for area, record in records.items():
        survey = survey_world(described, site, area, seed, within=record.view)
        errors = dict(baseline_window_errors(record, survey))
        if fusion:
            used = used_access_points(record, access_points)
            chosen = with_access_points(record, used)
            view = AreaView.of(chosen.site, area)
            runs = [(method, tracker, view) for method, tracker in METHODS.items()]
            if area in teachers:
                model = train_radio(with_access_points(teachers[area], used), FUSION, ROUNDS)
                runs.append((WARM, FUSION, warmed_up(view, model)))
            for method, tracker, known in runs:
                tracks = run_fusion(chosen, tracker, view=known).frames
                estimate = named_positions(record.truth, tracks)
                errors[method] = window_rmse(record.truth, estimate, centre_of(record.view)).rmse
                if method == FUSION:
                    identities.append(score_identity(_each_second(record.truth), tracks))
        half = _half_in_view(record.truth)
        for method, values in errors.items():
            there = np.isfinite(values)
            scores.errors[method] = np.append(scores.errors.get(method, np.empty(0)), values[there])
            scores.half[method] = np.append(scores.half.get(method, np.empty(0)), values[there & half])
    scores.identity = IdentityScore.together(identities) if identities else None
    return scores


def used_access_points(record: WorldRecord, count: int | None) -> list[str]:
    """Return the access points a tracker is given: all, or so many evenly taken from the site file's list."""
    names = [point.id for point in record.site.access_points]
    return names if count is None else [names[round(k * len(names) / count)] for k in range(count)]


def figures_of(scores: TwinScores, prefix: str) -> dict[str, float | None]:
    """Return ``PREFIX_p50_METHOD`` …, ``PREFIX_p90_METHOD_halfview`` and the identity figures of all areas together."""
    figures: dict[str, float | None] = {}
    for method, errors in scores.errors.items():
        for share, value in zip(("p50", "p70", "p90"), percentiles(errors), strict=True):
            figures[f"{prefix}_{share}_{method}"] = value
        figures[f"{prefix}_p90_{method}_halfview"] = percentiles(scores.half[method])[2]
    if scores.identity is not None:
        figures.update(scores.identity.figures(f"{prefix}_"))
    return figures


def draw_cdfs(
    worlds: Mapping[str, TwinScores], picture: Path, studies: Mapping[str, Mapping[str, float]] | None = None
) -> None:
    """Draw the distributions of window errors, a panel for each world and a line for each method.

    Args:
        worlds: by title.
        picture: where to.
        studies: the 90 % errors of the original study by world and method, drawn as dots of the line's colour.
    """
    figure, axes = plt.subplots(1, len(worlds), figsize=(5.2 * len(worlds), 4.0), sharey=True, squeeze=False)
    for axis, (title, scores) in zip(axes[0], worlds.items(), strict=True):
        for method, errors in scores.errors.items():
            [line] = axis.plot(
                *error_cdf(errors), label=NAMES.get(method, method), linewidth=2.2 if method == FUSION else 1.2
            )
            found = (studies or {}).get(title, {}).get(method)
            if found is not None:
                axis.plot(found, 0.9, "o", color=line.get_color(), markeredgecolor="black", zorder=3)
        axis.set(title=title, xlabel="RMSE in a minute, m", xlim=(0.0, 6.0), ylim=(0.0, 1.0))
        axis.axhline(0.9, color="0.8", linewidth=0.8)
        axis.grid(visible=True, alpha=0.25)
    axes[0][0].set_ylabel("share of people's minutes")
    axes[0][-1].legend(loc="lower right")
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


def _half_in_view(truth: Truth, window: float = 60.0) -> NDArray[np.bool_]:
    """Whether each carrier was in view for half of each window, (w, k)."""
    number = windows_of(truth.t, window)
    seen = np.stack([truth.in_view[number == this][:, truth.carriers()].mean(axis=0) for this in np.unique(number)])
    half: NDArray[np.bool_] = seen >= 0.5
    return half


def _each_second(truth: Truth) -> Truth:
    every: Sequence[int] = np.flatnonzero(np.diff(np.floor(truth.t + 1e-6), prepend=-1.0) > 0).tolist()
    return Truth(truth.t[every], truth.person, truth.device, truth.position[every], truth.in_view[every])
