"""One phone's state: nothing twice, nothing unknown, everything on the server's clock."""

import math
from typing import Any

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone import NATIVE, Phone
from services.gateway.phones.seen_numbers import MOST, SeenNumbers
from services.gateway.protocol import Batch, RadioReadings
from services.gateway.reckoning.dead_reckoning import DeadReckoner
from shared.messages import InertialColumns, MotionBatch, RadioScan

ADDRESSES = {"02:a7:00:00:00:01": "ap-1", "02:a7:00:00:00:02": "ap-2", "02:a7:00:00:00:12": "ap-2"}


RECKONER = DeadReckoner(math.pi / 2)


def phone() -> Phone:
    return Phone("d-1", ADDRESSES, "hand")


def scan(t: float, **heard: float) -> RadioReadings:
    return RadioReadings(t=t, address=[f"02:A7:00:00:00:{key[1:]}" for key in heard], rssi=list(heard.values()))


def tiny(seq: int) -> Batch:
    return Batch(sent=100.0, seq=seq, radio=[scan(99.0, _01=-50.0)])


def walking(second: int, clock: float) -> InertialColumns:
    t = [clock + second + i / 50 for i in range(50)]
    columns: dict[str, Any] = {name: [0.0] * 50 for name in ("ax", "ay", "gx", "gy", "gz", "mx")}
    az = [9.81 + 3.0 * math.sin(2 * math.pi * 1.9 * (stamp - clock)) for stamp in t]
    return InertialColumns(t=t, az=az, my=[20.0] * 50, mz=[-43.0] * 50, **columns)


def test_addresses_become_site_ids_whatever_their_case_and_unknown_ones_go_nowhere() -> None:
    to = phone()
    batch = Batch(sent=100.0, seq=0, radio=[scan(99.0, _01=-50.0, _02=-60.0, _99=-40.0)])
    intake = to.take(batch, 100.0, Limits(), RECKONER)
    (message,) = to.outbox
    assert isinstance(message, RadioScan)
    assert (message.access_point, message.rssi) == (["ap-1", "ap-2"], [-50.0, -60.0])
    assert intake.ignored == {"unknown address": 1}
    assert intake.accepted.readings == 2


def test_an_access_point_with_two_addresses_is_told_once_at_its_strongest() -> None:
    to = phone()
    intake = to.take(Batch(sent=100.0, seq=0, radio=[scan(99.0, _02=-60.0, _12=-55.0)]), 100.0, Limits(), RECKONER)
    (message,) = to.outbox
    assert isinstance(message, RadioScan)
    assert (message.access_point, message.rssi) == (["ap-2"], [-55.0])
    assert intake.ignored == {"access point heard twice in a scan": 1}


def test_a_scan_of_strangers_only_is_counted_and_not_published() -> None:
    to = phone()
    intake = to.take(Batch(sent=100.0, seq=0, radio=[scan(99.0, _77=-60.0)]), 100.0, Limits(), RECKONER)
    assert not to.outbox
    assert intake.ignored == {"unknown address": 1}


@pytest.mark.parametrize("off", [-86_400.0, 0.0, 86_400.0])
def test_a_clock_that_is_off_by_a_day_places_everything_in_server_time(off: float) -> None:
    server, to = 1.7e9, phone()
    for second in range(12):
        clock = server + off
        batch = Batch(
            sent=clock + second + 1, seq=second, imu=walking(second, clock), radio=[scan(clock + second, _01=-50.0)]
        )
        to.take(batch, server + second + 1.03, Limits(), RECKONER)
    scans = [m for m in to.outbox if isinstance(m, RadioScan)]
    motions = [m for m in to.outbox if isinstance(m, MotionBatch)]
    assert [m.t for m in scans] == pytest.approx([server + second for second in range(12)], abs=0.05)
    assert all(server - 0.1 <= m.t_start < m.t <= server + 12.1 for m in motions)
    steps = [t for m in motions for t in m.step_t]
    assert 17 <= len(steps) <= 24
    assert all(server < t < server + 12 for t in steps)
    assert [m.seq for m in motions] == list(range(len(motions)))
    assert [m.seq for m in scans] == list(range(12))


@pytest.mark.parametrize("compass", [True, False])
def test_each_step_tells_the_strength_of_the_field_where_the_phone_has_a_compass(compass: bool) -> None:
    to = phone()
    for second in range(12):
        imu = walking(second, 0.0)
        if not compass:
            imu = msgspec.structs.replace(imu, mx=[], my=[], mz=[])
        to.take(Batch(sent=second + 1.0, seq=second, imu=imu), second + 1.0, Limits(), RECKONER)
    batches = [m for m in to.outbox if isinstance(m, MotionBatch) and m.step_t]
    assert batches
    for batch in batches:
        expected = [math.hypot(20.0, 43.0)] * len(batch.step_t) if compass else []
        assert batch.magnetic == pytest.approx(expected, abs=2.0)


def test_the_same_batch_again_is_acknowledged_and_not_published_twice() -> None:
    to = phone()
    batch = Batch(sent=100.0, seq=7, radio=[scan(99.0, _01=-50.0)])
    assert not to.take(batch, 100.0, Limits(), RECKONER).duplicate
    assert to.take(batch, 130.0, Limits(), RECKONER).duplicate
    assert len(to.outbox) == 1


def test_batches_may_come_in_any_order_and_a_backlog_after_what_is_live() -> None:
    to = phone()
    order = [0, 2, 1, 5000, 5001, *range(4999, 2, -1)]
    taken = [to.take(tiny(seq), 100.0, Limits(), RECKONER).duplicate for seq in order]
    assert not any(taken)
    assert all(to.take(tiny(seq), 100.0, Limits(), RECKONER).duplicate for seq in order)


def test_what_cannot_be_told_any_more_is_refused_and_not_acknowledged() -> None:
    to = phone()
    for seq in range(0, 10_000, 2):
        assert not to.take(tiny(seq), 100.0, Limits(), RECKONER).duplicate
    assert len(to._seen[NATIVE]._first) == MOST
    with pytest.raises(RequestError) as caught:
        to.take(tiny(1), 100.0, Limits(), RECKONER)
    assert (caught.value.status, caught.value.reply.detail[0].field) == (422, "seq")
    assert len(to.outbox) == 5000
    assert not to.take(tiny(9_997), 100.0, Limits(), RECKONER).duplicate


def test_each_source_counts_for_itself() -> None:
    to = phone()
    for seq, source in ((170_000_000_000, "sensor-logger"), (0, NATIVE), (0, "find3")):
        intake = to.admit(tiny(seq), 100.0, Limits(), source)
        assert not intake.duplicate
        to.tell(intake, [], 0)
        assert to.admit(tiny(seq), 100.0, Limits(), source).duplicate


@given(st.lists(st.integers(0, 40), max_size=60))
def test_ranges_say_what_a_set_says(numbers: list[int]) -> None:
    seen, known = SeenNumbers(), set[int]()
    for number in numbers:
        assert (number in seen) == (number in known)
        if number not in known:
            seen.add(number)
            known.add(number)
    assert [number in seen for number in range(42)] == [number in known for number in range(42)]
    assert all(last + 1 < first for last, first in zip(seen._last, seen._first[1:], strict=False))


def test_what_was_measured_too_long_ago_is_marked_late_message_by_message() -> None:
    to = Phone("d-1", ADDRESSES, "hand", lateness=5.0)
    batch = Batch(sent=100.0, seq=0, radio=[scan(90.0, _01=-50.0), scan(99.0, _01=-50.0)])
    assert to.take(batch, 100.0, Limits(), RECKONER).late
    assert [message.late for message in to.outbox] == [True, False]
    assert not to.take(Batch(sent=101.0, seq=1, radio=[scan(100.0, _01=-50.0)]), 101.0, Limits(), RECKONER).late


def test_a_phone_without_gyroscope_or_compass_is_taken() -> None:
    to = phone()
    for second in range(12):
        imu = walking(second, 1e9)
        bare = InertialColumns(t=imu.t, ax=imu.ax, ay=imu.ay, az=imu.az, gx=[], gy=[], gz=[])
        to.take(Batch(sent=1e9 + second + 1, seq=second, imu=bare), 1e9 + second + 1, Limits(), RECKONER)
    assert sum(len(m.step_t) for m in to.outbox if isinstance(m, MotionBatch)) >= 16
