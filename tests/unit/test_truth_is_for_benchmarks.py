"""A tracker that could see the truth would prove nothing: no service but the simulator may touch it."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]
SERVICES = sorted(
    folder.name
    for folder in (PROJECT / "services").iterdir()
    if (folder / "__init__.py").is_file() and folder.name != "simulator"
)


def mentions_of_truth(source: str) -> list[int]:
    """Lines that import ``shared.truth`` or spell a key that ends in its name, or a wildcard that would hold it."""
    lines = []
    for node in ast.walk(ast.parse(source)):
        match node:
            case ast.ImportFrom(module=str(module)) if module.startswith("shared.truth"):
                lines.append(node.lineno)
            case ast.ImportFrom(module="shared", names=names) if any(name.name == "truth" for name in names):
                lines.append(node.lineno)
            case ast.Import(names=names) if any(name.name.startswith("shared.truth") for name in names):
                lines.append(node.lineno)
            case ast.Constant(value=str(text)) if text.endswith(("/truth", "/**")) or text == "shared.truth":
                lines.append(node.lineno)
    return lines


@pytest.mark.parametrize("service", SERVICES)
def test_no_service_reads_the_truth(service: str) -> None:
    found = {
        str(path.relative_to(PROJECT)): lines
        for path in (PROJECT / "services" / service).rglob("*.py")
        if (lines := mentions_of_truth(path.read_text(encoding="utf-8")))
    }
    assert not found


@pytest.mark.parametrize(
    "source",
    [
        "from shared.truth import GroundTruth",
        "from shared import truth",
        "import shared.truth as t",
        "key = f'{keys.root}/truth'",
        "key = 'atrium/1/hall/**'",
        "importlib.import_module('shared.truth')",
    ],
)
def test_the_search_finds_every_way_in(source: str) -> None:
    assert mentions_of_truth(source) == [1]


def test_the_services_were_found() -> None:
    assert {"camera", "fusion", "gateway", "api", "cli"} <= set(SERVICES)
