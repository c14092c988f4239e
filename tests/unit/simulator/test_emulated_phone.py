"""What an emulated phone measures fits together, block after block, on its own wrong clock."""

from pathlib import Path

import numpy as np
import pytest
from phone_carriers import WalkingPeople
from pydantic import ValidationError

from services.simulator.phones.magnetic import MagneticField, MagneticParameters
from services.simulator.phones.phone import EmulatedPhone, FleetParameters, PhoneBatch, PhoneClock
from services.simulator.phones.posting import body_of
from services.simulator.radio.radio_world import RadioParameters, RadioWorld
from shared.site import Site, load_site

EPOCH = 1_700_000_000.0
STROLL = WalkingPeople([(30.0, 0.9, 0.3), (10.0, 0.0, 0.3), (600.0, 0.02, 1.0)])


@pytest.fixture(scope="module")
def hall() -> Site:
    return load_site(Path(__file__).resolve().parents[3] / "deploy/sites/hall/site.yaml")


@pytest.fixture(scope="module")
def radio(hall: Site) -> RadioWorld:
    return RadioWorld(hall, 1, RadioParameters())


@pytest.fixture(scope="module")
def magnetic(hall: Site) -> MagneticField:
    return MagneticField(hall, MagneticParameters(), 1)


class Maker:
    """Makes phones of one hall."""

    def __init__(self, hall: Site, radio: RadioWorld, magnetic: MagneticField) -> None:
        self._world = hall, radio, magnetic

    def phone(self, person: str = "ann", seed: int = 1, **fleet: object) -> EmulatedPhone:
        return EmulatedPhone(*self._world, person, FleetParameters.model_validate({"count": 1, **fleet}), seed)

    def batches(
        self, seconds: float, people: WalkingPeople = STROLL, block: float = 5.0, **fleet: object
    ) -> list[PhoneBatch]:
        phone = self.phone(people.persons[0], **fleet)
        return [b for k in range(round(seconds / block)) for b in phone.block(people, k * block, (k + 1) * block)]


@pytest.fixture
def make(hall: Site, radio: RadioWorld, magnetic: MagneticField) -> Maker:
    return Maker(hall, radio, magnetic)


def samples(batches: list[PhoneBatch]) -> tuple[np.ndarray, np.ndarray]:
    inertial = [batch.inertial for batch in batches if batch.inertial is not None]
    return np.concatenate([part.t for part in inertial]), np.concatenate([part.values for part in inertial])


@pytest.mark.parametrize("rate", [50.0, 100.0])
def test_batches_of_a_second_join_into_one_stream_of_samples(make: Maker, rate: float) -> None:
    batches = make.batches(40.0, inertial_rate=rate, hole_every=0.0)
    assert [batch.seq for batch in batches] == list(range(40))
    assert [batch.measured_until for batch in batches] == [float(k) for k in range(1, 41)]
    t, values = samples(batches)
    assert len(t) == 40 * rate
    assert (np.diff(t) > 0).all()
    np.testing.assert_allclose(t, np.arange(len(t)) / rate, atol=1.01e-3)
    assert np.isfinite(values).all()


def test_samples_are_late_by_a_part_of_a_millisecond_and_some_are_missing(make: Maker) -> None:
    t, _ = samples(make.batches(300.0, hole_every=20.0, sample_jitter=0.002))
    gaps = np.diff(t)
    holes = gaps[gaps > 0.03]
    assert 5 < len(holes) < 40
    assert holes.max() < 0.15
    assert 0.0005 < gaps[gaps < 0.03].std() < 0.002


def test_the_same_walk_is_measured_however_it_is_cut_into_batches(make: Maker) -> None:
    whole, parts = (samples(make.batches(40.0, batch_seconds=seconds))[1] for seconds in (7.0, 0.5))
    assert len(whole) > 34 * 50
    np.testing.assert_array_equal(parts[: len(whole)], whole)


def test_true_steps_are_as_long_as_the_distance_walked(make: Maker) -> None:
    batches = make.batches(60.0)
    t = np.concatenate([batch.step_t for batch in batches])
    length = np.concatenate([batch.step_length for batch in batches])
    assert (np.diff(t) > 0).all()
    walked = [STROLL.walked(float(end)) for end in t]
    np.testing.assert_allclose(np.cumsum(length[1:]), np.array(walked[1:]) - walked[0], atol=0.02)
    assert walked[-1] > 26.0
    for batch in batches:
        assert ((batch.step_t >= batch.measured_until - 1.1) & (batch.step_t < batch.measured_until)).all()


def test_everything_is_stamped_on_the_phones_own_clock(make: Maker) -> None:
    batches = make.batches(20.0)
    clock = batches[0].clock
    assert abs(clock.offset) >= 1.0
    for batch in batches:
        assert batch.imu is not None
        assert batch.inertial is not None
        np.testing.assert_allclose(
            batch.imu["t"] - batch.inertial.t, clock.offset + clock.drift * batch.inertial.t, atol=1e-7
        )
        body = body_of(batch, EPOCH)
        assert body["sent"] == pytest.approx(EPOCH + batch.sent + clock.offset, abs=0.01)
        assert {len(column) for column in body["imu"].values()} == {len(batch.inertial.t)}
        assert set(body["imu"]) == {"t", "ax", "ay", "az", "gx", "gy", "gz", "mx", "my", "mz"}
        assert 0 < body["sent"] - body["imu"]["t"][-1] < 0.1


@pytest.mark.parametrize("interval", [0.5, 1.0, 4.0])
def test_scans_come_at_their_interval_whatever_the_batches(make: Maker, interval: float) -> None:
    schedule = {"kind": "regular", "every": interval, "jitter": 0.0}
    when = [scan.t for batch in make.batches(40.0, wifi=schedule) for scan in batch.scans if scan.kind == "wifi"]
    np.testing.assert_allclose(np.diff(when), interval, atol=1e-6)
    assert len(when) == pytest.approx(40 / interval, abs=1)


def test_scans_name_addresses_of_the_site_with_whole_dbm(make: Maker, hall: Site) -> None:
    known = {address.lower() for point in hall.access_points if point.kind == "wifi" for address in point.addresses}
    scans = [scan for batch in make.batches(5.0) for scan in batch.scans]
    assert scans
    for scan in scans:
        assert {address.lower() for address in scan.address} <= known
        assert len(scan.address) == len(scan.rssi) > 2
        assert all(rssi == round(rssi) and -100 < rssi < -10 for rssi in scan.rssi)


def beacons(hall: Site) -> Site:
    points = [point.model_copy(update={"kind": "ble"}) for point in hall.access_points[::2]]
    return hall.model_copy(update={"access_points": [*hall.access_points[1::2], *points]})


@pytest.mark.parametrize("window", [1.0, 4.0])
def test_beacons_are_reported_window_by_window_and_never_cut(hall: Site, window: float) -> None:
    site = beacons(hall)
    make = Maker(site, RadioWorld(site, 1, RadioParameters()), MagneticField(site, MagneticParameters(), 1))
    scans = [
        scan
        for batch in make.batches(
            40.0, wifi=None, inertial_rate=0, ble={"kind": "adverts", "rate": 7, "window": window}
        )
        for scan in batch.scans
    ]
    assert {scan.kind for scan in scans} == {"ble"}
    assert len(scans) == 40 / window
    np.testing.assert_allclose([scan.t % window for scan in scans], window, atol=0.2)
    ble = {point.addresses[0].upper() for point in site.access_points if point.kind == "ble"}
    assert {address for scan in scans for address in scan.address} <= ble


def test_who_hears_both_kinds_tells_them_apart(hall: Site) -> None:
    site = beacons(hall)
    make = Maker(site, RadioWorld(site, 1, RadioParameters()), MagneticField(site, MagneticParameters(), 1))
    scans = [scan for batch in make.batches(20.0, ble={"kind": "adverts"}) for scan in batch.scans]
    kinds = {point.addresses[0].upper(): point.kind for point in site.access_points}
    assert {scan.kind for scan in scans} == {"wifi", "ble"}
    assert all(kinds[address] == scan.kind for scan in scans for address in scan.address)


def test_a_live_phone_sends_at_once_and_in_order(make: Maker) -> None:
    batches = make.batches(60.0, network_delay=(0.02, 0.9))
    delays = np.array([batch.arrival - batch.measured_until for batch in batches])
    assert (delays > 0.02).all()
    assert delays.max() < 1.2
    assert delays.std() > 0.05
    assert all(batch.measured_until < batch.sent < batch.arrival for batch in batches)
    assert (np.diff([batch.arrival for batch in batches]) > 0).all()


def test_a_phone_with_its_screen_off_sends_late_and_nothing_older_than_the_gateway_takes(make: Maker) -> None:
    every = 120.0
    batches = make.batches(600.0, inertial_rate=0, upload={"every": every}, batch_seconds=10.0)
    assert [batch.seq for batch in batches] == list(range(60))
    sent = np.array([batch.sent for batch in batches])
    waited = sent - np.array([batch.measured_until for batch in batches])
    assert (waited >= 0).all()
    assert waited.max() > 80.0
    assert all(batch.sent - scan.t <= every for batch in batches for scan in batch.scans)
    flushes = np.flatnonzero(np.diff(sent) > 30.0)
    assert 4 <= len(flushes) <= 7
    assert (np.diff([batch.arrival for batch in batches]) > 0).all()


def test_a_phone_whose_carrier_is_away_falls_silent_and_comes_back(make: Maker) -> None:
    people = WalkingPeople([(60.0, 1.0, 0.0)], away=(12.02, 31.3))
    batches = make.batches(50.0, people)
    t, values = samples(batches)
    assert not ((t > 12.1) & (t < 31.2)).any()
    assert ((t > 11) & (t < 12)).sum() == 50
    assert np.abs(np.linalg.norm(values[:, 3:6], axis=1)).max() < 3.0  # no jolt across the gap
    silent = [batch for batch in batches if 13.5 < batch.measured_until < 31.0]
    assert not silent
    assert [batch.seq for batch in batches] == list(range(len(batches)))


def test_same_seed_same_measurements_and_others_differ(make: Maker) -> None:
    one, two = (make.batches(10.0, carrying="mixed") for _ in range(2))
    assert [batch.inertial.values.tobytes() for batch in one if batch.inertial] == [
        batch.inertial.values.tobytes() for batch in two if batch.inertial
    ]
    assert [(b.scans, b.arrival, b.clock) for b in one] == [(b.scans, b.arrival, b.clock) for b in two]
    bob = make.batches(10.0, WalkingPeople([(30.0, 0.9, 0.3)], persons=["bob"]))
    assert bob[0].clock != one[0].clock


def test_clocks_are_wrong_by_as_much_as_asked() -> None:
    offsets = np.array([PhoneClock.draw(np.random.default_rng(s), (1.0, 86_400.0), 20.0).offset for s in range(300)])
    assert 1.0 <= np.abs(offsets).min() < 10.0
    assert 3600 < np.abs(offsets).max() <= 86_400
    assert 0.3 < (offsets < 0).mean() < 0.7
    drifts = np.array([PhoneClock.draw(np.random.default_rng(s), (0.0, 0.0), 20.0) for s in range(300)])
    assert {clock.offset for clock in drifts} == {0.0}
    assert np.std([clock.drift for clock in drifts]) == pytest.approx(20e-6, rel=0.15)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"count": 0}, "count"),
        ({"inertial_rate": -50}, "inertial_rate"),
        ({"inertial_rate": 5}, "20 to 200"),
        ({"inertial_rate": 0, "wifi": None}, "measure nothing"),
        ({"inertial_rate": 200, "batch_seconds": 100}, "12000 samples"),
        ({"wifi": {"kind": "regular", "every": 0.05}, "batch_seconds": 60}, "scans"),
        ({"network_delay": (0.5, 0.1)}, "network_delay"),
        ({"upload": {"every": 7200}}, "every"),
        ({"carrying": "bag"}, "carrying"),
        ({"colour": "red"}, "colour"),
    ],
)
def test_impossible_phones_are_refused_by_name(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        FleetParameters.model_validate({"count": 1, **wrong})
