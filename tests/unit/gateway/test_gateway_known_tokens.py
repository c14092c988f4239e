"""What is remembered of tokens ends: by time, and by number."""

from services.gateway.devices.known_tokens import KnownTokens
from services.gateway.devices.storage import Registered


def test_a_token_is_looked_up_again_after_a_while_however_often_it_is_used() -> None:
    now = [0.0]
    known = KnownTokens(60.0, clock=lambda: now[0])
    known.remember("token", Registered("d-1", "hand"))
    for now[0] in range(60):
        assert known.get("token") == Registered("d-1", "hand")
    now[0] = 60.0
    assert known.get("token") is None
    assert len(known) == 0


def test_many_tokens_do_not_fill_the_memory_and_those_in_use_stay() -> None:
    known = KnownTokens(60.0, most=100)
    for number in range(1000):
        known.remember(f"token-{number}", Registered(f"d-{number}", "hand"))
        assert known.get("token-0") is not None
    assert len(known) == 100
    known.forget("token-0")
    assert known.get("token-0") is None
