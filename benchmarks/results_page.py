"""Write ``docs/results.md`` from the stored results: what was asked, by which command, against which bar and study.

Run it with ``python -m benchmarks.results_page`` after an experiment; a test holds the page to the stored figures.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.experiment import Experiment, experiments
from benchmarks.result import PICTURES, RESULTS, format_figure

__all__ = ["PAGE", "render", "section"]

PAGE = PICTURES.parent / "results.md"

INTRODUCTION = """# Results

Every figure on this page comes from a command anyone can run; the page is generated from `benchmarks/results/*.json` by
`python -m benchmarks.results_page`. Shares are fractions, errors are metres unless the name says otherwise. How an
experiment is declared and added, and how the metrics are defined, is on [its own page](experiments.md).

A figure of an **original study** stands beside ours where there is one. The two were never measured on the same data:
the difference in set-up is said each time. Commands that need a public recording find it through `ATRIUM_DATA`.
"""

KINDS = {
    "recording": ("On real recordings", ""),
    "twin": (
        "On the simulated twin of the original sites",
        "No public recording has cameras, phones and truth together. The twin's noise was fixed with plain baselines "
        "alone, before any identity tracker was scored on it.",
    ),
    "model": ("The twin held against reality", ""),
    "formula": ("Formulas in small worlds of their own", ""),
    "speed": ("Speed", "Times depend on the machine named; what is compared was measured in the same run."),
}
"""What a reader can trust the figures for, in the order of the page."""


def render() -> str:
    """Return the page."""
    declared = experiments()
    stored = {path.stem: path for path in sorted(RESULTS.glob("*.json"), key=lambda path: path.stem)}
    unknown = sorted(set(stored) - set(declared))
    if unknown:
        raise ValueError(f"results without an experiment that declares them: {', '.join(unknown)}")
    parts = [INTRODUCTION, _contents(declared, stored)]
    for kind, (title, text) in KINDS.items():
        mine = [name for name in stored if declared[name].kind == kind]
        if mine:
            parts.append(f"## {title}\n" + (f"\n{text}\n" if text else ""))
            parts += [section(declared[name], json.loads(stored[name].read_text(encoding="utf-8"))) for name in mine]
    return "\n".join(parts)


def section(experiment: Experiment, document: Mapping[str, Any]) -> str:
    """Return what the page says of one experiment and its stored result."""
    lines = [f"### {experiment.name}", "", f"**{experiment.question}**", ""]
    lines += [f"`atrium bench {experiment.name}` · {document['scenario']}, seed {document['seed']} · "]
    lines[-1] += f"commit {document['commit']} · {document['machine']}"
    if experiment.made:
        lines += ["", experiment.made]
    if experiment.studies:
        lines += ["", f"*Beside the original study:* {experiment.difference}"]
    if experiment.picture:
        lines += ["", f"![{experiment.picture}](pictures/{experiment.name}.png)"]
    bars = bool(experiment.at_least or experiment.at_most)
    head = ["Figure", "Measured"] + ["Bar"] * bars + ["Original study"] * bool(experiment.studies)
    lines += ["", f"| {' | '.join(head)} |", f"| --- | ---: |{' ---: |' * bars}{' --- |' * bool(experiment.studies)}"]
    for name, value in document["figures"].items():
        row = [f"`{name}`", format_figure(value)]
        row += [experiment.bar(name)] * bars + [str(experiment.studies.get(name, ""))] * bool(experiment.studies)
        lines.append(f"| {' | '.join(row)} |")
    return "\n".join(lines) + "\n"


def _contents(declared: Mapping[str, Experiment], stored: Mapping[str, Path]) -> str:
    lines = ["| Experiment | Question |", "| --- | --- |"]
    for kind in KINDS:
        lines += [f"| [{n}](#{n}) | {declared[n].question} |" for n in stored if declared[n].kind == kind]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    PAGE.write_text(render(), encoding="utf-8")
