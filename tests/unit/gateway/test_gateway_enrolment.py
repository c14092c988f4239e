"""Keys, QR codes and the ration of attempts."""

import pytest
from msgspec.json import encode

from services.gateway.devices.enrolment import key_of, qr_svg, qr_text, same_key
from services.gateway.errors import RequestError, read_json, refuse
from services.gateway.protocol import Enrolment
from shared.rate_limiter import RateLimiter


def test_what_the_qr_code_holds_is_accepted_as_a_key() -> None:
    assert key_of(qr_text("http://10.0.0.5:8080", "a key / with ünusual signs")) == "a key / with ünusual signs"
    assert key_of("plain-key") == "plain-key"


def test_text_that_only_looks_like_a_code_is_taken_as_it_is() -> None:
    for odd in ("{", '{"enrolment_key": 5}', "{}", "{" * 10_000):
        assert key_of(odd) == odd


def test_the_qr_code_is_a_picture() -> None:
    assert b"<svg" in qr_svg(qr_text("http://10.0.0.5:8080", "key"))


def test_keys_are_compared_as_text_of_any_kind() -> None:
    assert same_key("schlüssel", "schlüssel")
    assert not same_key("schlüssel", "schlussel")


def test_guessing_keys_is_rationed_per_address_and_forgiven_with_time() -> None:
    now = [0.0]
    limiter = RateLimiter(1.0, 30, clock=lambda: now[0])
    for _ in range(3):
        assert limiter.wait("a") == 0.0
        limiter.spend("a", 10.0)
    assert limiter.wait("a") == 1.0
    assert limiter.wait("b") == 0.0
    now[0] = 1.0
    assert limiter.wait("a") == 0.0


def test_a_flood_of_addresses_does_not_fill_the_memory() -> None:
    limiter = RateLimiter(1.0, 30, names=100)
    for number in range(1000):
        limiter.spend(f"10.0.{number // 256}.{number % 256}")
    assert len(limiter._buckets) == 100


def test_no_text_of_a_sender_breaks_a_comparison_or_an_answer() -> None:
    assert not same_key("\udc00 a lone surrogate", "key")
    with pytest.raises(RequestError) as caught:
        refuse("s." + "\ud800" * 10_000, "is wrong", found="\udfff")
    assert b"s.???" in encode(caught.value.reply)
    assert len(caught.value.reply.detail[0].field) == 200
    with pytest.raises(RequestError) as caught:
        read_json(b'{"x":' * 100_000, Enrolment)
    assert caught.value.status == 400
