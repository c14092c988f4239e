"""What the pages tell people to copy works as it stands."""

from __future__ import annotations

import re
from pathlib import Path

from services.simulator.scenario_loading import load_scenario
from services.simulator.world import World

DOCS = Path(__file__).resolve().parents[3] / "docs"


def yaml_block(page: str, begins: str) -> str:
    blocks = re.findall(r"```yaml\n(.*?)```", (DOCS / page).read_text(encoding="utf-8"), flags=re.DOTALL)
    [found] = [block for block in blocks if block.startswith(begins)]
    return found


def test_the_examples_of_site_and_scenario_make_a_world_together(tmp_path: Path) -> None:
    (tmp_path / "site.yaml").write_text(yaml_block("site.md", "format: atrium-site/1"))
    (tmp_path / "scenario.yaml").write_text(yaml_block("scenarios.md", "format: atrium-scenario/1"))
    world = World(*load_scenario(tmp_path / "scenario.yaml"))
    block = world.next_block()
    assert block.truth.present.sum(axis=1).min() >= 5
    assert sum(len(frame.x) for _, frame in block.frames) > 0
    heard = {scan.kind for _ in range(4) for batch in world.next_block().batches for scan in batch.scans}
    assert heard == {"wifi", "ble"}
