"""One token in two phones: heard here and there, again and again."""

import math

import numpy as np

from services.fusion.two_places import TwoPlaces
from shared.messages import RadioScan
from shared.radio import PathLoss

NAMES = tuple(f"ap-{column}{row}" for column in range(6) for row in range(3))
POSITIONS = np.array([(10.0 * column, 10.0 * row, 2.8) for column in range(6) for row in range(3)])
RADIO = PathLoss(NAMES, POSITIONS, np.full(18, -40.0), np.full(18, 2.2))


def scan(t: float, place: tuple[float, float], rng: np.random.Generator, device: str = "phone") -> RadioScan:
    level = RADIO.rssi(np.array([place]))[0] + rng.normal(0.0, 6.0, 18)
    heard = level > -85.0
    return RadioScan(
        t=t,
        device=device,
        seq=int(t),
        access_point=[name for name, ok in zip(NAMES, heard, strict=True) if ok],
        rssi=level[heard].tolist(),
    )


def test_two_phones_of_one_name_are_found_at_once() -> None:
    rng, watch = np.random.default_rng(1), TwoPlaces(RADIO)
    found = [watch.contradicts(scan(t, (5.0, 5.0) if t % 2 else (45.0, 15.0), rng)) for t in range(10)]
    assert sum(found) >= 6


def test_a_phone_that_walks_through_the_hall_is_never_two() -> None:
    rng, watch = np.random.default_rng(2), TwoPlaces(RADIO)
    for t in range(2000):
        place = (25.0 + 24.0 * math.sin(t / 40.0), 10.0 + 9.0 * math.sin(t / 17.0))
        assert not watch.contradicts(scan(float(t), place, rng))


def test_two_devices_far_apart_are_two_devices() -> None:
    rng, watch = np.random.default_rng(3), TwoPlaces(RADIO)
    for t in range(20):
        assert not watch.contradicts(scan(t, (5.0, 5.0), rng, "one"))
        assert not watch.contradicts(scan(t, (45.0, 15.0), rng, "two"))


def test_nonsense_is_left_alone() -> None:
    watch = TwoPlaces(RADIO)
    for level in (1e308, -1e308, 5.0):
        strange = RadioScan(t=1e300, device="d", seq=0, access_point=["ap-00", "ap-01", "x"], rssi=[level] * 3)
        assert not watch.contradicts(strange)


def test_a_forgotten_device_is_new() -> None:
    rng, watch = np.random.default_rng(1), TwoPlaces(RADIO)
    for t in range(2, 200, 2):
        watch.contradicts(scan(t, (5.0, 5.0), rng))
        watch.contradicts(scan(t + 1.0, (45.0, 15.0), rng))
        watch.forget("phone")
        assert not watch.contradicts(scan(t + 2.0, (5.0, 5.0), rng))
        watch.forget("phone")
