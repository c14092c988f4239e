"""What an emulated phone measures fits together, second after second, on its own wrong clock."""

import itertools
from pathlib import Path

import numpy as np
import pytest

from services.simulator.phone import EmulatedPhone, PhoneClock
from services.simulator.radio_world import RadioWorld
from services.simulator.trajectories import LINGER, Trajectories
from shared.site import Site, load_site

EPOCH = 1_700_000_000.0


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def people() -> Trajectories:
    t = np.arange(0.0, 60.0, 0.5)
    return Trajectories(np.column_stack([t, np.ones(len(t)), 2 + 0.25 * t, np.full(len(t), 2.0)]))


def phone(hall: Site, **changes: object) -> EmulatedPhone:
    return EmulatedPhone(hall, RadioWorld(hall, 1), "1", "ground", seed=1, started=EPOCH, **changes)  # type: ignore[arg-type]


def test_batches_join_into_one_even_stream_on_the_phones_clock(hall: Site, people: Trajectories) -> None:
    measuring = phone(hall)
    cuts = [0.0, 1.0, 2.02, 2.98, 4.0, 5.0]
    batches = [measuring.measure(people, a, b, EPOCH) for a, b in itertools.pairwise(cuts)]
    stamps = np.concatenate([batch["imu"]["t"] for batch in batches if batch])
    np.testing.assert_allclose(np.diff(stamps), 0.02, atol=2e-4)
    assert stamps[0] - EPOCH == pytest.approx(measuring.clock.offset, abs=1e-3)
    for batch in batches:
        assert batch is not None
        assert {len(column) for column in batch["imu"].values()} == {len(batch["imu"]["t"])}
        assert set(batch["imu"]) == {"t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"}


@pytest.mark.parametrize("interval", [0.5, 1.0, 4.0])
def test_scans_come_at_their_interval_whatever_the_batches(hall: Site, people: Trajectories, interval: float) -> None:
    measuring = phone(hall, scan_interval=interval)
    batches = [measuring.measure(people, float(k), k + 1.0, EPOCH) for k in range(20)]
    when = [scan["t"] for batch in batches if batch for scan in batch["radio"]]
    np.testing.assert_allclose(np.diff(when), interval, atol=1e-3)
    assert len(when) == pytest.approx(20 / interval, abs=1)


def test_scans_name_addresses_of_the_site_with_whole_dbm(hall: Site, people: Trajectories) -> None:
    batch = phone(hall).measure(people, 0.0, 2.0, EPOCH)
    assert batch is not None
    known = {address.lower() for point in hall.access_points for address in point.addresses}
    for scan in batch["radio"]:
        assert {address.lower() for address in scan["address"]} <= known
        assert len(scan["address"]) == len(scan["rssi"]) > 3
        assert all(rssi == round(rssi) and -100 < rssi < -20 for rssi in scan["rssi"])


def test_a_phone_whose_carrier_has_left_falls_silent(hall: Site, people: Trajectories) -> None:
    measuring = phone(hall)
    assert measuring.measure(people, people.end + 1.0, people.end + 2.0, EPOCH) is not None
    assert measuring.measure(people, people.end + LINGER + 1.0, people.end + LINGER + 2.0, EPOCH) is None


def test_same_seed_same_measurements(hall: Site, people: Trajectories) -> None:
    assert phone(hall).measure(people, 0.0, 3.0, EPOCH) == phone(hall).measure(people, 0.0, 3.0, EPOCH)


def test_clocks_are_wrong_by_a_second_to_a_day(hall: Site) -> None:
    offsets = np.array([PhoneClock.draw(np.random.default_rng(seed), 0.0).offset for seed in range(300)])
    assert np.abs(offsets).min() >= 1.0
    assert 3600 < np.abs(offsets).max() <= 86_400
    assert (offsets < 0).any()
    assert (offsets > 0).any()
