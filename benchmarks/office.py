"""How far off is Wi-Fi alone in the office? The world of the self-calibration study, without cameras and steps."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import matplotlib as mpl
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.baselines.naive_bayes import NaiveBayes, NaiveBayesParameters, bin_width_for
from benchmarks.baselines.survey import Survey, readings_of
from benchmarks.experiment import Experiment, Figures, Options, Study
from benchmarks.office_survey import Surveyor, reference_points
from benchmarks.position_error import error_cdf
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import load, record_world
from services.simulator.radio.radio_world import RadioWorld

mpl.use("Agg")
import matplotlib.pyplot as plt

__all__ = ["EXPERIMENT", "main", "static_rmse", "walking_errors"]

Array = NDArray[np.float64]

SAMPLES = (10, 20, 30, 40, 50)
"""Scans at each reference point."""
POOL = 70
"""Scans at each point of which so many are drawn, as in the study …"""
TESTED = 50
"""… and scans at each point of another visit that are located."""
DRAWS = 10
WALKING = 0.3
"""m/s; who is slower stands, and the study's testers did not."""


def walking_errors(record: WorldRecord, survey: Survey, bin_width: int) -> Array:
    """Return how far off each scan of the walking testers is, (n,) metres.

    Args:
        record: of the office.
        survey: the radio map.
        bin_width: dB.
    """
    localiser = NaiveBayes(survey, NaiveBayesParameters(bin_width=bin_width))
    truth = record.truth
    errors = []
    for place in truth.carriers():
        t, readings = readings_of(record.scans[truth.device[place] or ""], survey.access_points)
        position = truth.position[:, place]
        speed = np.hypot(*np.gradient(position, truth.t, axis=0).T)
        there = np.column_stack([np.interp(t, truth.t, position[:, axis]) for axis in (0, 1)])
        walks = np.isfinite(there).all(axis=1) & (np.interp(t, truth.t, speed) > WALKING)
        errors.append(np.hypot(*(localiser.locate(readings[walks]) - there[walks]).T))
    return np.concatenate(errors)


def static_rmse(pool: Survey, tested: Survey, samples: int, rng: np.random.Generator, draws: int = DRAWS) -> float:
    """Return the RMSE in metres at the reference points of a map of ``samples`` scans each, mean over random draws.

    [self-calibrating-rss-thesis §8.1 (4.2), §8.3 E4.5]

    Args:
        pool: scans to draw from.
        tested: scans of another visit.
        samples: scans drawn at each point, at most as many as the pool holds.
        rng: draws.
        draws: how often.
    """
    scans = tested.readings.reshape(-1, len(tested.access_points))
    truth = np.repeat(tested.position, tested.readings.shape[1], axis=0)
    parameters = NaiveBayesParameters(bin_width=bin_width_for(samples))
    rmse = []
    for _ in range(draws):
        drawn = rng.permutation(pool.readings.shape[1])[:samples]
        chosen = Survey(pool.access_points, pool.position, pool.readings[:, drawn])
        rmse.append(_rms(np.hypot(*(NaiveBayes(chosen, parameters).locate(scans) - truth).T)))
    return float(np.mean(rmse))


def run(options: Options, progress: Progress) -> Figures:
    """Survey, walk, locate."""
    scenario, site = load(options.scenario)
    task = progress.add_task("making the world", total=scenario.duration)
    record = record_world(
        scenario,
        site,
        options.seed,
        motion=False,
        progress=lambda seconds: progress.update(task, completed=seconds),
    )[site.areas[0].id]
    radio = RadioWorld(site, options.seed, scenario.radio.model_copy(update={"changes": []}))
    surveyor = Surveyor(radio, site, reference_points())
    survey = surveyor.survey(SAMPLES[0])
    errors = walking_errors(record, survey, bin_width_for(SAMPLES[0]))
    pool, tested = surveyor.survey(POOL), surveyor.survey(TESTED)
    task = progress.add_task("drawing surveys", total=len(SAMPLES))
    ladder = {}
    for samples in SAMPLES:
        ladder[samples] = static_rmse(pool, tested, samples, np.random.default_rng(options.seed))
        progress.advance(task)
    _draw(errors, ladder, options.picture)
    heard = np.isfinite(survey.readings)
    return {
        "wifi_rmse": _rms(errors),
        "wifi_p50": float(np.percentile(errors, 50)),
        "wifi_p90": float(np.percentile(errors, 90)),
        "scans": len(errors),
        "reference_points": len(survey.position),
        "heard_per_scan": float(heard.sum(axis=2).mean()),
        **{f"static_rmse_{samples}": value for samples, value in ladder.items()},
    }


def _rms(errors: Array) -> float:
    return float(np.sqrt(np.mean(errors**2)))


def _draw(errors: Array, ladder: Mapping[int, float], picture: Path) -> None:
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.4, 4.0))
    left.plot(*error_cdf(errors))
    left.axvline(_rms(errors), color="tab:blue", linestyle=":", label=f"RMSE {_rms(errors):.2f} m")
    left.axvline(STUDY_WALKING, color="tab:orange", linestyle=":", label=f"RMSE of the study {STUDY_WALKING:.2f} m")
    left.set(title="testers walk, 10 scans at each point", xlabel="error, m", ylabel="share of scans", xlim=(0, 15))
    right.plot(list(ladder), list(ladder.values()), marker="o", label="twin")
    right.plot(SAMPLES, STUDY_STATIC, marker="s", label="study")
    right.set(title="phone at the points", xlabel="scans at each point", ylabel="RMSE, m", ylim=(0, None))
    for axis in (left, right):
        axis.grid(alpha=0.3)
        axis.legend()
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)
    plt.close(figure)


STUDY_WALKING = 4.23
STUDY_STATIC: Sequence[float] = (3.7, 3.1, 2.8, 2.6, 2.4)

EXPERIMENT = Experiment(
    name="office",
    question="How far off is Wi-Fi alone in the office?",
    kind="twin",
    scenario="office",
    seed=62,
    run=run,
    made="""Three testers walk the corridors for half an hour and scan every 1.5 s. A surveyor with a phone of the
same model stood, on another day, at 40 reference points some 1.5 m apart: ten scans at each, half of them facing each
way along the corridor, a quarter each of four ways in the open space. `wifi_*`: discretised naive Bayes (bins of 4
dB, a missed access point counts as -100 dBm) of each single scan of who walks, against the truth at the time of the
scan; no filter, no steps. `static_rmse_N`: the phone stands at the points on a later visit, hours after a survey of N
scans each, drawn from 70 (mean of ten draws; bins as the study found best). The noise of the scenario was chosen so
that `wifi_rmse` lands near the study's on the train seed and two more; this is the test seed.""",
    studies={
        "wifi_rmse": Study(STUDY_WALKING, "[self-calibrating-rss-thesis §8.5 E6.1]"),
        **{
            f"static_rmse_{samples}": Study(value, "[self-calibrating-rss-thesis §8.3 E4.5]")
            for samples, value in zip(SAMPLES, STUDY_STATIC, strict=True)
        },
    },
    difference="""Theirs is one real floor with 37 points, 28 of them in corridors; a classifier first chose one of
seven clusters of points, which is left out here. How they took the truth while walking is not described. Their
training and test scans at the points may be of one visit.""",
    at_least={"wifi_rmse": round(0.8 * STUDY_WALKING, 2)},
    at_most={"wifi_rmse": round(1.2 * STUDY_WALKING, 2)},
    picture="left: distribution of the errors while testers walk; right: error at the points by size of the survey",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
