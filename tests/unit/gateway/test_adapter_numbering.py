"""Numbers of foreign payloads: the same for the same payload, ever increasing, above those of an app that counts."""

from services.gateway.adapters.numbering import REMEMBERED, Numbering


def numbering(now: float = 1_767_225_600.0, devices: int = 10) -> Numbering:
    return Numbering(devices, lambda: now)


def test_a_payload_sent_again_keeps_its_number() -> None:
    numbers = numbering()
    first = numbers.number("d", ("s", "0"))
    assert numbers.number("d", ("s", "1")) == first + 1
    assert numbers.number("d", ("s", "0")) == first


def test_a_new_recording_goes_on_counting() -> None:
    numbers = numbering()
    assert numbers.number("d", ("one", "0")) < numbers.number("d", ("two", "0"))


def test_after_a_restart_numbers_are_higher_than_before() -> None:
    before = [numbering().number("d", (str(k),)) for k in range(3)][-1]
    assert numbering(1_767_225_601.0).number("d", ("0",)) > before


def test_little_is_remembered() -> None:
    numbers = numbering(devices=3)
    for k in range(3 * REMEMBERED):
        numbers.number("d", (str(k),))
    for k in range(9):
        numbers.number(f"d-{k}", ("0",))
    assert len(numbers._given) == 3
    assert all(len(given) <= REMEMBERED for given in numbers._given.values())


def test_of_a_withdrawn_device_nothing_is_remembered() -> None:
    numbers = numbering()
    numbers.number("d", ("0",))
    numbers.number("e", ("0",))
    numbers.forget("d")
    assert list(numbers._given) == ["e"]
