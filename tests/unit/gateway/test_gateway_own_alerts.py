"""What a phone is told of the alerts about itself, of whatever kind."""

import typing

import pytest

from services.gateway.devices.own_alerts import OwnAlertBook
from shared.messages import Alert, AlertKind
from shared.zones import ZoneDefinition


def alert(kind: AlertKind, **more: typing.Any) -> Alert:
    told = {"t": 1.0, "id": kind, "zone": "z", "area": "hall", "track": 1, "floor": "g", "x": 2.0, "y": 3.0, **more}
    return Alert(kind=kind, **told)


@pytest.mark.parametrize("kind", typing.get_args(AlertKind))
def test_a_phone_is_told_of_every_kind_and_not_of_others_in_it(kind: AlertKind) -> None:
    book = OwnAlertBook([], kept=60.0)
    book.take(alert(kind, device="me", rule="r", value=1.0, other_track=7, other_device="somebody"), arrived=0.0)
    [own] = book.of("me")
    assert (own.kind, own.zone, own.name) == (kind, "z", "z")
    assert "somebody" not in repr(own)
    assert book.of("somebody") == []


def test_a_crowd_is_nobodys_own_alert() -> None:
    book = OwnAlertBook([], kept=60.0)
    book.take(alert("crowd", track=0, value=9.0), arrived=0.0)
    assert book.of("me") == []


def test_a_zone_that_staff_drew_is_called_by_its_name_also_in_what_was_told_before() -> None:
    book = OwnAlertBook([], kept=60.0)
    book.take(alert("enter", device="me"), arrived=0.0)
    book.draw([ZoneDefinition(id="z", name="The vault", floor="g", points=[(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)])])
    book.take(alert("exit", device="me"), arrived=1.0)
    assert [own.name for own in book.of("me")] == ["The vault"] * 2
