"""Scenarios are frozen: who changes one, or a default it relies on, must know that results no longer compare.

After a change that is meant, say in the commit why, run ``atrium bench anchors`` and ``atrium bench office`` anew,
and refresh the file:  python tests/unit/simulator/test_frozen_scenarios.py
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from services.simulator.scenario_loading import load_scenario, scenario_digest

SITES = Path(__file__).resolve().parents[3] / "deploy" / "sites"
FROZEN = Path(__file__).with_name("frozen_scenarios.json")
SCENARIOS = ("construction-1", "construction-2", "crowd", "mall", "museum", "office")


def digest(name: str) -> str:
    return scenario_digest(*load_scenario(SITES / name / "scenario.yaml"))


@pytest.mark.parametrize("name", SCENARIOS)
def test_a_frozen_scenario_has_not_changed(name: str) -> None:
    frozen = json.loads(FROZEN.read_text(encoding="utf-8"))
    assert digest(name) == frozen[name], f"{name} is not what it was when results were measured; see this file's head"


if __name__ == "__main__":
    FROZEN.write_text(json.dumps({name: digest(name) for name in SCENARIOS}, indent=2) + "\n", encoding="utf-8")
