"""``atrium bench``: list the experiments, or run one."""

from __future__ import annotations

import importlib
import sys

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from benchmarks.experiment import declaration, modules


def main(arguments: list[str]) -> int:
    """List the experiments with what they ask; with a name, run that one with the options that follow."""
    console = Console(highlight=False)
    found = modules()
    if not arguments or arguments[0] in ("list", "--help", "-h"):
        table = Table("experiment", "question", title="atrium bench NAME; --help after a name shows its options")
        for name, module in found.items():
            table.add_row(name, escape(_question(module)))
        console.print(table)
        return 0
    name, *options = arguments
    if name not in found:
        console.print(f"{escape(name)}: no such experiment; there are: {', '.join(found)}")
        return 2
    sys.argv = [f"atrium bench {name}", *options]
    status: int = importlib.import_module(found[name]).main()
    return status


def _question(module: str) -> str:
    """Return what an experiment asks; one that cannot be imported here says why instead."""
    try:
        loaded = importlib.import_module(module)
    except ImportError as error:
        return f"cannot be run here: {error}"
    declared = declaration(loaded)
    return declared.question if declared else (loaded.__doc__ or "").partition("\n")[0]


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
