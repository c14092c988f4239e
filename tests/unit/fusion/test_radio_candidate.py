"""A radio candidate changes what it names and nothing else, or one message says why not."""

import dataclasses
import json
from typing import Any

import numpy as np
import pytest
from fusion_world import make_view

from services.fusion.area_view import AreaView
from services.fusion.rescore.candidate import CandidateError, apply, read_candidate
from shared.radio import ShadowingMap


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> AreaView:
    return make_view(tmp_path_factory.mktemp("site"))


def shadowing(**changes: Any) -> dict[str, Any]:
    grid = [[1.0, 2.0], [3.0, 4.0]]
    whole = {"names": ["ap-3", "ap-1"], "origin": [0, 0], "cell": 1.0, "mean": [grid, grid], "variance": [grid, grid]}
    return {**whole, **changes}


def changed_by(model: dict[str, Any], view: AreaView) -> AreaView:
    candidate = apply(read_candidate(json.dumps({"kind": "radio", **model}).encode()), view).candidate
    assert candidate is not None
    return candidate.view


def test_what_is_named_is_corrected_and_all_else_stays(view: AreaView) -> None:
    model = {"access_points": {"ap-2": {"power_1m": -47.5}}, "shadowing": shadowing()}
    changed = changed_by(model, view)
    assert changed.radio.power_1m.tolist() == [-40, -47.5, -40, -40, -40, -40]
    assert changed.radio.exponent.tolist() == view.radio.exponent.tolist()
    assert changed.shadowing is not None
    assert changed.shadowing.names == view.radio.names
    mean, variance = changed.shadowing.at(np.array([[1.0, 0.0]]))
    assert mean.tolist() == [[2, 0, 2, 0, 0, 0]]
    assert variance[0, 1] > variance[0, 0] == 2.0  # of an access point the map does not name nothing was learned
    assert view.shadowing is None


def test_what_a_map_does_not_name_keeps_the_active_one(view: AreaView) -> None:
    names = view.radio.names
    active = ShadowingMap(names, np.zeros(2), 2.0, np.full((len(names), 3, 3), 7.0), np.full((len(names), 3, 3), 1.0))
    known = dataclasses.replace(view, shadowing=active)
    changed = changed_by({"shadowing": shadowing(names=["ap-1"], mean=[[[3.0]]], variance=[[[2.0]]])}, known).shadowing
    assert changed is not None
    mean, variance = changed.at(np.array([[1.5, 2.0]]))
    assert mean.tolist() == [[3, 7, 7, 7, 7, 7]]
    assert variance.tolist() == [[2, 1, 1, 1, 1, 1]]
    with pytest.raises(CandidateError, match="a map that goes with the constants of ap-2"):
        changed_by({"access_points": {"ap-2": {"power_1m": -47.5}}}, known)


@pytest.mark.parametrize(
    ("model", "words"),
    [
        ({"access_points": {"ap-99": {}}}, "access_points.ap-99: no access point of floor ground; allowed: ap-1, ap-2"),
        ({"access_points": {"upstairs": {}}}, "access_points.upstairs: no access point of floor ground"),
        ({"access_points": {"ap-1": {"power_1m": 40}}}, "access_points.ap-1.power_1m: found 40; allowed: -110 … 0"),
        ({"access_points": {"ap-1": {"path_loss_exponent": 0}}}, "path_loss_exponent: found 0; allowed: 1 … 6"),
        ({"access_points": {"ap-1": {"power": -40}}}, "power"),
        ({"shadowing": shadowing(cell=0)}, "shadowing.cell: found 0; allowed: 0.1 … 10"),
        ({"shadowing": shadowing(names=["ap-1", "ap-1"])}, "shadowing.names"),
        ({"shadowing": shadowing(names=["ap-1", "nobody"])}, "'nobody' is no access point"),
        ({"shadowing": shadowing(mean=[[[1.0, 2.0], [3.0]]] * 2)}, "rows of different lengths"),
        ({"shadowing": shadowing(mean=[[[1.0]]])}, "shadowing.mean: found shape"),
        ({"shadowing": shadowing(variance=[[[1.0]]] * 2)}, "shadowing.variance: found"),
        ({"shadowing": shadowing(variance=[[[-1.0] * 2] * 2] * 2)}, "allowed: 0 or more"),
        ({"shadowing": shadowing(mean=[[[1e9] * 2] * 2] * 2)}, "shadowing.mean: found 1e+09 dB"),
    ],
)
def test_a_wrong_model_is_one_clear_message(view: AreaView, model: dict[str, Any], words: str) -> None:
    with pytest.raises(CandidateError) as caught:
        changed_by(model, view)
    assert words in str(caught.value)
