"""Do learned radio models place a beacon better? Real walks through a hall, by radio alone.

Twelve receivers hear a beacon that somebody carries overhead. What they read at known places of some walks teaches
constants and a shadowing map, with the very code that learning runs on; the other walks are followed by a particle
filter that knows nothing but what the receivers hear.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from rich.progress import Progress

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.radio_filter import RadioFilter
from benchmarks.radio_recordings import Readings, ble_walks
from shared.radio import PathLoss, RadioModel, RadioPrior, fit_radio, gather_visits, novelty
from shared.radio.path_loss import DEVICE_HEIGHT
from shared.settings import data_folder

__all__ = ["HELD_OUT", "TAUGHT_BY", "errors", "learned"]

Array = NDArray[np.float64]

TAUGHT_BY, HELD_OUT = (0, 2, 4), (1, 3)
"""Walks in order of their files' names: every second one is withheld. The split was made before anything was scored."""
ROOM = (np.zeros(2), np.array([20.66, 17.64]))
"""Corners of the hall, metres, as its parameters file says."""
GUESS = (-60.0, 2.0)
"""dBm at one metre and exponent before anything is learned: the beacon's strength is not known."""
PRIOR = RadioPrior(power=10.0, exponent=0.7)
CONSTANTS = replace(PRIOR, shadowing=0.01, white=float(np.hypot(PRIOR.white, PRIOR.shadowing)))
SPREAD = 0.1
"""Metres to which the walks' places are known."""
SPEED = 0.4
"""m/s at which somebody walks who carries a measuring set overhead; chosen on the walks that teach."""
LAG = 3.0
"""Seconds of the fixed-lag smoother that is shown beside."""
RUNS = 5
"""Particle filters over each walk; their errors are pooled."""


def learned(readings: Readings, walks: Sequence[int], prior: RadioPrior = PRIOR) -> RadioModel:
    """Return the model that some walks teach.

    Raises:
        ValueError: it is not known where the receivers are.
    """
    if readings.place is None:
        raise ValueError("a path loss needs the places of the transmitters")
    count = readings.transmitters
    guess = PathLoss(
        names=tuple(str(number) for number in range(count)),
        positions=readings.place + np.array([0.0, 0.0, DEVICE_HEIGHT]),
        power_1m=np.full(count, GUESS[0]),
        exponent=np.full(count, GUESS[1]),
    )
    mine = np.flatnonzero(np.isin(readings.walk, walks))
    share = np.empty(len(readings.rssi))
    for walk in walks:
        for point in range(count):
            rows = np.flatnonzero((readings.walk == walk) & (readings.transmitter == point))
            share[rows] = novelty(readings.position[rows])
    weight = share[mine] / prior.noise(np.full(len(mine), SPREAD))
    visits = gather_visits(
        readings.t[mine], np.zeros(len(mine), np.int64), readings.walk[mine], readings.transmitter[mine],
        readings.position[mine], readings.rssi[mine], weight,
    )  # fmt: skip
    return fit_radio(guess, *ROOM, visits, prior=prior).model


def reading_noise(readings: Readings, walks: Sequence[int], prior: RadioPrior) -> float:
    """Return the standard deviation, dB, of single readings beyond what a model says that it does not know.

    Each walk in turn is foretold from the others: fading of a narrow band shows as what is left.
    """
    rest = []
    for walk in walks:
        model = learned(readings, [other for other in walks if other != walk], prior)
        mine = np.flatnonzero(readings.walk == walk)
        places, rows = readings.position[mine], (np.arange(len(mine)), readings.transmitter[mine])
        mean, variance = model.shadowing.at(places)
        error = readings.rssi[mine] - (model.path_loss.rssi(places) + mean)[rows]
        rest.append(error**2 - variance[rows])
    return float(np.sqrt(max(np.concatenate(rest).mean(), prior.white**2)))


def measured(readings: Readings, taught_by: Sequence[int], walks: Sequence[int], seed: int) -> dict[str, Array]:
    """Return the errors (n,) in metres on ``walks``, by what was learned from others."""
    constants, model = (learned(readings, taught_by, prior) for prior in (CONSTANTS, PRIOR))
    plain = RadioFilter(white=reading_noise(readings, TAUGHT_BY, CONSTANTS), speed=SPEED, mapped=False)
    sure = RadioFilter(white=PRIOR.white, speed=SPEED)
    honest = RadioFilter(white=reading_noise(readings, TAUGHT_BY, PRIOR), speed=SPEED)
    ways = {
        "constants": (constants, plain, 0.0),
        "map": (model, sure, 0.0),
        "": (model, honest, 0.0),
        "smoothed": (model, honest, LAG),
    }
    return {
        name: np.concatenate([errors(readings, known, walk, filter_, seed, lag).ravel() for walk in walks])
        for name, (known, filter_, lag) in ways.items()
    }


def errors(
    readings: Readings, model: RadioModel, walk: int, filter_: RadioFilter, seed: int, lag: float = 0.0
) -> Array:
    """Return how far off the filter is at each advert of a walk, (runs, n) metres."""
    scans = np.flatnonzero(readings.scan_walk == walk)
    level = np.full((len(scans), readings.transmitters), np.nan)
    mine = np.flatnonzero(readings.walk == walk)
    level[readings.scan[mine] - scans[0], readings.transmitter[mine]] = readings.rssi[mine]
    off = []
    for run in range(RUNS):
        rng = np.random.default_rng([seed, walk, run])
        told = filter_.follow(model, readings.scan_t[scans], level, *ROOM, rng, lag)
        off.append(np.hypot(*(told - readings.scan_position[scans]).T))
    return np.array(off)


def run(options: Options, progress: Progress) -> Figures:
    """Measure and draw."""
    folder = data_folder()
    if not (folder / "ble-positions").is_dir():
        raise ExperimentError(f"{folder}: no ble-positions there; set ATRIUM_DATA to the folder of recordings")
    readings = ble_walks(folder)
    every = [*TAUGHT_BY, *HELD_OUT]
    task = progress.add_task("walks", total=len(every) + 1)
    withheld = measured(readings, TAUGHT_BY, HELD_OUT, options.seed)
    progress.advance(task)
    figures: dict[str, float | None] = {}
    for name, off in withheld.items():
        ending = f"_{name}" if name else ""
        figures[f"ble_mean{ending}"] = float(off.mean())
        figures[f"ble_p50{ending}"], figures[f"ble_p90{ending}"] = np.quantile(off, (0.5, 0.9)).tolist()
    left_out: dict[str, list[Array]] = {}
    for walk in every:
        found = measured(readings, [other for other in every if other != walk], [walk], options.seed)
        for name, off in found.items():
            left_out.setdefault(name, []).append(off)
        progress.advance(task)
    for name in ("constants", ""):
        ending = f"_{name}" if name else ""
        figures[f"ble_mean_each_left_out{ending}"] = float(np.concatenate(left_out[name]).mean())
    draw(withheld, options.picture)
    return figures


def draw(off: Mapping[str, Array], picture: Path) -> None:
    """Draw the distributions of errors (n,) in metres on the withheld walks."""
    titles = {
        "constants": "constants",
        "map": "+ shadowing map",
        "": "+ honest noise",
        "smoothed": f"… {LAG:g} s later",
    }
    figure = Figure(figsize=(6.0, 4.0))
    axis = figure.add_subplot()
    for name, values in off.items():
        axis.plot(np.sort(values), np.linspace(0.0, 1.0, len(values)), "--" if name == "smoothed" else "-")
        axis.lines[-1].set_label(f"{titles[name]}: mean {values.mean():.2f} m")
    axis.set(xlabel="error, m", ylabel="share of adverts", xlim=(0.0, 6.0), ylim=(0.0, 1.0))
    axis.grid(visible=True, alpha=0.25)
    axis.legend(loc="lower right")
    figure.tight_layout()
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=110)


EXPERIMENT = Experiment(
    name="ble-positions",
    question="Do radio models learned on some walks place a beacon better on others, by radio alone?",
    kind="recording",
    scenario="ble-positions",
    run=run,
    made="""A beacon carried overhead through a hall of 21 x 18 m, heard by twelve receivers, truth within 5 cm. Five
walks, six minutes together; in the order of their names the first, third and fifth teach, the second and fourth are
withheld (`ble_mean`). The filter is causal: 2000 particles, five runs of it pooled, an error for each advert.
`_constants`: power and exponent of each receiver are learned (a reference reads 1.90 m over all walks); `_map`: the
shadowing map too, with the noise of phones' Wi-Fi; without an ending: with the noise that walks which taught leave when
each is foretold from the others. `_smoothed` waits three seconds. `_each_left_out`: each walk in turn, taught by the
four others; speed and noise are of the walks that teach. On the two withheld walks constants alone do nearly as well
as the map; over all five they do not.""",
    at_most={"ble_mean": 1.6},
    picture="Errors on the withheld walks, by what was learned.",
)


def main() -> int:
    """Run the experiment from the command line."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
