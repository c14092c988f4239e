"""A radio model is judged on true places of another time, and the truth's own fit is the best to be had."""

from pathlib import Path

import numpy as np
from fusion_world import World, make_site, make_view

from benchmarks.radio_held_out import foretold_rmse, taught_by_truth, true_visits
from benchmarks.world_record import Truth, WorldRecord
from shared.messages import RadioScan
from shared.radio import RadioLearner


def test_what_the_truth_taught_foretells_another_time_better_than_the_site_file(tmp_path: Path) -> None:
    world = World(make_site(tmp_path), seed=3, people=4, seconds=120.0)
    scans: dict[str, list[RadioScan]] = {}
    for scan in world.scans():
        scans.setdefault(scan.device, []).append(scan)
    t = world.t0 + np.arange(0.0, 120.0, 0.2)
    position = np.stack([world.places(one) for one in t.tolist()])
    names = [str(number) for number in range(4)]
    truth = Truth(t, names, names, position, np.ones(position.shape[:2], bool))
    record = WorldRecord(world.site, "hall", [], [], scans, {}, truth, np.zeros((0, 2)))
    half = world.t0 + 60.0
    assert true_visits(record, until=half).t.max() <= half < true_visits(record, since=half).t.min()
    view = make_view(tmp_path)
    unlearned = RadioLearner.over(view.radio, view.lower, view.upper).solve()
    learned = foretold_rmse(taught_by_truth(record, half), record, half)
    assert learned < 0.85 * foretold_rmse(unlearned, record, half)
