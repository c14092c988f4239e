"""What is remembered of tokens ends: by time, by number, and by what is revoked."""

from services.gateway.devices.known_tokens import Grant, KnownTokens
from services.gateway.devices.storage import Registered
from services.gateway.devices.tokens import Claims


def grant(device: str, token_id: str = "t", expires: float = 1e9) -> Grant:
    return Grant(Claims(token_id, device, frozenset({"post"}), expires), Registered(device, "hand"))


def test_a_token_is_looked_up_again_after_a_while_however_often_it_is_used() -> None:
    now = [0.0]
    known = KnownTokens(60.0, clock=lambda: now[0])
    known.remember("token", grant("d-1"), now=0.0)
    for now[0] in range(60):
        assert known.get("token") == grant("d-1")
    now[0] = 60.0
    assert known.get("token") is None
    assert len(known) == 0


def test_an_answer_counts_no_longer_than_its_token_is_valid() -> None:
    now = [0.0]
    known = KnownTokens(60.0, clock=lambda: now[0])
    known.remember("token", grant("d-1", expires=1010.0), now=1000.0)
    now[0] = 9.9
    assert known.get("token") is not None
    now[0] = 10.0
    assert known.get("token") is None


def test_many_tokens_do_not_fill_the_memory_and_those_in_use_stay() -> None:
    known = KnownTokens(60.0, most=100)
    for number in range(1000):
        known.remember(f"token-{number}", grant(f"d-{number}"), now=0.0)
        assert known.get("token-0") is not None
    assert len(known) == 100


def test_one_token_or_all_of_a_device_are_forgotten_and_nobody_elses() -> None:
    known = KnownTokens(60.0)
    for device, token_id in (("d-1", "a"), ("d-1", "b"), ("d-1", "c"), ("d-2", "a")):
        known.remember(f"{device} {token_id}", grant(device, token_id), now=0.0)
    before = known.changes
    known.forget("d-1", "a")
    assert known.get("d-1 a") is None
    assert known.get("d-1 b") is not None
    assert known.get("d-2 a") is not None
    known.forget("d-1")
    assert known.get("d-1 b") is None
    assert known.get("d-1 c") is None
    assert len(known) == 1
    assert known.changes == before + 2  # who asked the database before asks again
