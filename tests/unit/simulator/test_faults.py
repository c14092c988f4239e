"""What goes wrong goes wrong as told: to whom, when, how often; nothing else changes."""

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from pydantic import TypeAdapter, ValidationError

from services.simulator.faults import CameraFaults, Fault, PhoneFaults
from services.simulator.phones.phone_batch import Inertial, PhoneBatch, PhoneClock, PhoneScan
from shared.messages import DetectionFrame

FAULTS: TypeAdapter[list[Fault]] = TypeAdapter(list[Fault])
PEOPLE = ["ann", "bob", "7"]


def frames(count: int = 200, camera: str = "c1") -> list[DetectionFrame]:
    return [DetectionFrame(t=0.1 * k, camera=camera, floor="ground", seq=k) for k in range(count)]


def batches(person: str = "ann", count: int = 60) -> list[PhoneBatch]:
    return [
        PhoneBatch(
            person=person,
            seq=k,
            measured_until=k + 1.0,
            sent=k + 1.01,
            arrival=k + 1.1,
            clock=PhoneClock(100.0, 0.0),
            inertial=Inertial(k + np.arange(50) / 50.0, np.full((50, 9), float(k))),
            scans=(PhoneScan(k + 0.5, "wifi", ("aa",), (-50.0,)),),
            step_t=np.empty(0),
            step_length=np.empty(0),
        )
        for k in range(count)
    ]


def when(found: Sequence[PhoneBatch]) -> list[tuple[float, int]]:
    return sorted((batch.arrival, batch.seq) for batch in found)


def seen(*faults: dict[str, object], camera: str = "c1", seed: int = 1) -> list[tuple[float, DetectionFrame]]:
    return CameraFaults(FAULTS.validate_python(list(faults)), seed).arrivals(camera, frames(camera=camera))


def posted(*faults: dict[str, object], person: str = "ann", seed: int = 1) -> list[PhoneBatch]:
    return PhoneFaults(FAULTS.validate_python(list(faults)), seed, PEOPLE).arrivals(batches(person))


def numbers(found: Sequence[PhoneBatch]) -> list[int]:
    return [batch.seq for batch in found]


def test_without_faults_everything_arrives_as_it_was() -> None:
    assert seen() == [(frame.t, frame) for frame in frames()]
    assert numbers(posted()) == list(range(60))


def test_a_camera_that_is_off_says_nothing_and_others_go_on() -> None:
    off = {"kind": "camera-off", "camera": "c1", "start": 5.0, "end": 7.0}
    gone = {frame.seq for frame in frames()} - {frame.seq for _, frame in seen(off)}
    assert gone == set(range(50, 70))
    assert len(seen(off, camera="c2")) == 200
    assert len(seen({**off, "camera": "*"}, camera="c2")) == 180
    assert len(seen({"kind": "camera-off", "camera": "c1", "start": 5.0})) == 50


def test_late_frames_come_after_later_ones_with_the_time_they_were_seen() -> None:
    found = seen({"kind": "frames-late", "camera": "c1", "share": 0.3, "delay": [0.15, 0.5]})
    assert len(found) == 200
    assert [t for t, _ in found] == sorted(t for t, _ in found)
    late = np.array([t - frame.t for t, frame in found])
    assert (late > 0).mean() == pytest.approx(0.3, abs=0.08)
    assert 0.15 <= late[late > 0].min() < late.max() <= 0.5
    assert [frame.seq for _, frame in found] != sorted(frame.seq for _, frame in found)


def test_a_cameras_wrong_clock_stamps_its_frames_and_delays_none() -> None:
    found = seen({"kind": "camera-clock", "camera": "c1", "offset": -0.5, "drift_ppm": 1000.0})
    for t, frame in found:
        assert frame.t == pytest.approx(t - 0.5 + 0.001 * t)
        assert t == pytest.approx(0.1 * frame.seq)


def test_a_phone_that_is_gone_measures_nothing_to_the_very_sample() -> None:
    found = posted({"kind": "phone-gone", "phone": "ann", "start": 20.5, "end": 40.25})
    assert numbers(found) == [*range(21), *range(40, 60)]
    t = np.concatenate([batch.inertial.t for batch in found if batch.inertial])
    assert not ((t >= 20.5) & (t < 40.25)).any()
    assert 60 * 50 - len(t) in (987, 988)
    assert [scan.t for batch in found for scan in batch.scans] == [
        *(k + 0.5 for k in range(20)),
        *(k + 0.5 for k in range(40, 60)),
    ]


def test_a_phone_that_could_not_send_sends_all_of_it_later_in_order() -> None:
    found = posted({"kind": "phone-gone", "phone": "ann", "start": 20.5, "end": 40.25, "lost": False})
    assert numbers(found) == list(range(60))
    held = [batch for batch in found if 20.5 <= batch.measured_until + 0.01 < 40.25]
    assert len(held) == 20
    assert all(40.25 <= batch.sent < 42.3 for batch in held)
    assert all(0.0 < batch.arrival - batch.sent < 0.091 for batch in found)
    assert [batch.sent for batch in found if batch.sent > 43.0] == [k + 1.01 for k in range(42, 60)]
    for batch in held:
        assert batch.inertial is not None
        assert len(batch.inertial.t) == 50


@pytest.mark.parametrize(("phone", "meant"), [("*", PEOPLE), (0, ["ann"]), (2, ["7"]), ("7", ["7"]), ("bob", ["bob"])])
def test_phones_are_named_by_person_by_place_or_all(phone: object, meant: list[str]) -> None:
    gone = {"kind": "phone-gone", "phone": phone, "start": 0.0, "end": 1000.0}
    assert [person for person in PEOPLE if not posted(gone, person=person)] == meant


@pytest.mark.parametrize("phone", ["zoe", 3, "all"])
def test_a_phone_that_nobody_carries_is_refused_by_name(phone: object) -> None:
    with pytest.raises(ValueError, match=r"faults\[0\]\.phone: .*(zoe|3|all).*allowed.*'\*' for all$"):
        posted({"kind": "phone-gone", "phone": phone, "start": 0.0, "end": 1.0})


def test_a_clock_that_jumps_stamps_what_is_measured_from_then_on() -> None:
    found = posted({"kind": "phone-clock", "phone": "ann", "offset": 10.0, "drift_ppm": 1000.0, "at": 30.5})
    columns = [(batch.inertial.t, batch.imu["t"]) for batch in found if batch.inertial and batch.imu]
    t, stamps = (np.concatenate(part) for part in zip(*columns, strict=True))
    np.testing.assert_allclose(stamps[t < 30.5], t[t < 30.5] + 100.0)
    np.testing.assert_allclose(stamps[t >= 30.5], 1.001 * (t[t >= 30.5] - 30.5) + 30.5 + 110.0)
    assert found[-1].sent_stamp == pytest.approx(60.01 + 110.0 + 0.001 * 29.51)
    assert found[0].sent_stamp == pytest.approx(101.01)


def test_duplicates_bear_the_number_of_the_original_and_come_after_it() -> None:
    found = posted({"kind": "duplicate-batches", "phone": "*", "share": 0.3})
    twice = {seq for seq in numbers(found) if numbers(found).count(seq) == 2}
    assert set(numbers(found)) == set(range(60))
    assert 8 <= len(twice) <= 30
    for seq in twice:
        first, second = (batch for batch in found if batch.seq == seq)
        assert 0.5 <= second.arrival - first.arrival <= 3.0
        assert second.inertial is first.inertial


def test_swapped_batches_are_overtaken_and_none_is_lost() -> None:
    found = posted({"kind": "swapped-batches", "phone": "*", "share": 0.3})
    assert sorted(numbers(found)) == list(range(60))
    overtaken = sum(a > b for a, b in zip(numbers(found), numbers(found)[1:], strict=False))
    assert 8 <= overtaken <= 30
    assert [batch.arrival for batch in found] == sorted(batch.arrival for batch in found)


def test_outages_that_overlap_are_one_whatever_their_order_in_the_file() -> None:
    """What waits for the end of the first and would be sent within the second waits for the end of that."""
    first: dict[str, object] = {"kind": "phone-gone", "phone": "ann", "start": 10.5, "end": 20.5, "lost": False}
    second: dict[str, object] = {"kind": "phone-gone", "phone": "ann", "start": 15.5, "end": 30.5, "lost": False}
    for faults in ((first, second), (second, first)):
        found = posted(*faults)
        assert numbers(found) == list(range(60))
        assert not [batch.sent for batch in found if 10.5 <= batch.sent < 30.5]
        assert [(b.sent, b.arrival) for b in found] == [(b.sent, b.arrival) for b in posted(first, second)]


def test_a_copy_is_not_sent_while_the_phone_is_off_either() -> None:
    faults: list[dict[str, object]] = [
        {"kind": "duplicate-batches", "share": 1.0, "after": [1.0, 3.0]},
        {"kind": "phone-gone", "start": 20.5, "end": 40.5, "lost": False},
    ]
    found = posted(*faults)
    assert len(found) == 120
    assert not [batch.sent for batch in found if 20.5 <= batch.sent < 40.5]
    for seq in range(60):
        first, second = (batch for batch in found if batch.seq == seq)
        assert first.arrival < second.arrival


def test_copies_of_overtaken_batches_come_after_them_whatever_the_order_in_the_file() -> None:
    swapped: dict[str, object] = {"kind": "swapped-batches", "share": 1.0}
    twice: dict[str, object] = {"kind": "duplicate-batches", "share": 1.0, "after": [0.5, 0.6]}
    for first, second in ((b.seq, b) for b in posted(twice, swapped)):
        assert second.arrival - (first + 1.1) >= 1.2
    assert {k: v for k, v in _spread(posted(twice, swapped)).items() if not 0.5 <= v <= 0.6} == {}


def _spread(found: Sequence[PhoneBatch]) -> dict[int, float]:
    times = {seq: [batch.arrival for batch in found if batch.seq == seq] for seq in numbers(found)}
    return {seq: max(of) - min(of) for seq, of in times.items()}


MANY: list[dict[str, object]] = [
    {"kind": "swapped-batches", "share": 0.3},
    {"kind": "duplicate-batches", "share": 0.3},
    {"kind": "phone-gone", "start": 10.0, "end": 20.0, "lost": False},
]


def test_a_world_is_the_same_however_it_is_cut_into_blocks() -> None:
    faults = FAULTS.validate_python(MANY)
    whole = PhoneFaults(faults, 3, PEOPLE).arrivals(batches())
    cut = PhoneFaults(faults, 3, PEOPLE)
    parts = [batch for k in range(0, 60, 5) for batch in cut.arrivals(batches()[k : k + 5])]
    other = PhoneFaults(faults, 4, PEOPLE).arrivals(batches())
    assert when(parts) == when(whole) != when(other)


def test_one_more_fault_changes_nothing_about_the_others() -> None:
    late = {"kind": "frames-late", "camera": "c1", "share": 0.3}
    alone = {frame.seq: t for t, frame in seen(late)}
    with_another = {
        frame.seq: t for t, frame in seen(late, {"kind": "camera-off", "camera": "c1", "start": 5, "end": 6})
    }
    assert all(alone[seq] == t for seq, t in with_another.items())
    assert len(with_another) == 190


def test_healthy_batches_are_not_touched() -> None:
    untouched = batches("bob")[0]
    (found,) = PhoneFaults(
        FAULTS.validate_python([{"kind": "phone-gone", "phone": "ann", "start": 0, "end": 9}]), 1, PEOPLE
    ).arrivals([untouched])
    assert found is untouched
    assert dataclasses.asdict(found)["seq"] == 0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"kind": "phone-gone", "start": 10, "end": 5}, "end is 5"),
        ({"kind": "phone-gone", "start": -1, "end": 5}, "start"),
        ({"kind": "frames-late", "camera": "c1", "share": 1.5}, "share"),
        ({"kind": "frames-late", "camera": "c1", "delay": [2, 1]}, "delay is"),
        ({"kind": "camera-off"}, "camera"),
        ({"kind": "meteor"}, "kind"),
        ({"kind": "camera-clock", "camera": "c1", "skew": 1}, "skew"),
        ({"kind": "phone-clock", "phone": -1}, "phone"),
        (
            {"kind": "phone-clock", "phone": True},
            "phone\n.*a person's id, the place of a phone counted from 0, or '\\*'",
        ),
        ({"kind": "phone-clock", "phone": 1.5}, "phone\n.*a person's id, the place of a phone"),
        ({"kind": "camera-off", "camera": "a b"}, "camera\n.*a camera of the site, or '\\*' for each"),
    ],
)
def test_impossible_faults_are_refused_by_name(wrong: dict[str, object], named: str) -> None:
    with pytest.raises(ValidationError, match=named):
        FAULTS.validate_python([wrong])
