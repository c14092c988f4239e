"""The frame of all experiments: what may be stored, what is refused, what is printed, what runs in parallel."""

import io
import json
import re
from pathlib import Path

import pytest
from rich.console import Console
from rich.progress import Progress

from benchmarks import __main__ as bench
from benchmarks import result, results_page
from benchmarks.experiment import Experiment, ExperimentError, Figures, Options, Study, experiments, in_parallel
from benchmarks.result import PICTURES, RESULTS


def run(options: Options, progress: Progress) -> Figures:
    if options.seed == 13:
        raise ExperimentError("seed 13: no luck")
    return {"p90": 1.5, "share": 0.25, "missing": None, "seed": options.seed}


TRIAL = Experiment(
    name="trial",
    question="How far off?",
    kind="twin",
    scenario="hall",
    scenarios=("attic",),
    run=run,
    seed=1,
    made="By hand.",
    studies={"p90": Study(1.4, "[ravel-thesis §11.3]")},
    difference="Theirs was a building site.",
    at_most={"p90": 2.0},
    at_least={"share": 0.2},
)


@pytest.fixture
def stored(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What would be benchmarks/results."""
    monkeypatch.setattr(result, "RESULTS", tmp_path / "results")
    return tmp_path / "results"


def ran(experiment: Experiment, *arguments: str) -> tuple[int, str]:
    printed = io.StringIO()
    status = experiment.main(list(arguments), Console(file=printed, width=200))
    return status, printed.getvalue()


def test_the_default_world_is_stored_with_what_it_was(stored: Path) -> None:
    status, printed = ran(TRIAL)
    assert status == 0
    document = json.loads((stored / "trial.json").read_text())
    assert document["figures"] == {"p90": 1.5, "share": 0.25, "missing": None, "seed": 1}
    assert {"experiment", "scenario", "seed", "commit", "machine", "figures"} == set(document)
    assert re.search(r"p90 .* 1\.5 .* ≤ 2 .* 1\.4 \[ravel-thesis §11\.3\]", printed)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--seed", "2"], "add --out FOLDER for scenario hall, seed 2"),
        (["--scenario", "attic"], "add --out FOLDER for scenario attic, seed 1"),
        (["--scenario", "attic", "--out", str(RESULTS)], "add --out FOLDER"),
        (["--seed", "2", "--out", str(PICTURES)], "add --out FOLDER"),
        (["--scenario", "cellar"], "--scenario cellar: not a scenario of trial; allowed: hall, attic"),
        (["--seed", "-1"], "--seed -1: allowed: 0 and above"),
        (["--jobs", "0"], "--jobs 0: allowed: 1 and above"),
    ],
)
def test_what_would_falsify_the_stored_results_is_refused_in_one_line(
    stored: Path, arguments: list[str], said: str
) -> None:
    status, printed = ran(TRIAL, *arguments)
    assert status == 2
    assert said in printed.replace("\n", " ")
    assert not stored.exists()


def test_another_world_goes_where_it_is_told(stored: Path, tmp_path: Path) -> None:
    status, _ = ran(TRIAL, "--scenario", "attic", "--seed", "2", "--out", str(tmp_path / "out" / "deep"))
    assert status == 0
    assert json.loads((tmp_path / "out" / "deep" / "trial.json").read_text())["scenario"] == "attic"
    assert not stored.exists()


def test_a_missed_bar_is_said_and_is_the_exit_status_but_only_for_the_default_world(
    stored: Path, tmp_path: Path
) -> None:
    def worse(options: Options, progress: Progress) -> Figures:
        return {"p90": 2.1, "share": None}

    strict = Experiment(
        name="trial", question="?", kind="twin", scenario="hall", run=worse, at_most={"p90": 2.0}, at_least={"share": 0}
    )
    status, printed = ran(strict)
    assert status == 1
    assert "bar missed: share, p90" in printed
    assert ran(strict, "--seed", "5", "--out", str(tmp_path))[0] == 0


def test_an_experiment_that_cannot_be_run_says_why_and_stores_nothing(stored: Path, tmp_path: Path) -> None:
    status, printed = ran(TRIAL, "--seed", "13", "--out", str(tmp_path))
    assert (status, printed.strip()) == (1, "seed 13: no luck")
    assert not list(tmp_path.glob("*.json"))


def test_a_study_without_the_difference_in_set_up_is_no_declaration() -> None:
    with pytest.raises(ValueError, match="difference in set-up"):
        Experiment(name="x", question="?", kind="twin", scenario="s", run=run, studies={"p90": Study(1, "[x §1]")})


def test_infinite_and_undefined_figures_are_stored_as_undefined(stored: Path) -> None:
    path = result.write_result("x", "s", 0, {"a": float("inf"), "b": float("nan"), "c": 3, "d": 1 / 3})
    assert json.loads(path.read_text())["figures"] == {"a": None, "b": None, "c": 3, "d": 0.3333}


def cell(scenario: str, seed: int) -> str:
    if seed < 0:
        raise ExperimentError(f"{scenario}: no seed {seed}")
    return f"{scenario}-{seed}"


@pytest.mark.parametrize("jobs", [1, 2])
def test_cells_come_back_in_their_order_from_any_number_of_processes(jobs: int) -> None:
    with Progress(disable=True) as progress:
        found = in_parallel(cell, [("b", 2), ("a", 1), ("c", 3)], jobs, progress)
        assert found == ["b-2", "a-1", "c-3"]
        assert progress.finished
        with pytest.raises(ExperimentError, match="no seed -1"):
            in_parallel(cell, [("b", 2), ("a", -1)], jobs, progress)


def test_the_page_shows_question_command_bar_study_and_difference() -> None:
    text = results_page.section(
        TRIAL,
        {"scenario": "hall", "seed": 1, "commit": "abc", "machine": "m", "figures": {"p90": 1.5, "share": None}},
    )
    assert "**How far off?**" in text
    assert "`atrium bench trial` · hall, seed 1 · commit abc · m" in text
    assert "By hand." in text
    assert "Theirs was a building site." in text
    assert "| `p90` | 1.5 | ≤ 2 | 1.4 [ravel-thesis §11.3] |" in text
    assert "| `share` | – | ≥ 0.2 |  |" in text


def test_every_stored_result_belongs_to_a_declared_experiment_that_draws_what_it_says() -> None:
    declared = experiments()
    for path in RESULTS.glob("*.json"):
        document = json.loads(path.read_text(encoding="utf-8"))
        assert path.stem in declared, f"{path.name}: no experiment declares it"
        experiment = declared[path.stem]
        assert experiment.name == document["experiment"] == path.stem
        assert (experiment.scenario, experiment.seed) == (document["scenario"], document["seed"])
        assert set(experiment.studies) | set(experiment.at_least) | set(experiment.at_most) <= set(document["figures"])
        if experiment.picture:
            assert (PICTURES / f"{experiment.name}.png").exists()


def test_the_command_lists_every_experiment_with_its_question(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "400")  # no line is broken
    assert bench.main([]) == 0
    listed = capsys.readouterr().out
    for name, experiment in experiments().items():
        assert name in listed
        assert experiment.question in listed
    assert bench.main(["no-such-thing"]) == 2
    assert "no-such-thing: no such experiment; there are: " in capsys.readouterr().out
