"""Holding, pocketing, gripping anew and fidgeting: turns without a jolt, as often as it says."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from services.simulator.phones.carrying import Carried, Carrying, CarryingParameters, Habit

RATE = 50


def carried(
    carrying: Carrying, seconds: float, speed: float = 1.2, seed: int = 1, **parameters: object
) -> tuple[np.ndarray, Carried]:
    habit = Habit(np.random.default_rng(seed), carrying, CarryingParameters.model_validate(parameters))
    t = np.arange(int(seconds * RATE)) / RATE
    parts = [habit.follow(part, np.full(len(part), speed)) for part in np.array_split(t, max(1, int(seconds / 5)))]
    columns = ("mount", "hand", "push", "fidget", "rhythm", "offset")
    return t, Carried(*(np.concatenate([getattr(part, name) for part in parts]) for name in columns))


@pytest.mark.parametrize("carrying", ["hand", "pocket", "mixed"])
def test_mounts_are_rotations_and_turn_without_a_jolt(carrying: Carrying) -> None:
    _, found = carried(carrying, 600, regrip_every=20.0, in_hand=20.0, in_pocket=20.0)
    product = found.mount @ found.mount.transpose(0, 2, 1)
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(3), product.shape), atol=1e-9)
    relative = found.mount[:-1].transpose(0, 2, 1) @ found.mount[1:]
    angle = np.arccos(np.clip((np.trace(relative, axis1=1, axis2=2) - 1.0) / 2.0, -1.0, 1.0))
    assert angle.max() * RATE < 8.0  # rad/s; half a turn in nine tenths of a second, at its quickest
    assert angle.max() > 0.01


def test_in_the_hand_the_top_points_along_the_walk_but_for_the_offset() -> None:
    for seed in range(20):
        _, found = carried("hand", 100, seed=seed, regrip_every=10.0)
        ahead, left, _ = found.mount[:, :, 1].T  # where the phone's y axis points: forward, left, up
        np.testing.assert_allclose(np.arctan2(left, ahead)[found.push[:, 0] == 0], found.offset[found.push[:, 0] == 0])


def test_grips_differ_as_much_as_asked_partly_by_person_partly_by_grip() -> None:
    people = [
        np.unique(np.round(carried("hand", 900, seed=s, offset=15.0, regrip_every=60.0)[1].offset, 9))
        for s in range(80)
    ]
    grips = np.array([carried("hand", 0.1, seed=s, offset=15.0)[1].offset[0] for s in range(600)])
    assert math.degrees(grips.std()) == pytest.approx(15.0, rel=0.1)
    assert all(len(person) > 3 for person in people)


def test_mixed_phones_are_in_hand_and_pocket_for_as_long_as_asked() -> None:
    shares = [carried("mixed", 3000, seed=s, in_hand=30.0, in_pocket=60.0)[1].hand.mean() for s in range(8)]
    assert np.mean(shares) == pytest.approx(1 / 3, abs=0.07)
    _, found = carried("mixed", 1000, in_hand=30.0, in_pocket=60.0)
    swaps = np.flatnonzero(np.diff(found.hand > 0.5))
    assert 10 < len(swaps) < 50
    on_the_way = (found.hand > 0.0) & (found.hand < 1.0)
    assert np.linalg.norm(found.push[on_the_way], axis=1).max() > 1.0
    assert (found.push[~on_the_way] == 0).all() or np.abs(found.push[~on_the_way]).max() < 4.0


@pytest.mark.parametrize(("carrying", "there"), [("hand", 1.0), ("pocket", 0.0)])
def test_phones_that_stay_stay(carrying: Carrying, there: float) -> None:
    _, found = carried(carrying, 2000, regrip_every=30.0)
    assert (found.hand == there).all()


def test_only_who_stands_fidgets_and_about_as_often_as_asked() -> None:
    _, walking = carried("hand", 1000, speed=1.0, fidget_every=10.0)
    assert not walking.fidget.any()
    shares = [
        carried("hand", 1000, 0.0, s, fidget_every=20.0, fidget_for=(4.0, 6.0))[1].fidget.mean() for s in range(8)
    ]
    assert np.mean(shares) == pytest.approx(4.6 / 25.0, rel=0.25)
    _, never = carried("hand", 1000, 0.0, fidget_every=0.0)
    assert not never.fidget.any()


def test_blocks_are_no_matter_to_when_things_happen() -> None:
    t = np.arange(300 * RATE) / RATE
    found = []
    for cuts in (1, 60, 171):
        habit = Habit(np.random.default_rng(4), "mixed", CarryingParameters(in_hand=20, in_pocket=20, fidget_every=10))
        parts = [habit.follow(part, np.zeros(len(part))) for part in np.array_split(t, cuts)]
        found.append(
            np.column_stack([np.concatenate([p.hand for p in parts]), np.concatenate([p.fidget for p in parts])])
        )
    assert found[0].min(axis=0).tolist() == [0.0, 0.0]
    assert found[0].max(axis=0).tolist() == [1.0, 1.0]
    np.testing.assert_allclose(found[1], found[0], atol=1e-12)
    np.testing.assert_allclose(found[2], found[0], atol=1e-12)


def test_a_fidget_that_is_left_out_for_walking_does_not_double_the_one_that_lasts() -> None:
    """Somebody fidgets, sets off, and the next planned fidget falls into the walk, in the same block or in another."""
    t = np.arange(600 * RATE) / RATE
    speed = np.where(t % 7.0 < 3.5, 0.0, 1.2)
    found = []
    for cuts in (1, 120, 341):
        habits = CarryingParameters(fidget_every=1.0, rhythmic=1.0, regrip_every=0)
        habit = Habit(np.random.default_rng(4), "hand", habits)
        pieces = zip(np.array_split(t, cuts), np.array_split(speed, cuts), strict=True)
        parts = [habit.follow(part, fast) for part, fast in pieces]
        found.append(np.concatenate([part.rhythm for part in parts]))
    assert (np.abs(found[0]).max(axis=1) > 0.1).mean() > 0.3
    np.testing.assert_allclose(found[1], found[0], atol=1e-9)
    np.testing.assert_allclose(found[2], found[0], atol=1e-9)


@pytest.mark.parametrize("wrong", [{"fidget_for": (5.0, 2.0)}, {"offset": -1.0}, {"in_hand": 0.0}])
def test_impossible_habits_are_refused_by_name(wrong: dict[str, object]) -> None:
    with pytest.raises(ValidationError, match=next(iter(wrong))):
        CarryingParameters.model_validate(wrong)
