"""Both runs on the PETS clip play the scenario they tell of, whatever the shell says, and know its seed."""

import os
from argparse import Namespace
from dataclasses import replace
from pathlib import Path

import pytest
from rich.progress import Progress

from benchmarks import pets_video, pets_video_harsh
from benchmarks.experiment import Experiment, ExperimentError, Options
from services.cli.launcher import LauncherError


@pytest.mark.parametrize(
    ("experiment", "file"),
    [(pets_video.EXPERIMENT, "scenario.yaml"), (pets_video_harsh.EXPERIMENT, "scenario-harsh.yaml")],
)
def test_the_services_are_told_the_scenario(
    experiment: Experiment, file: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATRIUM_SCENARIO", "of another run")
    monkeypatch.setattr("benchmarks.pets_video.PetsTruth.load", lambda: None)
    told: list[str] = []

    def run_clip(folder: Path, quiet: bool) -> None:
        told.append(os.environ["ATRIUM_SCENARIO"])
        raise LauncherError("nothing starts in this test")

    monkeypatch.setattr(pets_video, "run_clip", run_clip)
    options = Options("pets09-s2l1", experiment.seed, more=Namespace(keep=tmp_path, verbose=False))
    with Progress(disable=True) as progress, pytest.raises(ExperimentError, match="nothing starts"):
        experiment.run(options, progress)
    assert [Path(path).name for path in told] == [file]
    assert Path(told[0]).is_file()
    with (
        Progress(disable=True) as progress,
        pytest.raises(ExperimentError, match=f"{file} have seed {experiment.seed}"),
    ):
        experiment.run(replace(options, seed=experiment.seed + 1), progress)
