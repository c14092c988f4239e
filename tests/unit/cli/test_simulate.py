"""``atrium simulate``: what was in the world is printed, a written world can be read, mistakes are one line."""

import gzip
import json
import subprocess
import sys
from collections import Counter
from pathlib import Path

import msgspec
import pytest

from shared.messages import DetectionFrame
from shared.truth import GroundTruth

SITES = Path(__file__).resolve().parents[3] / "deploy" / "sites"


def simulate(*arguments: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-m", "services.cli", "simulate", *arguments],
        capture_output=True,
        text=True,
        timeout=60,
        env={"COLUMNS": "250", "PYTHONPATH": str(SITES.parents[1]), "PATH": ""},
    )


@pytest.mark.parametrize("name", ["world.jsonl", "world.jsonl.gz"])
def test_a_world_is_counted_written_and_readable(tmp_path: Path, name: str) -> None:
    out = tmp_path / name
    answer = simulate("museum", "--seconds", "10", "--seed", "7", "--out", str(out))
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert "museum, seed 7" in answer.stdout
    with gzip.open(out, "rt") if out.suffix == ".gz" else out.open() as file:
        entries = [json.loads(line) for line in file]
    kinds = Counter(entry["kind"] for entry in entries)
    assert kinds["detections"] == 20
    assert kinds["truth"] == 100
    assert kinds["phone"] >= 30
    assert [entry["t"] for entry in entries] == sorted(entry["t"] for entry in entries)
    frames = [msgspec.convert(e["message"], DetectionFrame) for e in entries if e["kind"] == "detections"]
    truths = [msgspec.convert(e["message"], GroundTruth) for e in entries if e["kind"] == "truth"]
    phones = [entry["message"] for entry in entries if entry["kind"] == "phone"]
    counted = {
        "frames": len(frames),
        "detections": sum(len(frame.x) for frame in frames),
        "batches": len(phones),
        "inertial samples": sum(len(phone["imu"]["t"]) for phone in phones if "imu" in phone),
        "radio scans": sum(len(phone["radio"]) for phone in phones),
        "radio readings": sum(len(scan["rssi"]) for phone in phones for scan in phone["radio"]),
        "positions of people": sum(len(truth.person) for truth in truths),
    }
    for what, count in counted.items():
        assert any(what in line and f" {count:,} " in line for line in answer.stdout.splitlines()), (what, count)


def test_a_scenario_that_does_not_exist_names_those_that_do() -> None:
    answer = simulate("cathedral")
    assert answer.returncode == 2
    assert answer.stdout.count("\n") == 1
    assert "cathedral: no such scenario; shipped are construction-1, construction-2, crowd, hall" in answer.stdout


def test_a_wrong_scenario_is_one_line(tmp_path: Path) -> None:
    scenario = (SITES / "museum" / "scenario.yaml").read_text(encoding="utf-8")
    wrong = tmp_path / "scenario.yaml"
    wrong.write_text(
        scenario.replace("present: [8, 20]", "present: [20, 8]").replace(
            "scenario: museum\n", f"scenario: museum\nsite: {SITES / 'museum' / 'site.yaml'}\n"
        )
    )
    answer = simulate(str(wrong))
    assert answer.returncode == 2
    assert answer.stdout.count("\n") == 1
    assert "people.walkers.present: a range is [low, high], found [20, 8]\n" in answer.stdout
    assert "Traceback" not in answer.stderr


@pytest.mark.parametrize("out", ["nowhere/world.jsonl", "."])
def test_a_file_that_cannot_be_written_is_one_line(tmp_path: Path, out: str) -> None:
    answer = simulate("museum", "--seconds", "5", "--out", str(tmp_path / out))
    assert answer.returncode == 2
    assert "cannot be written: " in answer.stdout
    assert "seed" not in answer.stdout, "the world was begun"
    assert not (tmp_path / "nowhere").exists()
    assert "Traceback" not in answer.stdout + answer.stderr


def test_people_with_phones_who_are_not_named_are_counted() -> None:
    answer = simulate("crowd", "--seconds", "1")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert " and 88 more" in " ".join(answer.stdout.replace("│", " ").split())


@pytest.mark.parametrize(("name", "told"), [("hall", True), ("museum", False)])
def test_cameras_that_make_no_frames_off_line_are_told(name: str, told: bool) -> None:
    answer = simulate(name, "--seconds", "1")
    assert answer.returncode == 0, answer.stdout + answer.stderr
    assert ("rendered or real, nothing to see off line" in answer.stdout) is told
