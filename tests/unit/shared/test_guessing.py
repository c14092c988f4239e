"""Which secrets are guessed first, and who shares a ration of guesses."""

import pytest

from shared.client_address import source_of
from shared.weak_secrets import why_weak


@pytest.mark.parametrize(
    ("secret", "words"),
    [
        ("a-bit-short", "has 11 characters, at least 12"),
        ("aaaaaaaaaaaaaaaa", "same few characters"),
        ("abababababababab", "same few characters"),
        ("Password1234", "guessed first"),
        ("atrium-dashboard-123", "guessed first"),
    ],
)
def test_a_weak_secret_is_refused_and_told_why(secret: str, words: str) -> None:
    assert words in (why_weak(secret, 12) or "")


@pytest.mark.parametrize("secret", ["correct horse battery", "7f3a11c1b0755adf91e20c44", "a password of our own"])
def test_others_are_not(secret: str) -> None:
    assert why_weak(secret, 12) is None


@pytest.mark.parametrize(
    ("host", "source"),
    [
        ("198.51.100.7", "198.51.100.7"),
        ("::ffff:198.51.100.7", "198.51.100.7"),
        ("2001:db8:1:2:3:4:5:6", "2001:db8:1:2::/64"),
        ("fe80::1%eth0", "fe80::/64"),
        ("testclient", "testclient"),
    ],
)
def test_all_addresses_of_one_customer_share_a_ration(host: str, source: str) -> None:
    assert source_of(host) == source
