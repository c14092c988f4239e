import time

import pytest

from services.dashboard.guesses import AttemptLimit, KnownBrowsers
from services.dashboard.sessions import MOST, Sessions, Visitor


def test_a_session_holds_until_it_is_ended_and_not_for_another() -> None:
    sessions = Sessions("open sesame", "key", 12)
    mine, other = sessions.begin(), sessions.begin(Visitor("token", "maria", "guard"))
    visitor = sessions.find(mine)
    assert visitor is not None
    assert (visitor.key, visitor.name) == ("key", "")
    visitor.ended = True
    assert sessions.find(mine) is None
    found = sessions.find(other)
    assert found is not None
    assert found.name == "maria"
    assert Sessions("open sesame", "key", 12).find(other) is None


@pytest.mark.parametrize("shown", ["", "operator", "\udc80", "ä", "a" * 10_000])
def test_a_forged_session_is_none(shown: str) -> None:
    sessions = Sessions("open sesame", "key", 12)
    sessions.begin()
    assert sessions.find(shown) is None


def test_a_session_ends_with_its_time_and_with_that_of_the_sign_in(monkeypatch: pytest.MonkeyPatch) -> None:
    sessions, now = Sessions("open sesame", "key", 2.0), time.time()
    shared, short = sessions.begin(), sessions.begin(Visitor("token", "maria", expires=now + 600))
    for later, holds in ((590, [True, True]), (610, [True, False]), (7210, [False, False])):
        monkeypatch.setattr(time, "time", lambda later=later: now + later)
        assert [sessions.find(shown) is not None for shown in (shared, short)] == holds


def test_of_too_many_sessions_the_oldest_gives_way() -> None:
    sessions = Sessions("open sesame", "key", 2.0)
    shown = [sessions.begin() for _ in range(MOST + 1)]
    assert [sessions.find(one) is not None for one in (shown[0], shown[1], shown[-1])] == [False, True, True]


def test_without_a_shared_password_only_staff_come_in_or_everybody() -> None:
    assert Sessions("", "key", 1.0).open
    staff_only = Sessions("", "key", 1.0, staff_only=True)
    assert not staff_only.open
    assert not staff_only.right("")


def test_guessing_is_limited_by_name_and_source_and_by_source() -> None:
    limit = AttemptLimit(of_a_name=(2, 30.0), of_a_source=(3, 60.0))
    for _ in range(2):
        assert limit.wait("maria", "a") == 0.0
        limit.count("maria", "a")
    assert 25.0 < limit.wait("maria", "a") <= 30.0
    assert limit.wait("maria", "b") == 0.0
    assert limit.wait("otto", "a") == 0.0
    limit.count("otto", "a")
    assert 55.0 < limit.wait("else", "a") <= 60.0


def test_a_browser_is_known_by_its_name_only_and_after_a_restart_too() -> None:
    kept = KnownBrowsers("open sesame", "key").issue("maria")
    after = KnownBrowsers("open sesame", "key")
    source = after.source("maria", kept)
    assert source is not None
    assert source != after.source("maria", after.issue("maria"))
    assert after.source("otto", kept) is None
    assert KnownBrowsers("open sesame", "another key").source("maria", kept) is None
    for forged in ("", "x", kept + "x", "\udc80"):
        assert after.source("maria", forged) is None
