"""The radio world: reproducible, and as hard as it says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError

from services.simulator.radio.radio_world import RadioParameters, RadioWorld
from shared.site import Site, load_site

Array = NDArray[np.float64]

QUIET: dict[str, Any] = {
    "power_sigma": 0.0,
    "exponent_sigma": 0.0,
    "shadowing_sigma": 0.0,
    "body_loss": 0.0,
    "facing_sigma": 0.0,
    "device_sigma": 0.0,
    "antenna_sigma": 0.0,
    "drift_sigma": 0.0,
    "rice_factor": 1000.0,
    "flicker_sigma": 0.0,
    "noise_sigma": 0.0,
    "always_missed": 0.0,
    "sensitivity": -120.0,
}
"""A world of path loss and walls alone, to which a test adds what it is about."""


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


def quiet(**more: Any) -> RadioParameters:
    return RadioParameters(**{**QUIET, **more})


def with_walls(site: Site, *walls: list[tuple[float, float]]) -> Site:
    return site.model_copy(update={"floors": [site.floors[0].model_copy(update={"walls": list(walls)})]})


def with_one_point(site: Site, position: tuple[float, float, float], **more: Any) -> Site:
    point = site.access_points[0].model_copy(update={"position": position, **more})
    return site.model_copy(update={"access_points": [point]})


def places(count: int, seed: int = 0) -> Array:
    return np.random.default_rng(seed).uniform([0, 0], [20, 12], (count, 2))


def walk(count: int, step: float = 0.1) -> Array:
    return np.column_stack(
        [10.0 + 5.0 * np.cos(step * np.arange(count) / 5.0), 6.0 + 5.0 * np.sin(step * np.arange(count) / 5.0)]
    )


def test_same_seed_gives_the_same_world_bit_for_bit(hall: Site) -> None:
    first, second = RadioWorld(hall, 7), RadioWorld(hall, 7)
    t = np.arange(50.0)
    assert first.expected(places(50), "ground", t, t).tobytes() == second.expected(places(50), "ground", t, t).tobytes()
    readings = [world.phone("a").scan(t, places(50), "ground", np.zeros(50)) for world in (first, second)]
    assert readings[0].tobytes() == readings[1].tobytes()


def test_another_seed_gives_another_world(hall: Site) -> None:
    assert not np.array_equal(
        RadioWorld(hall, 7).expected(places(5), "ground"), RadioWorld(hall, 8).expected(places(5), "ground")
    )


def test_one_more_phone_and_later_questions_change_nothing_for_the_others(hall: Site) -> None:
    alone, together = RadioWorld(hall, 7), RadioWorld(hall, 7)
    together.phone("b").scan(5000.0 + np.arange(20), places(20, 1), "ground")
    np.testing.assert_array_equal(
        alone.phone("a").scan(np.arange(20), places(20), "ground"),
        together.phone("a").scan(np.arange(20), places(20), "ground"),
    )


def test_a_run_cut_in_other_blocks_is_the_same_run(hall: Site) -> None:
    parameters = RadioParameters(changes=[{"at": 31, "kind": "power", "access_point": "ap-1", "by": -9}])
    world = RadioWorld(hall, 7, parameters)
    t, way, heading = np.arange(80.0), walk(80, 1.0), np.linspace(0.0, 9.0, 80)
    whole = world.phone("a").scan(t, way, "ground", heading)
    phone = world.phone("a")
    cut = [phone.scan(t[part], way[part], "ground", heading[part]) for part in (slice(0, 17), slice(17, 80))]
    np.testing.assert_array_equal(whole, np.concatenate(cut))


def test_true_constants_differ_from_the_site_files_guesses(hall: Site) -> None:
    chosen = RadioParameters(power_sigma=3.0, exponent_sigma=0.2, facing_sigma=0.0, shadowing_length=20.0)
    worlds = [RadioWorld(hall, seed, chosen) for seed in range(40)]
    power = np.array([world.power_1m for world in worlds]) - [point.power_1m for point in hall.access_points]
    exponent = np.array([world.exponent for world in worlds]) - [
        point.path_loss_exponent for point in hall.access_points
    ]
    assert power.std() == pytest.approx(3.0, rel=0.15)
    assert exponent.std() == pytest.approx(0.2, rel=0.15)


def test_readings_are_whole_and_spread_by_what_is_not_the_place(hall: Site) -> None:
    world = RadioWorld(
        hall, 3, RadioParameters(rice_factor=2.5, noise_sigma=1.3, always_missed=0.0, sensitivity=-120.0)
    )
    t = np.arange(3000.0)
    here = np.repeat([[6.0, 7.0]], 3000, axis=0)
    offsets, antennas, residuals = [], [], []
    for number in range(60):
        phone = world.phone(f"phone-{number}")
        offsets.append(phone.offset)
        antennas.append(phone.antenna)
        if number < 3:
            readings = phone.scan(t * 60.0, here, "ground")  # so seldom that each fades by itself
            assert np.array_equal(readings, np.round(readings), equal_nan=True)
            expected = world.expected(here, "ground", None, t * 60.0)
            residuals.append(readings - expected - phone.offset - phone.antenna)
    assert np.abs(np.nanmean(residuals, axis=(0, 1))).max() < 0.3
    # Rician with K = 2.5: 4.0 dB; flicker 0.6, noise 1.3, rounding 0.3.
    assert np.nanstd(residuals) == pytest.approx(4.3, abs=0.2)
    assert np.std(offsets) == pytest.approx(3.0, rel=0.25)
    assert np.std(antennas) == pytest.approx(1.0, rel=0.15)


def test_weak_access_points_are_missed_more_often(hall: Site) -> None:
    def missed(power: float) -> float:
        site = with_one_point(hall, (10.0, 6.0, 2.8), power_1m=power)
        parameters = quiet(always_missed=0.02, sensitivity=-88.0, sensitivity_slope=3.0)
        return float(
            np.isnan(RadioWorld(site, 1, parameters).phone("a").scan(np.arange(2000), walk(2000), "ground")).mean()
        )

    # Five metres away on a circle: 15.6 dB below the power at one metre.
    assert missed(-30.0) == pytest.approx(0.02, abs=0.01)
    assert missed(-88.0 + 15.7) == pytest.approx(0.51, abs=0.06)
    assert missed(-88.0 + 15.7 - 3.0) == pytest.approx(1.0 - 0.98 / (1.0 + np.e), abs=0.06)
    assert missed(-105.0) > 0.99


def test_a_storey_between_phone_and_access_point_costs_power(hall: Site) -> None:
    upstairs = hall.floors[0].model_copy(update={"id": "first", "level": 1})
    world = RadioWorld(hall.model_copy(update={"floors": [*hall.floors, upstairs]}), 1, quiet())
    assert (world.expected(places(50), "first") < world.expected(places(50), "ground") - 10.0).all()


def test_scans_of_one_call_may_lie_on_several_floors(hall: Site) -> None:
    upstairs = hall.floors[0].model_copy(update={"id": "first", "level": 1})
    world = RadioWorld(hall.model_copy(update={"floors": [*hall.floors, upstairs]}), 1, quiet())
    mixed = world.phone("a").scan([0.0, 1.0], places(2), ["first", "ground"])
    np.testing.assert_allclose(mixed[0], world.expected(places(2), "first")[0], atol=1.5)
    np.testing.assert_allclose(mixed[1], world.expected(places(2), "ground")[1], atol=1.5)


def test_each_wall_costs_its_loss_up_to_the_most(hall: Site) -> None:
    site = with_one_point(hall, (1.0, 6.0, 2.0))
    walls = [[(x, 0.0), (x, 12.0)] for x in (4.0, 5.0, 6.0)]
    points = np.array([[3.0, 6.0], [4.5, 6.0], [5.5, 6.0], [8.0, 6.0]])
    free = RadioWorld(with_walls(site), 1, quiet()).expected(points, "ground")
    walled = RadioWorld(with_walls(site, *walls), 1, quiet(wall_loss=4.0, most_wall_loss=10.0)).expected(
        points, "ground"
    )
    np.testing.assert_allclose((free - walled)[:, 0], [0.0, 4.0, 8.0, 10.0], atol=1e-4)


def test_the_body_shadows_what_is_behind_and_its_mean_is_the_mean(hall: Site) -> None:
    world = RadioWorld(with_one_point(hall, (15.0, 6.0, 2.0)), 1, quiet(body_loss=5.0))
    here = np.array([[5.0, 6.0]] * 8)
    power = world.expected(here, "ground", np.arange(8) * np.pi / 4.0)[:, 0]
    assert power[0] - power[4] == pytest.approx(5.0)
    assert power[0] > power[1] > power[2] > power[3] > power[4]
    assert power.mean() == pytest.approx(world.expected(here[:1], "ground")[0, 0])


def test_facing_another_way_changes_power_place_by_place_and_not_on_the_whole(hall: Site) -> None:
    world = RadioWorld(with_walls(hall), 1, quiet(facing_sigma=2.5, shadowing_length=1.0))
    here = places(4000)
    heading = np.random.default_rng(1).uniform(-9.0, 9.0, 4000)
    free = world.expected(here, "ground")
    one_way, other_way = (world.expected(here, "ground", heading + turn) - free for turn in (0.0, np.pi))
    assert one_way.std() == pytest.approx(2.5, rel=0.1)
    np.testing.assert_allclose(one_way, -other_way, atol=1e-6)


def test_drift_has_the_stated_spread_and_time_and_is_the_same_for_all_phones(hall: Site) -> None:
    here = np.array([[5.0, 6.0]] * 4000)
    t = np.arange(4000) * 20.0
    drift = np.concatenate(
        [
            RadioWorld(hall, seed, quiet(drift_sigma=2.0, drift_time=100.0)).expected(here, "ground", t=t)
            for seed in range(3)
        ],
        axis=1,
    )
    drift = drift - drift.mean(axis=0)
    assert drift.std() == pytest.approx(2.0, rel=0.1)
    for lag in (1, 5, 15):
        kept = (drift[lag:] * drift[:-lag]).mean() / drift.var()
        assert kept == pytest.approx(np.exp(-lag * 20.0 / 100.0), abs=0.06)


def test_a_wall_is_built_at_its_time_and_costs_those_behind_it_only(hall: Site) -> None:
    site = with_one_point(with_walls(hall), (1.0, 6.0, 2.0))
    wall = {"at": 100.0, "kind": "wall", "line": [(5.0, 0.0), (5.0, 12.0)], "floor": "ground", "loss": 7.0}
    world = RadioWorld(site, 1, quiet(changes=[wall]))
    behind, before = (world.expected([[x, 6.0]] * 3, "ground", t=[0.0, 99.9, 100.0])[:, 0] for x in (8.0, 3.0))
    np.testing.assert_allclose(behind - behind[0], [0.0, 0.0, -7.0], atol=1e-5)
    np.testing.assert_allclose(before - before[0], 0.0, atol=1e-9)


def test_an_access_point_moves_and_changes_power_at_its_time(hall: Site) -> None:
    site = with_one_point(with_walls(hall), (1.0, 6.0, 2.0))
    point = site.access_points[0].id
    changes = [
        {"at": 50.0, "kind": "moved", "access_point": point, "position": (19.0, 6.0, 2.0)},
        {"at": 80.0, "kind": "power", "access_point": point, "by": -6.0},
    ]
    world = RadioWorld(site, 1, quiet(changes=changes, shadowing_sigma=3.0))
    near_old = world.expected([[2.0, 6.0]] * 3, "ground", t=[49.0, 50.0, 80.0])[:, 0]
    near_new = world.expected([[18.0, 6.0]] * 3, "ground", t=[49.0, 50.0, 80.0])[:, 0]
    assert near_old[1] < near_old[0] - 8.0
    assert near_new[1] > near_new[0] + 8.0
    assert near_old[2] - near_old[1] == pytest.approx(-6.0)


def test_a_change_of_an_access_point_that_is_not_there_is_refused_by_name(hall: Site) -> None:
    with pytest.raises(ValueError, match=r"changes\[0\].access_point: 'nowhere' is not in the site file; it has: ap-1"):
        RadioWorld(hall, 1, RadioParameters(changes=[{"at": 1, "kind": "power", "access_point": "nowhere", "by": 3}]))


@pytest.mark.parametrize(
    ("mistake", "field"),
    [
        ({"noise_sigma": -1}, "noise_sigma"),
        ({"shadowing_length": 0}, "shadowing_length"),
        ({"noise": 1}, "noise"),
        ({"wall_loss": float("nan")}, "wall_loss"),
        ({"changes": [{"at": 1, "kind": "rain"}]}, "changes"),
        ({"changes": [{"at": 1, "kind": "wall", "floor": "ground", "line": [[1, 1], [1, 1]]}]}, "changes"),
    ],
)
def test_parameters_out_of_bounds_are_refused_by_field(mistake: dict[str, Any], field: str) -> None:
    with pytest.raises(ValidationError) as caught:
        RadioParameters(**mistake)
    assert caught.value.errors()[0]["loc"][0] == field


def test_scans_of_unequal_length_or_on_no_floor_are_refused(hall: Site) -> None:
    phone = RadioWorld(hall, 1).phone("a")
    with pytest.raises(ValueError, match="2, 3, 2, 2"):
        phone.scan([0.0, 1.0], places(3), "ground")
    with pytest.raises(KeyError, match="'cellar' is no floor; allowed: ground"):
        phone.scan([0.0], places(1), "cellar")


def test_a_block_without_scans_gives_no_readings(hall: Site) -> None:
    phone = RadioWorld(hall, 1).phone("a")
    assert phone.scan(np.zeros(0), np.zeros((0, 2)), []).shape == (0, len(hall.access_points))
