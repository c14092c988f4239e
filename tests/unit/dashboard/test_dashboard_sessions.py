import time

import pytest
from itsdangerous import TimestampSigner

from services.dashboard.sessions import AttemptLimit, Sessions


def test_a_session_is_valid_where_password_and_key_are_the_same() -> None:
    token = Sessions("open sesame", "key", 12).issue()
    assert Sessions("open sesame", "key", 12).valid(token)
    assert not Sessions("open barley", "key", 12).valid(token)
    assert not Sessions("open sesame", "another key", 12).valid(token)


@pytest.mark.parametrize("token", ["", "operator", "operator.x.y", "\udc80", "ä.b.c", "a" * 10_000])
def test_a_forged_session_is_refused(token: str) -> None:
    assert not Sessions("open sesame", "key", 12).valid(token)


def test_a_changed_character_breaks_a_session() -> None:
    sessions = Sessions("open sesame", "key", 12)
    token = sessions.issue()
    changed = token[:-1] + ("A" if token[-1] != "A" else "B")
    # The last character of base64 may carry bits that do not count; the one before it always counts.
    changed_before = token[:-2] + ("A" if token[-2] != "A" else "B") + token[-1]
    assert sessions.valid(token)
    assert not sessions.valid(changed_before)
    assert not sessions.valid(changed + "x")


def test_a_session_ends_with_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    sessions = Sessions("open sesame", "key", 2.0)
    token = sessions.issue()
    now = int(time.time())
    monkeypatch.setattr(TimestampSigner, "get_timestamp", lambda _: now + 7190)
    assert sessions.valid(token)
    monkeypatch.setattr(TimestampSigner, "get_timestamp", lambda _: now + 7210)
    assert not sessions.valid(token)


def test_guessing_is_limited_by_address_and_altogether() -> None:
    limit = AttemptLimit(per_address=2, altogether=3, window=60)
    limit.failed("a", 0.0)
    assert limit.wait("a", 1.0) == 0.0
    limit.failed("a", 10.0)
    assert limit.wait("a", 20.0) == 40.0
    assert limit.wait("b", 20.0) == 0.0
    limit.failed("b", 30.0)
    assert limit.wait("c", 30.0) == 30.0
    assert limit.wait("a", 61.0) == 0.0
