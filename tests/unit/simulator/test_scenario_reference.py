"""The page of all keys of a scenario file says what the check says, and says it of every key."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
import yaml
from pydantic import ValidationError

from services.simulator.scenario_file import Scenario
from services.simulator.scenario_reference import reference

PROJECT = Path(__file__).resolve().parents[3]
PAGE = PROJECT / "docs" / "scenario-reference.md"


def test_the_page_is_what_the_models_say() -> None:
    again = "python -m services.simulator.scenario_reference > docs/scenario-reference.md"
    assert PAGE.read_text(encoding="utf-8") == reference(), f"write it anew: {again}"


def test_every_key_has_a_meaning_and_every_link_a_goal() -> None:
    page = reference()
    assert not re.findall(r"^\| .*\|  \|$", page, re.MULTILINE)
    assert set(re.findall(r"\(#(\w+)\)", page)) <= set(re.findall(r'<a id="(\w+)">', page))
    assert "``" not in page


def test_every_key_of_the_shipped_scenarios_is_on_the_page() -> None:
    told = set(re.findall(r"^\| `(\w+)`", reference(), re.MULTILINE))

    def keys(value: object) -> set[str]:
        if isinstance(value, dict):
            return set(value) | {key for part in value.values() for key in keys(part)}
        return {key for part in value for key in keys(part)} if isinstance(value, list) else set()

    for path in (PROJECT / "deploy" / "sites").glob("*/scenario.yaml"):
        assert keys(yaml.safe_load(path.read_text(encoding="utf-8"))) <= told, path


def test_a_scenario_without_phones_is_refused() -> None:
    with pytest.raises(ValidationError, match="phones"):
        Scenario.model_validate(
            {
                "format": "atrium-scenario/1",
                "scenario": "empty",
                "seeds": {"train": 1, "test": 2},
                "people": {"kind": "walkers", "walkers": {}},
            }
        )
