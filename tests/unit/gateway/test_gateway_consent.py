"""A consent text has a version and a text, or the gateway does not start; alerts are forgotten in time."""

from pathlib import Path

import pytest

from services.gateway.devices.consent import read_consent
from services.gateway.devices.own_alerts import OwnAlertBook
from shared.messages import Alert
from shared.runner import ServiceError


def test_the_shipped_text_has_a_version() -> None:
    consent = read_consent(None)
    assert consent.version == "1"
    assert consent.text.startswith("May this site follow where your phone is?")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (b"May we?", "the first line is 'May we\\?'; it must be `version: NAME`"),
        (b"version: a b\nMay we?", "the first line"),
        (b"version: 1\n \n", "holds no text"),
        (b"\xff", "not UTF-8"),
        (None, "cannot be read: No such file"),
    ],
)
def test_a_text_that_cannot_be_used_is_named_with_its_file(tmp_path: Path, text: bytes | None, told: str) -> None:
    path = tmp_path / "consent.txt"
    if text is not None:
        path.write_bytes(text)
    with pytest.raises(ServiceError, match=told) as caught:
        read_consent(path)
    assert str(path) in str(caught.value)


def alert(number: int, device: str) -> Alert:
    return Alert(
        id=f"a{number}", t=float(number), zone="z", kind="enter", area="hall", track=1, floor="ground", x=1.0, y=2.0,
        device=device,
    )  # fmt: skip


def test_alerts_are_told_once_and_forgotten_after_a_while_or_with_the_device() -> None:
    book = OwnAlertBook([], kept=60.0)
    book.take(alert(1, "d-1"), arrived=0.0)
    book.take(alert(2, "d-1"), arrived=30.0)
    book.take(alert(2, "d-1"), arrived=31.0)  # a cache told it again
    book.take(alert(3, "d-2"), arrived=30.0)
    assert [own.t for own in book.of("d-1")] == [1.0, 2.0]
    book.forget_old(61.0)
    assert [own.t for own in book.of("d-1")] == [2.0]
    book.forget("d-1")
    assert book.of("d-1") == []
    assert len(book.of("d-2")) == 1
