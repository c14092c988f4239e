"""Each container installs one extra: what its service imports must be in it."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).resolve().parents[3]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def normal(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


WITHOUT_DEPENDENCIES = {
    normal(line.split("==")[0])
    for line in (ROOT / "requirements-no-deps.txt").read_text(encoding="utf-8").splitlines()
    if line and not line.startswith("#")
}
EXTRA_OF = {path.parent.name: path.parent.name for path in (ROOT / "services").glob("*/__main__.py")}


def closure(requirements: list[str]) -> set[str]:
    """Names of the distributions that installing these brings along."""
    found: set[str] = set()
    waiting = [Requirement(text) for text in requirements]
    while waiting:
        requirement = waiting.pop()
        name = normal(requirement.name)
        if name in found:
            continue
        found.add(name)
        try:
            further = requires(name) or []
        except PackageNotFoundError:
            continue
        for text in further:
            inner = Requirement(text)
            extras = requirement.extras or {""}
            if inner.marker is None or any(inner.marker.evaluate({"extra": extra}) for extra in extras):
                waiting.append(inner)
    return found


def imports(folder: Path) -> Iterator[tuple[str, Path]]:
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
                names = [node.module]
            for name in names:
                yield name.split(".")[0], file.relative_to(ROOT)


WITH_DATABASE = ("gateway", "history", "learning")
"""Who has a database installs what ``shared/database.py`` imports; to nobody else it is of any use."""


@pytest.mark.parametrize("service", sorted(EXTRA_OF))
def test_a_service_imports_only_what_its_container_installs(service: str) -> None:
    installed = closure([*PROJECT["dependencies"], *PROJECT["optional-dependencies"][service]])
    if service == "simulator":
        installed |= WITHOUT_DEPENDENCIES
    owners = packages_distributions()
    for folder in (ROOT / "services" / service, ROOT / "shared"):
        for module, file in imports(folder):
            if module in sys.stdlib_module_names or module in ("services", "shared", "uvicorn"):
                continue
            if file == Path("shared/database.py") and service not in WITH_DATABASE:
                continue
            assert {normal(owner) for owner in owners.get(module, [])} & installed, f"{file} imports {module}"
