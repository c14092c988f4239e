"""The five rival pocket headings and strap-down integration, where their answers are known."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.baselines.pocket_rivals import RIVALS, rival_headings
from benchmarks.baselines.strap_down import strap_down
from benchmarks.gait_walks import GARDEN, PARK, rested, swinging_thigh, twin_walk
from benchmarks.offset_signs import turn
from benchmarks.pocket_headings import shipped, sign_cues, tell


@pytest.mark.parametrize("name", RIVALS)
def test_a_rival_finds_the_heading_of_a_swinging_thigh_within_its_means(name: str) -> None:
    walk = swinging_thigh(np.random.default_rng(1), 60.0, yaw_sigma=0.0)
    true = walk.heading_at(walk.steps)
    parts = walk.acceleration, walk.rate, walk.attitude
    off = rival_headings(RIVALS[name], *parts, walk.steps[:-2], float(true[2])) - true[2:-2]
    assert np.median(np.degrees(np.abs(np.angle(np.exp(1j * off))))) < 10.0


def test_all_methods_are_scored_on_the_same_steps() -> None:
    walk = swinging_thigh(np.random.default_rng(2), 40.0)
    told = tell([walk], [walk.steps])[0]
    assert {len(heading) for heading in told.heading.values()} == {len(told.t)}
    assert told.t[0] == pytest.approx(walk.steps[2])  # from the first step that has a heading
    assert (tell([walk], [walk.steps], settles=20.0)[0].t > 20.0).all()
    assert told.deviation("pocket") == pytest.approx(2 * told.length * np.abs(np.sin(told.error("pocket") / 2)))


def test_the_chain_that_ships_tells_most_steps_of_a_walk_on_the_twin_and_their_headings() -> None:
    walk = rested(twin_walk(7, [(60.0, 90.0), (50.0, 0.0)]), np.random.default_rng(7), 10.0)
    told = tell(*shipped([walk]))[0]
    assert len(told.t) > 0.9 * len(walk.steps)
    assert np.median(np.degrees(np.abs(told.error("pocket")))) < 8.0


def test_a_single_swing_says_which_way_is_forward_on_the_twin() -> None:
    assert sign_cues(twin_walk(8, [(50.0, 0.0)])).mean() > 0.9


def test_the_routes_are_as_long_as_the_studys() -> None:
    assert sum(metres for metres, _ in PARK) == 870.0
    assert sum(metres for metres, _ in GARDEN) == 415.0


def test_a_phone_turned_in_software_points_elsewhere_but_sees_the_same_world() -> None:
    walk = twin_walk(4, [(10.0, 0.0)], "hand", yaw_sigma=0.0)
    turned = turn(walk, np.pi / 2.0)
    assert turned.attitude[:, :, 1][0] == pytest.approx(
        [-walk.attitude[0, 1, 1], walk.attitude[0, 0, 1], walk.attitude[0, 2, 1]]
    )
    seen, before = (np.einsum("nij,nj->ni", w.attitude, w.acceleration) for w in (turned, walk))
    assert seen == pytest.approx(before)


def test_strap_down_integration_is_exact_without_errors_and_drifts_with_a_bias() -> None:
    t = np.arange(0, 20, 0.02)
    attitude = np.broadcast_to(np.eye(3), (len(t), 3, 3))
    still = np.broadcast_to([0.0, 0.0, 9.81], (len(t), 3))
    speed, position = strap_down(still, attitude, 0.02, np.array([0.0, 1.3]))
    assert speed[-1] == pytest.approx([0.0, 1.3])
    assert position[-1] == pytest.approx([0.0, 26.0])
    _, off = strap_down(still + np.array([0.1, 0.0, 0.0]), attitude, 0.02, np.zeros(2))
    assert off[-1, 0] == pytest.approx(20.0, rel=0.01)
