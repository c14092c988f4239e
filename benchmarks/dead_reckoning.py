"""How well do steps, lengths and headings of a phone tell where its carrier went? (``atrium bench dead-reckoning``)

One run gathers what is measured apart: steps on foot-switch recordings (``step_table``), legs of a shopping mall
(here), pocket headings and the side of the phone on the twin (``pocket_headings``, ``offset_signs``), clocks
(``clock_offsets``), speed (``reckoning_speed``).
"""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from rich.progress import Progress

from benchmarks import clock_offsets, offset_signs, pocket_headings, reckoning_speed, step_table
from benchmarks.experiment import Experiment, ExperimentError, Figures, Options, Study
from benchmarks.mall_headings import chosen_headings, rival_headings
from benchmarks.mall_picture import draw_headings, draw_lengths, draw_plan
from benchmarks.mall_reckoning import Walked, honesty, reckon, scores
from benchmarks.mall_strides import LAWS, gait, held_out, personal
from benchmarks.mall_traces import Trace, load_traces
from shared.settings import data_folder

__all__ = ["EXPERIMENT", "Mall", "main", "mall"]

SHOWN = 20, 15, 3, 34, 48, 63
"""Traces in the picture: long ones, good and bad, all over the floor."""


@dataclass(frozen=True, slots=True)
class Mall:
    """What was made of the mall's traces.

    Attributes:
        traces: all.
        walked: as the gateway ships it, but with the stride of all traces but each.
        laws: the same with other laws of step length, by name.
        ways: the same with other ways of telling headings, by name.
        figures: by name.
    """

    traces: list[Trace]
    walked: list[Walked]
    laws: dict[str, list[Walked]]
    ways: dict[str, list[Walked]]
    figures: dict[str, float]


_OF_HEADINGS = ("heading_error_deg", "heading_error_p90_deg", "turn_error_deg", "end_drift")


def mall(data: Path, rivals: bool = True) -> Mall:
    """Measure the mall's traces; without ``rivals`` only what ships."""
    traces = load_traces(data)
    shipped = reckon(traces)
    gaits = [gait(trace, walked.t) for trace, walked in zip(traces, shipped, strict=True)]
    walked, law = held_out(LAWS["universal"], traces, shipped, gaits)
    figures = scores(traces, walked) | honesty(traces, walked)
    figures |= {f"stride_{name}": float(c) for name, c in zip(("level", "per_cadence", "per_bounce"), law, strict=True)}
    with_constants = scores(traces, shipped)
    figures |= {f"shipped_{name}": with_constants[name] for name in ("leg_error", *_OF_HEADINGS)}
    laws: dict[str, list[Walked]] = {}
    ways: dict[str, list[Walked]] = {}
    if rivals:
        laws = {name: held_out(law, traces, shipped, gaits)[0] for name, law in LAWS.items() if name != "universal"}
        chosen, constants = chosen_headings(traces)
        figures["chosen_compass_tau_s"], figures["chosen_iron_sigma"] = np.median(constants, axis=0).tolist()
        ways = {name: _relengthened(traces, way) for name, way in [("chosen", chosen), *rival_headings(traces).items()]}
        for name, other in laws.items():
            told = scores(traces, other)
            figures |= {f"{name}_{figure}": told[figure] for figure in ("leg_error", "trace_total_error", "end_drift")}
        for name, other in ways.items():
            told = scores(traces, other)
            prefix = "" if name == "chosen" else f"{name}_"
            figures |= {f"{prefix}{figure}": told[figure] for figure in _OF_HEADINGS}
        figures |= personal(traces, walked, gaits)
    return Mall(traces, walked, laws, ways, figures)


def _relengthened(traces: Sequence[Trace], way: Sequence[Walked]) -> list[Walked]:
    """Return walks with other headings, their lengths by the universal law as held out as where it is judged."""
    gaits = [gait(trace, walked.t) for trace, walked in zip(traces, way, strict=True)]
    return held_out(LAWS["universal"], traces, way, gaits)[0]


def run(options: Options, progress: Progress) -> Figures:
    """Measure all parts, draw, return the figures."""
    data = data_folder()
    if not data.is_dir():
        raise ExperimentError(f"needs the recordings: set ATRIUM_DATA (now {data}) to their folder")
    task = progress.add_task("parts", total=6)
    figures: dict[str, float] = dict(reckoning_speed.measure())  # first, while nothing else runs
    progress.advance(task)
    real = mall(data)
    progress.advance(task)
    figures |= real.figures | pocket_headings.measure(options.seed)
    progress.advance(task)
    figures |= offset_signs.measure(options.seed, real.traces)
    progress.advance(task)
    figures |= clock_offsets.measure(options.seed)
    progress.advance(task)
    figures |= step_table.measure(progress, options.jobs)
    progress.advance(task)
    _draw(data, real, figures, options.picture)
    return {name: figures[name] for name in sorted(figures, key=_place)}


def _place(name: str) -> tuple[int, int]:
    """Return where a figure is shown: the ones with a bar first."""
    first = list(BARS)
    return (0, first.index(name)) if name in first else (1, 0)


def _draw(data: Path, real: Mall, figures: Mapping[str, float], picture: Path) -> None:
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(2, 3, figsize=(16, 9.5), layout="constrained")
    draw_plan(axes[0, 0], data, [real.traces[n] for n in SHOWN], [real.walked[n] for n in SHOWN])
    draw_lengths(axes[0, 1], real.traces, {"universal": real.walked, **real.laws})
    draw_headings(axes[0, 2], real.traces, {"shipped": real.walked, **real.ways})
    _draw_steps(axes[1, 0], figures)
    methods = [name.removesuffix("_heading_deg") for name in figures if f"thigh_{name}" in figures]
    pocket = {method.replace("_", " "): figures[f"{method}_heading_deg"] for method in methods}
    _bars(axes[1, 1], pocket, "pocket heading on the twin, median error, degrees")
    signs = {name.replace("_", " "): 100.0 * value for name, value in figures.items() if "offset_sign_" in name}
    _bars(axes[1, 2], signs, "side to which the phone is turned told right, %")
    picture.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(picture, dpi=80)
    plt.close(figure)


def _draw_steps(axes: Axes, figures: Mapping[str, float]) -> None:
    """Draw the median count error of each detector, by position."""
    places = ("hand", "front", "back", "purse")
    for name in step_table.METHODS:
        prefix = "" if name == step_table.SHIPPED_METHOD else f"{name}_"
        values = [max(100.0 * figures[f"{prefix}step_error_{place}"], 0.05) for place in places]
        axes.plot(places, values, "o-", lw=2.5 if not prefix else 0.8, ms=4, label=name.replace("_", " "))
    axes.set(yscale="log", title="steps counted, median error of a recording, %, held out")
    axes.legend(frameon=False, fontsize=7, ncols=3, loc="upper center", bbox_to_anchor=(0.5, -0.06))


def _bars(axes: Axes, values: Mapping[str, float], title: str) -> None:
    bars = axes.barh(list(values), list(values.values()))
    axes.bar_label(bars, fmt="%.3g", fontsize=8)
    axes.invert_yaxis()
    axes.set(title=title)
    axes.tick_params(axis="y", labelsize=8)


MADE = """Six measurements, gathered; what is fitted is fitted without the person or trace that it is judged on.

*Steps*: 33 recordings of three people (`step-counter`), whole files with their seconds of handling, against foot
switches with the edges that one of them missed repaired; the truth itself is sure to 0 to 2 %. `step_error_*` is the
median error of a recording's count by position, `step_worst_*` of the worst recording, `step_f1` of steps matched one
to one within 0.25 s at one lag per recording (`step_f1_common_lag`: at one lag for all recordings), `false_steps_per_s`
what is told before the first and after the last true step. Figures without a prefix are of the method that ships, its
constants chosen on two people and judged on the third. Three people are few: two of them hardly handle the phone before
and after they walk, and constants chosen on those two tell more false steps of the third than is asked, and miscount
one of their purse recordings by more. `shipped_*` has the constants that ship, which have seen all three, and stays
within all of these bars.

*Legs*: 80 traces of surveyors in a shopping mall (`indoor-location`, 2.9 km, one phone model, held flat), way-points
stamped by hand. A step counts to the leg in which it ended. `leg_error` is of legs over 5 m, `heading_error_deg` of the
mean heading of legs over 10 m without the first 1.2 s, `turn_error_deg` of the change of heading between neighbouring
legs over 5 m, `end_drift` the distance by which the end of a trace of 20 m or more is missed, as a share of its way;
medians all. The universal stride model is fitted leg by leg to all traces but the one judged, its slopes believed by
three quarters (`bounce_fully_*`: fully). Headings are held out too: `heading_error_deg`, `turn_error_deg` and
`end_drift` take for each trace the best of sixteen pairs of time constant (1 to 30 s) and iron on all others (by the
mean error of legs over 5 m). `shipped_*` has the stride and the constants that ship, which are not held out: these
traces were seen when the sizes of iron and building and the compass's 15 s were settled. The difference is what
choosing among equals costs: the eight pairs with an iron of 6 or 10 µT are within a standard error of each other. North
is the plan's +y; magnetic declination is not taken out. `*_within_N_sigma` and `end_nees` compare errors with the
variances that the gateway tells. Neighbouring steps err alike, so that variances of single steps are as large as makes
sums honest. In-sample: the spread of single steps' lengths (30 %) and of headings in the hand (30° of a step, 8° common
to all) were chosen on these very traces, so that these figures say that nothing got worse, and not what other people
would give. A way-point is taken to be sure to 0.6 m: an assumption, for no truth tells how far a surveyor's tap is off;
`end_nees_way_point_*` has none, 0.3 and 0.6 m of it. The doubt of lengths that steps have in common is larger than
these traces alone say, for strangers' sake. `*_low` and `*_high` are between what honest variances would give in 95 of
100 data sets, legs taken as independent. The shares within one σ are above that: single legs come out better than told.
Their bars are wider (0.60 to 0.85), set by what was seen, and only keep them from getting worse. `with_iron_*` leaves
the phone's own iron in, `thesis_*` has also the thesis' time constant, `mean_compass_*` follows the gyroscope and the
mean compass, `rotation_vector_*` is the phone's own. Medians of a hundred legs hop by half a degree from one choice to
the next; ninth deciles do so less. `second_half_*` is the error on the second half of a trace: of the universal model
fitted to all other traces, of a plain line through (cadence, length) of the first half, and of that line with a prior.
The line knows no bounce and half a trace is short: it learns from more than that, or not at all.

*Pocket* (`pocket_*`, the five rivals of the dissertation, `thigh_*` for a swinging thigh that shares no code with the
twin) and *side of the phone* (`offset_*`) are of the twin, whose gait follows the same studies: they say that the
methods are made right, not how people walk. Headings are scored from the first step that has one, the third;
`pocket_settled_*` from 20 s on, `pocket_rested_*` after ten seconds of rest. The twin's sway has exactly the phase by
which the side is told, so that `offset_sign_*` cannot fail there and its bars, which were asked for on the twin, prove
little. `mall_offset_sign_*` is of real phones, pointing ahead and turned by 15 and 30 degrees in software: there the
side at 15 degrees is told rightly a little less often than the study says. `*_braking` is the rule as the study prints
it (Eq. 3.22), on the mall hardly better than a coin (49 % at 15 degrees, 57 % at 30). The other `mall_offset_*` say
that taking the offset into account makes these real headings worse, not better.

*Clock*: `clock_*` is the 95th percentile of the errors of stamps after 30 s of one post a second, of clocks up to 30 s
off that drift by up to 100 ppm, over journeys of 20 to 500 ms and worse ones; the worst kind counts.

*Speed*: `phones_realtime_100hz` is seconds of data per second of one core, by the clock of the processor.
"""

BARS: dict[str, tuple[float | None, float | None]] = {
    "step_error_hand": (None, 0.01),
    "step_error_front": (None, 0.01),
    "step_error_back": (None, 0.015),
    "step_error_purse": (None, 0.01),
    "step_worst_hand": (None, 0.07),
    "step_worst_front": (None, 0.04),
    "step_worst_back": (None, 0.04),
    "step_worst_purse": (None, 0.04),
    "step_f1": (0.97, None),
    "false_steps_per_s": (None, 0.12),
    "leg_error": (None, 0.075),
    "heading_error_deg": (None, 7.5),
    "end_drift": (None, 0.125),
    "end_nees": (1.53, 2.53),
    "leg_within_1_sigma": (0.60, 0.85),
    "leg_within_2_sigma": (0.92, 0.99),
    "heading_within_1_sigma": (0.60, 0.85),
    "heading_within_2_sigma": (0.92, 0.99),
    "pocket_heading_deg": (None, 4.0),
    "pocket_rested_heading_deg": (None, 4.0),
    "offset_sign_30": (0.85, None),
    "offset_sign_15": (0.71, None),
    "clock_p95_ms": (None, 100.0),
    "phones_realtime_100hz": (500.0, None),
}
"""At least and at most, in the order in which figures are shown."""

EXPERIMENT = Experiment(
    name="dead-reckoning",
    question="How well do steps, lengths and headings of a phone tell where its carrier went?",
    kind="recording",
    scenario="recordings",
    seed=101,
    run=run,
    made=MADE,
    studies={
        "step_error_hand": Study(0.0077, "[self-calibrating-rss-thesis E3.8]"),
        "step_error_front": Study(0.0245, "[nonvisual-visual-fusion-dissertation §7.2]"),
        "pocket_heading_deg": Study(3.8, "[nonvisual-visual-fusion-dissertation §7.2]"),
        "offset_sign_30": Study(0.857, "[self-calibrating-rss-thesis E3.5]"),
        "offset_sign_15": Study(0.708, "[self-calibrating-rss-thesis E3.5]"),
        "mall_offset_sign_30": Study(0.857, "[self-calibrating-rss-thesis E3.5]"),
        "mall_offset_sign_15": Study(0.708, "[self-calibrating-rss-thesis E3.5]"),
        "mall_offset_sign_30_braking": Study(0.857, "[self-calibrating-rss-thesis E3.5]"),
        "mall_offset_sign_15_braking": Study(0.708, "[self-calibrating-rss-thesis E3.5]"),
    },
    difference="Other people, phones and buildings: their recordings are not public. Headings in the pocket and sides "
    "of the phone are real people's there and the twin's here.",
    at_least={name: low for name, (low, _) in BARS.items() if low is not None},
    at_most={name: high for name, (_, high) in BARS.items() if high is not None},
    picture="traces on the mall's plan; errors of lengths and headings of legs, by method; steps counted, pocket "
    "headings and sides of the phone, by method",
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
