"""One token in two phones: what one hears and what the other hears take turns. Everybody else is one phone."""

import math
from collections.abc import Callable

import numpy as np
import pytest

from services.fusion.two_places import AGAIN, TwoPlaces
from shared.messages import RadioScan
from shared.radio import PathLoss
from shared.site import AccessPoint

Place = tuple[float, float]


def points(columns: int, rows: int, apart: float, floor: str = "ground") -> list[AccessPoint]:
    return [
        AccessPoint(id=f"{floor}-{column}{row}", floor=floor, position=(apart * column, apart * row, 2.8))
        for column in range(columns)
        for row in range(rows)
    ]


LARGE = points(6, 3, 10.0)
SMALL = points(3, 2, 6.0)


class Phone:
    """Scans in one hall: shadowing of a place, white noise, an offset, and what is too weak left out."""

    def __init__(self, hall: list[AccessPoint], seed: int, weaker: float = 0.0, white: float = 4.0) -> None:
        self.radio = PathLoss.of(hall)
        self.rng = np.random.default_rng(seed)
        self.weaker, self.white = weaker, white
        self.offset = self.rng.normal(0.0, 3.0)
        self.shadowing = self.rng.normal(0.0, 4.0, len(hall))

    def scan(self, t: float, place: Place, body: float = 0.0, device: str = "phone") -> RadioScan:
        level = self.radio.rssi(np.array([place]))[0] - self.weaker + self.offset + self.shadowing
        level += self.rng.normal(0.0, self.white, len(level))
        behind = self.radio.positions[:, 0] < place[0]
        level[behind] -= body
        heard = level > -90.0
        return RadioScan(
            t=t,
            device=device,
            seq=int(t),
            access_point=[name for name, ok in zip(self.radio.names, heard, strict=True) if ok],
            rssi=level[heard].tolist(),
        )


def found(watch: TwoPlaces, *phones: tuple[Phone, Callable[[float], Place]], scans: int = 60) -> int:
    """Let phones of one name scan once a second each; return how many scans were contradictions."""
    return sum(
        watch.contradicts(phone.scan(t + 0.3 * number, way(t)))
        for t in range(scans)
        for number, (phone, way) in enumerate(phones)
    )


def at(x: float, y: float) -> Callable[[float], Place]:
    return lambda t: (x, y)


def strolling(t: float) -> Place:
    return 25.0 + 24.0 * math.sin(t / 40.0), 10.0 + 9.0 * math.sin(t / 17.0)


def running(t: float) -> Place:
    """Round and round the small hall at 4 m/s."""
    return 6.0 + 5.0 * math.sin(0.8 * t), 3.0 + 5.0 * math.cos(0.8 * t)


@pytest.mark.parametrize("seed", range(3))
def test_two_phones_of_one_name_are_found_in_a_large_hall(seed: int) -> None:
    assert found(TwoPlaces(LARGE), (Phone(LARGE, seed), at(5, 5)), (Phone(LARGE, seed + 9), at(45, 15))) > 80


@pytest.mark.parametrize("seed", range(3))
def test_two_phones_are_found_in_a_small_hall(seed: int) -> None:
    assert found(TwoPlaces(SMALL), (Phone(SMALL, seed), at(1, 1)), (Phone(SMALL, seed + 9), at(11, 5))) > 60


@pytest.mark.parametrize("seed", range(3))
def test_two_phones_are_found_on_two_floors(seed: int) -> None:
    upstairs = points(3, 2, 6.0, "first")
    two = ((Phone(SMALL, seed), at(6, 3)), (Phone(upstairs, seed + 9), at(6, 3)))
    assert found(TwoPlaces([*SMALL, *upstairs]), *two) > 80


def test_two_phones_that_walk_are_found() -> None:
    two = ((Phone(LARGE, 1), strolling), (Phone(LARGE, 2), lambda t: strolling(t + 63.0)))
    assert found(TwoPlaces(LARGE), *two, scans=120) > 80


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(
    ("hall", "way"),
    [(LARGE, strolling), (SMALL, running), (LARGE, lambda t: running(0.3 * t)), (SMALL, at(3, 3))],
    ids=["stroll", "run", "walk", "stand"],
)
def test_one_phone_is_never_two(hall: list[AccessPoint], way: Callable[[float], Place], seed: int) -> None:
    assert found(TwoPlaces(hall), (Phone(hall, seed), way), scans=400) == 0


@pytest.mark.parametrize("seed", range(4))
def test_weak_radio_accuses_nobody(seed: int) -> None:
    weak = Phone(LARGE, seed, weaker=18.0, white=8.0)
    assert found(TwoPlaces(LARGE), (weak, strolling), scans=400) == 0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("dwell", [1, 3, 10])
def test_a_body_that_shadows_now_this_side_and_now_that_is_no_second_phone(seed: int, dwell: int) -> None:
    watch, phone = TwoPlaces(LARGE), Phone(LARGE, seed)
    for t in range(400):
        assert not watch.contradicts(phone.scan(float(t), (25.0, 10.0), body=8.0 if t // dwell % 2 else 0.0))


def test_receivers_that_report_in_turns_are_no_second_phone() -> None:
    watch, phone = TwoPlaces(LARGE), Phone(LARGE, 1)
    for t in range(300):
        whole = phone.scan(float(t), (25.0, 10.0))
        half = [index for index, name in enumerate(whole.access_point) if int(name[-2]) % 2 == t % 2]
        assert not watch.contradicts(
            RadioScan(
                t=whole.t,
                device="phone",
                seq=t,
                access_point=[whole.access_point[index] for index in half],
                rssi=[whole.rssi[index] for index in half],
            )
        )


@pytest.mark.parametrize("seed", range(4))
def test_two_bands_told_in_turns_are_no_second_phone(seed: int) -> None:
    """A point of two bands has one name here; each band is shadowed and sent in its own way."""
    watch, phone = TwoPlaces(LARGE), Phone(LARGE, seed)
    low = phone.shadowing.copy()
    high = low + np.random.default_rng(seed + 99).normal(0.0, 5.0, len(LARGE))
    for t in range(200):
        phone.shadowing = high if t % 2 else low
        assert not watch.contradicts(phone.scan(float(t), (25.0, 10.0)))


def test_nothing_is_kept_of_who_has_been_silent_for_long() -> None:
    watch, silent, other = TwoPlaces(LARGE), Phone(LARGE, 1), Phone(LARGE, 2)
    watch.contradicts(silent.scan(0.0, (25.0, 10.0)))
    late = other.scan(100.0, (25.0, 10.0))
    watch.contradicts(RadioScan(t=late.t, device="other", seq=1, access_point=late.access_point, rssi=late.rssi))
    assert {device for device, _, _ in watch._devices} == {"other"}


@pytest.mark.parametrize("seed", range(3))
def test_who_stands_in_an_atrium_or_takes_the_stairs_is_one_phone(seed: int) -> None:
    both = [*SMALL, *points(3, 2, 6.0, "first")]
    watch, phone = TwoPlaces(both), Phone(both, seed)
    assert found(watch, (phone, at(6, 3)), scans=200) == 0
    upstairs = Phone(both[len(SMALL) :], seed)
    for t in range(200, 600):
        floor = upstairs if t // 30 % 2 else phone
        assert not watch.contradicts(floor.scan(float(t), (6.0, 3.0)))


def test_two_devices_far_apart_are_two_devices() -> None:
    watch, one, other = TwoPlaces(LARGE), Phone(LARGE, 3), Phone(LARGE, 4)
    for t in range(60):
        assert not watch.contradicts(one.scan(t, (5.0, 5.0), device="one"))
        assert not watch.contradicts(other.scan(t, (45.0, 15.0), device="two"))


def test_a_mended_token_is_well_again_within_a_minute() -> None:
    watch, one, other = TwoPlaces(LARGE), Phone(LARGE, 1), Phone(LARGE, 2)
    assert found(watch, (one, at(5, 5)), (other, at(45, 15))) > 0
    alone = [watch.contradicts(one.scan(60.0 + t, (5.0, 5.0))) for t in range(60)]
    assert alone[0]
    assert not any(alone[30:])


def test_a_doubled_phone_is_worth_a_line_a_minute() -> None:
    watch, one, other = TwoPlaces(LARGE), Phone(LARGE, 1), Phone(LARGE, 2)
    lines = [
        t
        for t in range(200)
        for phone, place in ((one, (5.0, 5.0)), (other, (45.0, 15.0)))
        if watch.contradicts(phone.scan(float(t), place)) and watch.worth_telling("phone", float(t))
    ]
    assert 3 <= len(lines) <= 4
    assert np.diff(lines).min() >= AGAIN


def test_nonsense_is_left_alone() -> None:
    watch = TwoPlaces(LARGE)
    for t in (1e308, -1e308, 0.0):
        for level in (1e308, -1e308, 5.0, -50.0):
            strange = RadioScan(t=t, device="d", seq=0, access_point=["ground-00", "ground-01", "x"], rssi=[level] * 3)
            assert not watch.contradicts(strange)
    assert not TwoPlaces([]).contradicts(strange)


def test_a_forgotten_device_is_new() -> None:
    watch, one, other = TwoPlaces(LARGE), Phone(LARGE, 1), Phone(LARGE, 2)
    for t in range(200):
        assert not watch.contradicts(one.scan(float(t), (5.0, 5.0)))
        assert not watch.contradicts(other.scan(t + 0.3, (45.0, 15.0)))
        if t % 3 == 2:
            watch.forget("phone")
