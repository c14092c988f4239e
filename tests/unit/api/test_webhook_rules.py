"""Where webhooks may go, how they are signed, and when they are tried again."""

import asyncio
import base64
import hashlib
import hmac
import ipaddress
import threading
from collections.abc import Awaitable, Callable

import httpcore
import pytest
from hypothesis import given
from hypothesis import strategies as st
from waiting import wait_until
from webhook_receiver import receiver

from services.api.alerts import host_lookup
from services.api.alerts.host_lookup import HostLookup
from services.api.alerts.receiver_address import AddressError, CheckedNetwork, check_url, is_refused
from services.api.alerts.signature import new_secret, signed_headers
from services.api.alerts.webhook_sender import Patience, pause_after

PUBLIC = "93.184.216.34"
LOOPBACK = [ipaddress.ip_network("127.0.0.0/8")]


def names(*answers: list[str]) -> Callable[[str, int], Awaitable[list[str]]]:
    """A resolver whose answers change: one after the other, the last for ever."""
    left = list(answers)

    async def resolve(_host: str, _port: int) -> list[str]:
        return left.pop(0) if len(left) > 1 else left[0]

    return resolve


@pytest.mark.parametrize(
    "address",
    [
        "127.0.0.1",
        "127.8.8.8",
        "10.1.2.3",
        "172.31.255.1",
        "192.168.1.1",
        "169.254.169.254",
        "100.64.0.1",
        "0.0.0.0",
        "224.0.0.1",
        "255.255.255.255",
        "::1",
        "::",
        "fe80::1%eth0",
        "fd00::1",
        "fec0::1",
        "ff02::1",
        "::ffff:10.0.0.1",
        "::127.0.0.1",
        "64:ff9b::7f00:1",
        "2002:7f00:1::",
    ],
)
def test_addresses_of_no_public_host_are_refused(address: str) -> None:
    assert is_refused(address, [])


def test_public_addresses_and_allowed_networks_are_not_refused() -> None:
    assert not is_refused(PUBLIC, [])
    assert not is_refused("2606:2800:220:1:248:1893:25c8:1946", [])
    assert not is_refused("::ffff:8.8.8.8", [])
    assert not is_refused("127.0.0.1", LOOPBACK)
    assert not is_refused("::ffff:127.0.0.1", LOOPBACK)
    assert is_refused("10.0.0.1", LOOPBACK)
    assert not is_refused("fd00::1", [ipaddress.ip_network("fd00::/8")])


@given(st.ip_addresses(v=4))
def test_an_address_of_version_4_is_judged_the_same_however_it_is_wrapped(address: ipaddress.IPv4Address) -> None:
    plain = is_refused(str(address), [])
    assert is_refused(f"::ffff:{address}", []) == plain
    assert is_refused(str(ipaddress.IPv6Address((0x64FF9B << 96) | int(address))), []) == plain


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("ftp://host/", "not a URL such as"),
        ("//host/", "not a URL such as"),
        ("https:///path", "not a URL such as"),
        ("javascript:alert(1)", "not a URL such as"),
        ("https://user:secret@host/", "a user"),
        ("https://host/#part", "a fragment"),
        ("https://host:0/", "port 0"),
        ("https://host:99999/", "out of range"),
        ("https://[::1/", "Invalid IPv6 URL"),
        ("https://host/a b", "spaces"),
        ("https://host/\r\nX: y", "spaces"),
        ("https://müze.example/", "ASCII"),
        ("http://host/", "plain text"),
    ],
)
def test_a_url_that_is_none_is_refused_with_the_reason(url: str, words: str) -> None:
    with pytest.raises(AddressError, match=words):
        asyncio.run(check_url(url, [], names([PUBLIC])))


def test_a_name_of_which_one_address_is_private_is_refused() -> None:
    asyncio.run(check_url("https://host/path?query", [], names([PUBLIC])))
    asyncio.run(check_url("http://host/path", LOOPBACK, names(["127.0.0.1"])))
    with pytest.raises(AddressError, match=r"host is at 10\.0\.0\.1"):
        asyncio.run(check_url("https://host/", [], names([PUBLIC, "10.0.0.1"])))
    with pytest.raises(AddressError, match="plain text"):
        asyncio.run(check_url("http://host/", LOOPBACK, names([PUBLIC, "127.0.0.1"])))


def post(network: CheckedNetwork, url: str) -> int:
    async def scenario() -> int:
        async with httpcore.AsyncConnectionPool(network_backend=network) as pool:
            return (await pool.request("POST", url, content=b"{}")).status

    return asyncio.run(scenario())


def test_a_name_that_answers_differently_the_second_time_gains_nothing() -> None:
    with receiver() as inside:
        rebinding = names([PUBLIC], ["127.0.0.1"])
        asyncio.run(check_url("https://host/", [], rebinding))
        with pytest.raises(httpcore.ConnectError, match=r"host is at 127\.0\.0\.1"):
            post(CheckedNetwork([], rebinding), f"http://host:{inside.port}/")
        assert inside.taken == []


def test_connections_go_to_the_address_that_was_checked_and_keep_the_name() -> None:
    with receiver() as inside:
        network = CheckedNetwork(LOOPBACK, names(["127.0.0.2", "127.0.0.1"]))
        assert post(network, f"http://alarm.example:{inside.port}/x") == 200
        ((path, headers, _),) = inside.taken
        assert (path, headers["host"]) == ("/x", f"alarm.example:{inside.port}")


def test_a_receiver_can_verify_the_signature_as_the_documentation_says() -> None:
    secret, body = new_secret(), b'{"alert":{}}'
    headers = signed_headers(secret, "msg_1", 1767225600, body)
    key = base64.b64decode(secret.removeprefix("whsec_"))
    expected = base64.b64encode(hmac.digest(key, b"msg_1.1767225600." + body, hashlib.sha256)).decode()
    assert headers == {
        "webhook-id": "msg_1",
        "webhook-timestamp": "1767225600",
        "webhook-signature": "v1," + expected,
    }
    # The specification's own example.
    told = b'{"test": 2432232314}'
    example = signed_headers("whsec_MfKQ9r8GKYqrTwjUPD8ILPZIo2LaLaSw", "msg_p5jXN8AQM9LWM0D4loKWxJek", 1614265330, told)
    assert example["webhook-signature"] == "v1,g0hM9SsE+OTPJTGt/tmIKtSyZlE3uFJELVlNIOLJ1OE="


@given(st.integers(1, 5000), st.floats(0.0, 1.0))
def test_pauses_double_up_to_a_bound_and_differ_by_chance(attempts: int, chance: float) -> None:
    patience = Patience(timeout=10.0, attempts=12, first_pause=5.0, longest_pause=3600.0)
    pause = pause_after(attempts, patience, chance)
    middle = min(3600.0, 5.0 * 2.0 ** (attempts - 1)) if attempts < 60 else 3600.0
    assert 0.5 * middle <= pause <= 1.5 * middle


def test_a_name_server_that_hangs_takes_one_thread_for_a_name_and_holds_up_no_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(host_lookup, "PATIENCE", 0.2)
    answer, asked = threading.Event(), list[str]()

    def system(host: str, _port: int) -> list[str]:
        asked.append(host)
        if host.startswith("hangs"):
            answer.wait(20.0)
        if host == "unknown":
            raise OSError("no such name")
        return [PUBLIC]

    async def look_up() -> None:
        lookup = HostLookup(3, system)
        both = [lookup(host, 443) for host in ("hangs-1", "hangs-2") for _ in range(20)]
        told = await asyncio.gather(*both, asyncio.to_thread(str, "storage"), lookup("host", 1), return_exceptions=True)
        assert told[-2:] == ["storage", [PUBLIC]]
        assert all(isinstance(each, TimeoutError) for each in told[:-2])
        assert sorted(asked) == ["hangs-1", "hangs-2", "host"]
        with pytest.raises(OSError, match="no such name"):
            await lookup("unknown", 443)
        with pytest.raises(TimeoutError):
            await lookup("hangs-3", 443)
        with pytest.raises(OSError, match="3 names are being looked up"):
            await lookup("host", 443)
        answer.set()
        wait_until(lambda: not lookup._under_way, 10.0, "the lookups to end")
        assert await lookup("hangs-1", 443) == [PUBLIC]

    asyncio.run(look_up())
