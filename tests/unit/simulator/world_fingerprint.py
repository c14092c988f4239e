"""What is in the first seconds of a shipped world, in a few numbers.

``python tests/unit/simulator/world_fingerprint.py`` (from the project's folder) measures the shipped worlds anew and
writes ``world_fingerprints.json``: only when worlds were meant to change.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_suffix("").with_name("world_fingerprints.json")
PROJECT = Path(__file__).resolve().parents[3]
WORLDS = ("museum", "construction-1")
SECONDS = 20.0
COUNTS = 0.02
"""By which share counts may differ before a world counts as another."""
MEANS = {"m": 0.03, "confidence": 0.01, "m/s²": 0.03, "rad/s": 0.01, "µT": 0.3, "dBm": 0.15}
"""By how much means and spreads may."""


def fingerprint(name: str) -> dict[str, float]:
    """Return counts, and means and spreads (their unit is the last word of the name), of the train seed's world."""
    from services.simulator.scenario_loading import load_scenario
    from services.simulator.world import World

    scenario, site = load_scenario(PROJECT / "deploy" / "sites" / name / "scenario.yaml")
    world = World(scenario, site, scenario.seeds.train)
    frames, batches, places = [], [], []
    while world.made < SECONDS:
        block = world.next_block()
        frames += [frame for _, frame in block.frames]
        batches += block.batches
        places.append(block.truth.position[block.truth.present])
    inertial = np.concatenate([batch.inertial.values for batch in batches if batch.inertial is not None])
    heard = np.array([rssi for batch in batches for scan in batch.scans for rssi in scan.rssi])
    columns: dict[str, np.ndarray] = {
        "true x, m": np.concatenate(places)[:, 0],
        "true y, m": np.concatenate(places)[:, 1],
        "detected x, m": np.concatenate([frame.x for frame in frames]),
        "detected y, m": np.concatenate([frame.y for frame in frames]),
        "detected confidence": np.concatenate([frame.confidence for frame in frames]),
        "acceleration m/s²": np.linalg.norm(inertial[:, 0:3], axis=1),
        "rotation rad/s": np.linalg.norm(inertial[:, 3:6], axis=1),
        "field µT": np.linalg.norm(inertial[:, 6:9], axis=1),
        "received dBm": heard,
    }
    found: dict[str, float] = {
        "frames": len(frames),
        "detections": len(columns["detected x, m"]),
        "batches": len(batches),
        "inertial samples": len(inertial),
        "scans": sum(len(batch.scans) for batch in batches),
        "readings": len(heard),
        "true places": len(columns["true x, m"]),
        "steps": sum(len(batch.step_t) for batch in batches),
    }
    for column, values in columns.items():
        found[f"mean of {column}"] = round(float(values.mean()), 4)
        found[f"spread of {column}"] = round(float(values.std()), 4)
    return found


def differences(now: dict[str, float], then: dict[str, float]) -> list[str]:
    """Return, in words, what differs by more than it may."""
    told = [f"{name}: measured or stored only once" for name in sorted(now.keys() ^ then.keys())]
    for name in sorted(now.keys() & then.keys()):
        allowed = MEANS.get(name.split()[-1], COUNTS * max(then[name], 50.0))
        if abs(now[name] - then[name]) > allowed:
            told.append(f"{name}: {now[name]:g}, stored {then[name]:g}, allowed is {allowed:g} beside")
    return told


if __name__ == "__main__":
    sys.path.insert(0, str(PROJECT))
    stored = {name: fingerprint(name) for name in WORLDS}
    FILE.write_text(json.dumps(stored, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    sys.stdout.write(f"{FILE.name}: {', '.join(stored)}\n")
