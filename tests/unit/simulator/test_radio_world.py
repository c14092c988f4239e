"""The radio world: reproducible, and as hard as it says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from services.simulator.radio_world import RadioParameters, RadioWorld, ShadowingField
from shared.site import Site, load_site


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


def places(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([0, 0], [20, 12], (count, 2))


def test_same_seed_gives_the_same_world_bit_for_bit(hall: Site) -> None:
    first, second = RadioWorld(hall, 7), RadioWorld(hall, 7)
    assert first.expected(places(50), "ground").tobytes() == second.expected(places(50), "ground").tobytes()
    assert (
        first.phone("a").scan(places(50), "ground").tobytes() == second.phone("a").scan(places(50), "ground").tobytes()
    )


def test_another_seed_gives_another_world(hall: Site) -> None:
    assert not np.array_equal(
        RadioWorld(hall, 7).expected(places(5), "ground"), RadioWorld(hall, 8).expected(places(5), "ground")
    )


def test_one_more_phone_changes_nothing_for_the_others(hall: Site) -> None:
    alone, together = RadioWorld(hall, 7), RadioWorld(hall, 7)
    together.phone("b").scan(places(20), "ground")
    np.testing.assert_array_equal(
        alone.phone("a").scan(places(20), "ground"), together.phone("a").scan(places(20), "ground")
    )


def test_shadowing_has_the_stated_spread_and_correlation_length() -> None:
    rng = np.random.default_rng(1)
    start = rng.uniform(-200, 200, (4000, 2))
    angle = rng.uniform(0, 2 * np.pi, 4000)
    fields = [ShadowingField(np.random.default_rng(index), 4.0, 3.0) for index in range(20)]
    here = np.concatenate([field.at(start) for field in fields])
    assert here.std() == pytest.approx(4.0, abs=0.25)
    for distance in (1.0, 3.0, 6.0):
        shifted = start + distance * np.column_stack([np.cos(angle), np.sin(angle)])
        there = np.concatenate([field.at(shifted) for field in fields])
        assert np.corrcoef(here, there)[0, 1] == pytest.approx(np.exp(-distance / 3.0), abs=0.06)


def test_true_constants_differ_from_the_site_files_guesses(hall: Site) -> None:
    worlds = [RadioWorld(hall, seed) for seed in range(60)]
    power = np.array([world.power_1m for world in worlds]) + 40.0
    exponent = np.array([world.exponent for world in worlds]) - 2.2
    assert power.std() == pytest.approx(3.0, rel=0.15)
    assert exponent.std() == pytest.approx(0.2, rel=0.15)


def test_readings_are_whole_and_spread_by_offset_and_noise(hall: Site) -> None:
    world = RadioWorld(hall, 3, replace(RadioParameters(), always_missed=0.0))
    here = np.repeat([[6.0, 7.0]], 3000, axis=0)
    phone = world.phone("a")
    readings = phone.scan(here, "ground")
    assert np.array_equal(readings, np.round(readings), equal_nan=True)
    residual = readings - world.expected(here[:1], "ground") - phone.offset
    assert np.abs(np.nanmean(residual, axis=0)).max() < 0.2
    assert np.nanstd(residual) == pytest.approx(2.2, abs=0.1)
    offsets = [world.phone(f"phone-{index}").offset for index in range(300)]
    assert np.std(offsets) == pytest.approx(3.0, rel=0.12)


def test_weak_access_points_are_missed_more_often(hall: Site) -> None:
    def missed(power: float) -> float:
        parameters = RadioParameters(shadowing_sigma=0.0, power_sigma=0.0, exponent_sigma=0.0, device_sigma=0.0)
        site = hall.model_copy(
            update={"access_points": [point.model_copy(update={"power_1m": power}) for point in hall.access_points]}
        )
        return float(np.isnan(RadioWorld(site, 1, parameters).phone("a").scan(places(2000), "ground")).mean())

    strong, weak, hopeless = missed(-40.0), missed(-62.0), missed(-90.0)
    assert strong < 0.04 < weak < 0.9 < hopeless


def test_a_storey_between_phone_and_access_point_costs_power(hall: Site) -> None:
    upstairs = hall.floors[0].model_copy(update={"id": "first", "level": 1})
    world = RadioWorld(hall.model_copy(update={"floors": [*hall.floors, upstairs]}), 1)
    assert (world.expected(places(50), "first") < world.expected(places(50), "ground")).all()
