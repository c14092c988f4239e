"""Is the twin's radio like real radio? Residuals, correlation, bodies and misses of recordings and of their twins.

Each recording is looked at by fitting a path-loss line per transmitter and asking what is left; then the twin, with its
default parameters, is asked what a phone would have heard at the same instants and places, and looked at in the same
way. Run it with ``atrium bench radio-fit``.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from rich.table import Table

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.radio_counterpart import counterpart
from benchmarks.radio_fit_picture import Look, draw
from benchmarks.radio_recordings import Readings, ble_points, ble_walks, mall_beacons, mall_walls, mall_wifi, rooms
from benchmarks.radio_residuals import (
    Curve,
    body_effect,
    correlation,
    exponential,
    fit_path_loss,
    means,
    missed_at_rest,
    missed_between,
    moments,
    rest,
    wall_effect,
)
from services.simulator.radio.radio_world import RadioParameters
from shared.angles import wrap
from shared.settings import data_folder

__all__ = ["EXPERIMENT", "look_at_points", "look_at_walks", "main", "measure"]

Array = NDArray[np.float64]
Index = NDArray[np.int64]

WORLDS = 3
"""Twins of each recording; their figures are averaged."""
EMPTY_ROOM = {"fading_time": 1e6}
"""Half hours in rooms with nobody about: fading that stands still, which in the twin's halls it does not."""
OVERHEAD = {"body_loss": 0.0, "facing_sigma": 0.0}
"""A beacon carried overhead, or a phone on a stand: nobody's body is in the way."""


def look_at_walks(readings: Readings, walls: Sequence[Array] = ()) -> Look:
    """Return what is found of readings along walks."""
    fit = fit_path_loss(readings)
    residual, walk, heading = fit.residual, readings.walk, readings.heading

    def turn(i: Index, j: Index) -> Array:
        turned: Array = np.abs(wrap(heading[i] - heading[j]))
        return turned

    curves = {
        "same walk": correlation(
            readings, residual, lambda i, j: (walk[i] == walk[j]) & (readings.scan[i] != readings.scan[j])
        ),
        "other walk": correlation(readings, residual, lambda i, j: walk[i] != walk[j]),
        "same way": correlation(readings, residual, lambda i, j: (walk[i] != walk[j]) & (turn(i, j) < 0.6)),
        "opposite way": correlation(readings, residual, lambda i, j: (walk[i] != walk[j]) & (turn(i, j) > 2.5)),
        "missed": missed_between(readings),
    }
    sigma, skew, kurtosis = moments(residual)
    share, length = exponential(curves["other walk"])
    body, curves["body"] = body_effect(readings, fit)
    figures = {
        "sigma": sigma,
        "skew": skew,
        "kurtosis": kurtosis,
        "correlated_share": share,
        "correlation_length_m": length,
        **{
            f"correlation_{name.replace(' ', '_')}": _between(curves[name], 0.5, 3.0)
            for name in ("same walk", "other walk", "same way", "opposite way")
        },
        "body_db": body,
        "missed_strong": _between(curves["missed"], -75.0, -55.0),
        "missed_weak": _between(curves["missed"], -91.0, -85.0),
    }
    if len(walls):
        figures["wall_db"] = wall_effect(readings, fit, walls)
    return Look(figures, curves, residual)


def look_at_points(readings: Readings) -> Look:
    """Return what is found of readings at rest."""
    fit = fit_path_loss(means(readings))
    deviation = rest(readings)
    missed = missed_at_rest(readings)
    figures = {
        "sigma_of_means": float(fit.residual.std()),
        "sigma": float(np.sqrt(np.mean(deviation**2))),
        "sigma_p10": float(np.quantile(deviation, 0.1)),
        "sigma_p90": float(np.quantile(deviation, 0.9)),
        "missed_strong": _between(missed, -75.0, -60.0),
        "missed_weak": _between(missed, -91.0, -85.0),
    }
    return Look(figures, {"missed": missed}, fit.residual)


def measure(data: Path, seed: int, progress: Progress) -> tuple[dict[str, Look], dict[str, list[Look]]]:
    """Return what is found of each recording, and of each of its twins."""
    task = progress.add_task("recordings and twins", total=6 * (1 + WORLDS))
    real: dict[str, Look] = {}
    twins: dict[str, list[Look]] = {}
    defaults = RadioParameters()
    walls = mall_walls(data)
    sets: list[tuple[str, Readings, str, dict[str, Any], Sequence[Array]]] = [
        ("ble", ble_walks(data), "ble", OVERHEAD, ()),
        ("mall", mall_wifi(data), "wifi", {}, walls),
        ("beacons", mall_beacons(data), "ble", {}, walls),
        ("rest", ble_points(data), "ble", {**OVERHEAD, **EMPTY_ROOM}, ()),
    ]
    for name, readings, kind, special, around in sets:
        at_rest = name == "rest"
        real[name] = look_at_points(readings) if at_rest else look_at_walks(readings, around)
        progress.advance(task)
        fit, chosen, twins[name] = fit_path_loss(readings), defaults.model_copy(update=special), []
        for world in range(WORLDS):
            heard = counterpart(readings, fit, kind, seed + world, chosen, around)
            twins[name].append(look_at_points(heard) if at_rest else look_at_walks(heard, around))
            progress.advance(task)
    for technology, kind in (("WiFi", "wifi"), ("BLE", "ble")):
        name = f"room_{kind}"
        readings, sequences = rooms(data, technology)
        fit = fit_path_loss(readings)
        wavering = float(np.sqrt(np.mean([sequence.var() for sequence in sequences])))
        real[name] = Look({"sigma_of_means": float(fit.residual.std()), "sigma": wavering}, {}, fit.residual)
        progress.advance(task)
        chosen, twins[name] = defaults.model_copy(update={**OVERHEAD, **EMPTY_ROOM}), []
        for world in range(WORLDS):
            found = look_at_points(counterpart(readings, fit, kind, seed + world, chosen))
            kept = {key: found.figures[key] for key in ("sigma_of_means", "sigma")}
            twins[name].append(Look(kept, {}, found.residual))
            progress.advance(task)
    return real, twins


def run(options: Options, progress: Progress) -> Figures:
    """Measure, draw, print the two side by side; return the figures."""
    data = data_folder()
    if not data.is_dir():
        raise ExperimentError(f"needs the recordings: set ATRIUM_DATA (now {data}) to their folder")
    real, twins = measure(data, options.seed, progress)
    draw(real, twins, options.picture)
    table = Table("recording", "quantity", "recorded", "twin", title="The twin's radio beside real radio")
    figures: dict[str, float | None] = {}
    for name, look in real.items():
        for quantity, value in look.figures.items():
            told = [twin.figures[quantity] for twin in twins[name]]
            mean = float(np.mean([one for one in told if np.isfinite(one)] or [np.nan]))
            table.add_row(name, quantity, _shown(value), _shown(mean))
            figures[f"{name}_{quantity}_real"] = _or_none(value)
            figures[f"{name}_{quantity}_twin"] = _or_none(mean)
    progress.console.print(table)
    return figures


MADE = """For each transmitter a path-loss line is fitted to the recording (and its place, where nobody knows it), and
what is left is compared with what is left of the same walks through the twin's radio: default parameters, mean of three
seeds. `ble` is a beacon carried overhead through a hall of 21 x 18 m (`ble-positions`, truth within 5 cm), `rest` the
same beacon for five minutes at each of 45 points; `mall` is Wi-Fi and `beacons` are iBeacons heard by a phone carried
through a shopping mall (`indoor-location`, truth interpolated between way-points), the outlines of the shops taken as
walls; `room_wifi` and `room_ble` are readings on a 0.5 m grid of a small room (`rss-rooms`).
`correlation_*` is the mean correlation of residuals of one transmitter at places 0.5 to 3 m apart: within a walk, with
other walks, and with other walks in the same or the opposite direction. `body_db` is by how much a transmitter ahead is
heard better than one behind; `wall_db` what one wall more costs, as far as it shows with places fitted to metres.
`missed_*` is the share of scans (adverts) in which a strong (above -75 dBm) or weak (-91 to -85 dBm) one is missing.

The defaults were chosen so that the two agree in the hall and in the mall; no tracker was looked at. What the
recordings cannot tell: how phones' offsets differ (each was made with one phone), how fast fading changes in a hall
full of people (these rooms were empty; the twin's 60 s is a guess), and drift over hours (below about 1 dB in the
hall). Where they differ: addresses of the mall's beacons do not stay at a place from walk to walk; the small room's
means spread more than the twin's, and its BLE readings waver by 8 dB at rest, twice what the hall's do; a wall of the
mall's plan shows less than the twin's: shop fronts are glass, and who knows where the access points really hang.
"""

EXPERIMENT = Experiment(
    name="radio-fit",
    question="Is the twin's radio like real radio?",
    kind="model",
    scenario="recordings",
    run=run,
    made=MADE,
    picture="residuals of path loss, their correlation in space, bodies and misses: recorded (black), twin (orange)",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


def _between(curve: Curve, low: float, high: float) -> float:
    """Return the mean of a curve over classes whose middle lies between; NaN where nothing is known."""
    inside = (curve.x >= low) & (curve.x <= high) & np.isfinite(curve.y)
    return float(np.average(curve.y[inside], weights=curve.count[inside])) if inside.any() else float("nan")


def _or_none(value: float) -> float | None:
    return value if np.isfinite(value) else None


def _shown(value: float) -> str:
    return f"{value:.2f}" if np.isfinite(value) else "–"


if __name__ == "__main__":
    sys.exit(main())
