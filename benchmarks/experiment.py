"""What is an experiment? A declaration, a function that measures, and one command line for all of them.

A module ``benchmarks/some_name.py`` that ends with::

    EXPERIMENT = Experiment(name="some-name", question="How …?", run=run, …)


    def main() -> int:
        return EXPERIMENT.main()

is the experiment ``atrium bench some-name``; docs/experiments.md shows one from beginning to end.
"""

from __future__ import annotations

import argparse
import importlib
import multiprocessing
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from pathlib import Path
from types import ModuleType
from typing import Any, Literal, TypeVar

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from benchmarks.result import PICTURES, RESULTS, format_figure, write_result
from shared.site import SiteError

__all__ = ["Experiment", "ExperimentError", "Figures", "Options", "Study", "experiments", "in_parallel", "modules"]

Figures = Mapping[str, float | None]
"""Flat names to numbers: shares are fractions, errors metres unless the name says otherwise; None where undefined."""

T = TypeVar("T")


class ExperimentError(ValueError):
    """An experiment cannot be run as it was asked for: the text says what was asked and what is allowed."""


@dataclass(frozen=True, slots=True)
class Study:
    """What an original study reports for a figure of ours.

    Attributes:
        value: a number, or words such as "below 1".
        source: method sheet and section, for example "[ravel-thesis §11.3]".
    """

    value: float | str
    source: str

    def __str__(self) -> str:
        """As shown beside our figure."""
        value = self.value if isinstance(self.value, str) else f"{self.value:g}"
        return f"{value} {self.source}"


@dataclass(frozen=True, slots=True)
class Options:
    """What was asked for on the command line.

    Attributes:
        scenario: which world or recording.
        seed: of everything random.
        jobs: processes that may be busy at once.
        picture: where to draw.
        out: where other files may be left; None where only the result and the picture are wanted.
        more: options of this experiment's own.
    """

    scenario: str
    seed: int
    jobs: int = 1
    picture: Path = PICTURES / "unnamed.png"
    out: Path | None = None
    more: argparse.Namespace = field(default_factory=argparse.Namespace)


@dataclass(frozen=True, kw_only=True)
class Experiment:
    """One thing that is measured, and all a reader of the results page needs to know about it.

    Attributes:
        name: of the command, the result file and the picture, with dashes.
        question: what is asked, in one line.
        kind: what its figures can be trusted for; a part of the results page.
        scenario: the default; only it, with the default seed, may be stored in ``benchmarks/results``.
        run: measures; shows how far it is on the progress bar and draws ``options.picture`` where ``picture`` is set.
        seed: the default.
        scenarios: others that may be asked for; None where ``run`` itself judges the name.
        seeds: whether other seeds than the default one can be asked for.
        made: how the figures come about, Markdown for the results page: data, rules of scoring, limits.
        studies: what the original study reports, by name of our figure.
        difference: how its set-up differs from ours; needed with ``studies``.
        at_least: bars by name of figure; ``at_most`` likewise. They hold for the default scenario and seed.
        picture: what the picture shows, in one line; None where there is none.
        arguments: adds options of its own to the command line.
    """

    name: str
    question: str
    kind: Literal["recording", "twin", "model", "formula", "speed"]
    scenario: str
    run: Callable[[Options, Progress], Figures]
    seed: int = 0
    scenarios: tuple[str, ...] | None = ()
    seeds: bool = True
    made: str = ""
    studies: Mapping[str, Study] = field(default_factory=dict)
    difference: str = ""
    at_least: Mapping[str, float] = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)
    picture: str | None = None
    arguments: Callable[[argparse.ArgumentParser], None] | None = None

    def __post_init__(self) -> None:
        if self.studies and not self.difference:
            raise ValueError(f"{self.name}: figures of a study are shown only with the difference in set-up")

    def options(self, arguments: Sequence[str] | None = None) -> Options:
        """Return the options in ``arguments`` (default: the command line).

        Raises:
            ExperimentError: the scenario or seed is not to be had, or would overwrite the stored result.
        """
        parser = argparse.ArgumentParser(prog=f"atrium bench {self.name}", description=self.question)
        others = "" if not self.scenarios else f"; others: {', '.join(self.scenarios)}"
        parser.add_argument("--scenario", default=self.scenario, help=f"default {self.scenario}{others}")
        parser.add_argument("--seed", type=int, default=self.seed, help=f"default {self.seed}")
        parser.add_argument("--jobs", type=int, default=1, help="busy processes at once, where there are several runs")
        parser.add_argument("--out", type=Path, help="write result and picture here instead of benchmarks/results")
        if self.arguments is not None:
            self.arguments(parser)
        given = parser.parse_args(arguments)
        if self.scenarios is not None and given.scenario not in (self.scenario, *self.scenarios):
            allowed = ", ".join([self.scenario, *self.scenarios])
            raise ExperimentError(f"--scenario {given.scenario}: not a scenario of {self.name}; allowed: {allowed}")
        if not self.seeds and given.seed != self.seed:
            raise ExperimentError(f"--seed {given.seed}: {self.name} has one seed, {self.seed}")
        if given.seed < 0:
            raise ExperimentError(f"--seed {given.seed}: allowed: 0 and above")
        if given.jobs < 1:
            raise ExperimentError(f"--jobs {given.jobs}: allowed: 1 and above")
        default = (given.scenario, given.seed) == (self.scenario, self.seed)
        stored = given.out is None or given.out.resolve() in (RESULTS.resolve(), PICTURES.resolve())
        if stored and not default:
            raise ExperimentError(
                f"benchmarks/results holds {self.name} of scenario {self.scenario}, seed {self.seed} alone; "
                f"add --out FOLDER for scenario {given.scenario}, seed {given.seed}"
            )
        picture = (PICTURES if given.out is None else given.out) / f"{self.name}.png"
        return Options(given.scenario, given.seed, given.jobs, picture, given.out, given)

    def main(self, arguments: Sequence[str] | None = None, console: Console | None = None) -> int:
        """Run, print, write. Returns 0; 1 when a bar is missed or the data is not there; 2 for a wrong option."""
        console = console or Console(highlight=False)
        try:
            options = self.options(arguments)
        except ExperimentError as error:
            console.print(f"[red]{escape(str(error))}[/red]")
            return 2
        default = (options.scenario, options.seed) == (self.scenario, self.seed)
        try:
            if options.out is not None:
                options.out.mkdir(parents=True, exist_ok=True)
            with progress_bar(console) as progress:
                figures = self.run(options, progress)
            written = write_result(self.name, options.scenario, options.seed, figures, options.out)
        except (ExperimentError, SiteError, OSError) as error:
            console.print(f"[red]{escape(str(error))}[/red]")
            return 1
        console.print(self._table(figures, f"{options.scenario}, seed {options.seed}", default))
        console.print(f"written to {escape(str(written))}")
        if self.picture:
            console.print(f"drawn in {escape(str(options.picture))}")
        missed = self.missed(figures) if default else []
        if missed:
            console.print(f"[red]bar missed: {', '.join(missed)}[/red]")
        return 1 if missed else 0

    def missed(self, figures: Figures) -> list[str]:
        """Return the names of the figures that miss their bar; one that is not there misses it."""
        low = [name for name, bar in self.at_least.items() if not _number(figures.get(name)) >= bar]
        return low + [name for name, bar in self.at_most.items() if not _number(figures.get(name)) <= bar]

    def bar(self, figure: str) -> str:
        """Return the bar of a figure as shown in tables; empty where it has none."""
        low = [f"≥ {self.at_least[figure]:g}"] if figure in self.at_least else []
        return ", ".join(low + ([f"≤ {self.at_most[figure]:g}"] if figure in self.at_most else []))

    def _table(self, figures: Figures, world: str, bars: bool) -> Table:
        columns = ["figure", "measured"] + ["bar"] * bool(self.at_least or self.at_most) * bars
        columns += ["original study"] if self.studies else []
        table = Table(*columns, title=f"{escape(self.question)}\n{escape(world)}")
        for name, value in figures.items():
            row = [name, format_figure(value)]
            row += [self.bar(name)] if "bar" in columns else []
            row += [escape(str(self.studies.get(name, "")))] if self.studies else []
            table.add_row(*row)
        return table


def progress_bar(console: Console | None = None) -> Progress:
    """Return the progress bar of all experiments."""
    columns = TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn()
    return Progress(*columns, console=console or Console(), transient=True)


def in_parallel(
    work: Callable[..., T], cells: Sequence[tuple[Any, ...]], jobs: int, progress: Progress, description: str = "runs"
) -> list[T]:
    """Return ``work(*cell)`` of each independent cell, in their order, in up to ``jobs`` processes.

    Args:
        work: a function of a module; what it takes and returns must pickle where ``jobs`` > 1.
        cells: arguments, for example (scenario, seed).
        jobs: 1 computes here, one after the other.
        progress: gets a task with a step per cell.
        description: of that task.
    """
    task = progress.add_task(description, total=len(cells))
    if jobs == 1 or len(cells) < 2:
        results = []
        for cell in cells:
            results.append(work(*cell))
            progress.advance(task)
        return results
    # Spawned, not forked: the progress bar's thread may hold a lock at the moment of a fork.
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(jobs, len(cells)), mp_context=context) as pool:
        futures = [pool.submit(work, *cell) for cell in cells]
        try:
            for done in as_completed(futures):
                done.result()
                progress.advance(task)
        except BaseException:
            pool.shutdown(cancel_futures=True)  # the first failure ends the experiment now, not after all other cells
            raise
        return [future.result() for future in futures]


def modules() -> dict[str, str]:
    """Return the modules that are experiments, by the name of the command."""
    folder = Path(__file__).resolve().parent
    return {
        path.stem.replace("_", "-"): f"benchmarks.{path.stem}"
        for path in sorted(folder.glob("[a-z]*.py"))
        if "\ndef main(" in path.read_text(encoding="utf-8")
    }


def experiments() -> dict[str, Experiment]:
    """Return the declarations of all experiments, by name."""
    found: dict[str, Experiment] = {}
    for name, module in modules().items():
        declared = declaration(importlib.import_module(module))
        if declared is not None:
            found[name] = declared
    return found


def declaration(module: ModuleType) -> Experiment | None:
    """Return what a module declares; None for one that has a command line of its own."""
    declared = getattr(module, "EXPERIMENT", None)
    return declared if isinstance(declared, Experiment) else None


def _number(value: float | None) -> float:
    return float("nan") if value is None else value
