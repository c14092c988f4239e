"""How results are written: one JSON file per experiment, flat figures, shares as fractions, errors in metres."""

from __future__ import annotations

import json
import math
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path

__all__ = ["PICTURES", "RESULTS", "format_figure", "read_figures", "write_result"]

RESULTS = Path(__file__).resolve().parent / "results"
PICTURES = RESULTS.parent.parent / "docs" / "pictures"


def write_result(
    experiment: str, scenario: str, seed: int, figures: Mapping[str, float | None], out: Path | None = None
) -> Path:
    """Write a result and return where. Only the default seed and scenario may go to ``benchmarks/results``.

    Args:
        experiment: its name; also the file's.
        scenario: what world was measured.
        seed: of everything random.
        figures: flat names to numbers.
        out: another folder to write to.
    """
    folder = out or RESULTS
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{experiment}.json"
    document = {
        "experiment": experiment,
        "scenario": scenario,
        "seed": seed,
        "commit": _commit(),
        "machine": f"{platform.machine()}, {_cores()} cores, Python {platform.python_version()}",
        "figures": {name: _stored(value) for name, value in figures.items()},
    }
    path.write_text(json.dumps(document, indent=2, allow_nan=False) + "\n", encoding="utf-8")
    return path


def format_figure(value: float | None) -> str:
    """Return a figure as tables show it: four digits, a dash where it is not defined."""
    return "–" if value is None else format(value, ".4g")


def read_figures(experiment: str) -> dict[str, float]:
    """Return the stored figures of an experiment."""
    figures: dict[str, float] = json.loads((RESULTS / f"{experiment}.json").read_text(encoding="utf-8"))["figures"]
    return figures


def _stored(value: float | None) -> float | None:
    """Round to four places; what is not a number, or infinite, is stored as not defined."""
    if value is None or not math.isfinite(value):
        return None
    return value if isinstance(value, int) else round(float(value), 4)


def _cores() -> int:
    import os

    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _commit() -> str:
    """Return the commit the code is at; ``-changed`` where code, not results, differs from it."""
    folder = RESULTS.parent.parent
    name = subprocess.run(["git", "rev-parse", "--short", "HEAD"], cwd=folder, capture_output=True, text=True)
    code = ["*.py", "deploy", "pyproject.toml", "constraints.txt"]
    changed = subprocess.run(["git", "diff", "--quiet", "HEAD", "--", *code], cwd=folder)
    return (name.stdout.strip() or "unknown") + ("-changed" if changed.returncode else "")
