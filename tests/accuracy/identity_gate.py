"""How well each tracker finds phones in short worlds and on the PETS clip: what may not get worse, and what it was.

``PYTHONPATH=. python tests/accuracy/identity_gate.py`` measures anew and writes ``identity_gate.json`` beside it;
do that after a change that is known to be for the better, and say in the commit what it did to the figures.
"""

import json
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path

from benchmarks.pets_phones import pets_whole
from benchmarks.phone_folds import score_run
from benchmarks.world_record import WorldRecord
from benchmarks.world_run import load, record_world
from services.fusion.registry import TRACKERS

FILE = Path(__file__).with_suffix(".json")

SHARE = 0.005
"""By how much a share may fall."""
METRES = 1.02
"""Times which an error in metres may rise."""
SECONDS = 90.0
PHONE_SEED = 7
"""None of the three by which the experiments judge."""

Figures = dict[str, float]


@cache
def world(scenario: str, seed: int, area: str) -> WorldRecord:
    described, site = load(scenario)
    return record_world(described, site, seed, seconds=SECONDS)[area]


RECORDS: dict[str, Callable[[], WorldRecord]] = {
    "construction-1": lambda: world("construction-1", 33, "west"),
    "museum": lambda: world("museum", 11, "hall"),
    "pets-phones": lambda: pets_whole(PHONE_SEED)[0].test,
}
GATED = [f"{tracker} on {record}" for tracker in ("evidence", "rbmcda") if tracker in TRACKERS for record in RECORDS]


@cache
def measure(gate: str) -> Figures:
    """Shares, and errors whose names end in ``_m``; what is not defined is left out."""
    tracker, _, record = gate.partition(" on ")
    scores, _ = score_run(RECORDS[record](), tracker=tracker)
    live, later = scores["live"].figures("live"), scores["5s"].figures("5s")
    figures = {
        "idf1_live": live["idf1_live"],
        "idf1_5s": later["idf1_5s"],
        "precision_5s": later["precision_5s"],
        "recall_5s": later["recall_5s"],
        "error_p50_live_m": live["error_p50_live"],
    }
    return {name: round(value, 4) for name, value in figures.items() if value is not None}


def worse(now: Figures, stored: Figures) -> list[str]:
    """What got worse than stored by more than it may, in words."""
    told = [f"{name}: stored or measured only once" for name in sorted(now.keys() ^ stored.keys())]
    for name in sorted(now.keys() & stored.keys()):
        if name.endswith("_m"):
            if now[name] > METRES * stored[name]:
                told.append(f"{name} rose from {stored[name]} to {now[name]}")
        elif now[name] < stored[name] - SHARE:
            told.append(f"{name} fell from {stored[name]} to {now[name]}")
    return told


def read() -> dict[str, Figures]:
    stored: dict[str, Figures] = json.loads(FILE.read_text(encoding="utf-8"))
    return stored


if __name__ == "__main__":
    before = read() if FILE.is_file() else {}
    after = {gate: measure(gate) for gate in GATED}
    FILE.write_text(json.dumps(after, indent=1) + "\n", encoding="utf-8")
    for gate, figures in after.items():
        sys.stdout.write(f"{gate}: {figures}\n")
        sys.stdout.writelines(f"  worse: {line}\n" for line in worse(figures, before.get(gate, figures)))
