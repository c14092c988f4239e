"""Phones worked on at once: what is wrong with the batch of one does the others no harm, and may be sent again."""

import asyncio
import json
import math
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from services.gateway.devices.storage import Registered
from services.gateway.errors import RequestError
from services.gateway.phones.batch_check import Limits
from services.gateway.phones.phone_book import PhoneBook
from services.gateway.protocol import BatchReply
from services.gateway.reckoning.dead_reckoning import DeadReckoner, InertialSamples, Motion, Walk
from shared.bus import Bus
from shared.site import load_site

POISON = 7.0
"""m/s² along x; dead reckoning is made to fail on it."""


class Fragile(DeadReckoner):
    """Dead reckoning that fails on one sample, with all that is advanced beside it."""

    def advance(self, walks: Sequence[Walk], samples: Sequence[InertialSamples]) -> list[list[Motion]]:
        if any((one.acceleration[:, 0] == POISON).any() for one in samples):
            raise FloatingPointError("poison")
        return super().advance(walks, samples)


@pytest.fixture
def phones(zenoh_router: str, project: Path) -> Iterator[PhoneBook]:
    site = load_site(project / "deploy/sites/hall/site.yaml")
    with Bus([zenoh_router]) as bus, PhoneBook(site, bus, Limits(), 10.0) as book:
        book._reckoner = Fragile(math.pi / 2)
        yield book


def body(seq: int, ax: float = 0.0) -> bytes:
    t = [100.0 + seq + i / 50 for i in range(50)]
    imu = {"t": t, "ax": [ax] * 50, "ay": [0] * 50, "az": [9.81] * 50, "gx": [0] * 50, "gy": [0] * 50, "gz": [0] * 50}
    heard = {"t": 100.0 + seq, "address": ["02:a7:00:00:00:01"], "rssi": [-50]}
    return json.dumps({"sent": 101.0 + seq, "seq": seq, "imu": imu, "radio": [heard]}).encode()


def together(phones: PhoneBook, bodies: dict[str, bytes]) -> dict[str, Any]:
    """Post bodies of several devices in one group and return what each is answered."""

    async def post() -> list[Any]:
        answers = [phones.submit_soon(Registered(device, "hand"), sent, time.time()) for device, sent in bodies.items()]
        return await asyncio.gather(*answers, return_exceptions=True)

    return dict(zip(bodies, asyncio.run(post()), strict=True))


@pytest.mark.parametrize("depth", [2_000, 200_000])
def test_a_body_nested_too_deeply_is_refused_and_no_other_phone_loses_its_batch(phones: PhoneBook, depth: int) -> None:
    nested = b'{"x": ' + b"[" * depth + b"]" * depth + b"}"
    answers = together(phones, {"d-1": body(0), "bad": nested, "d-2": body(0)})
    assert isinstance(answers["bad"], RequestError)
    assert answers["bad"].status in (400, 422)
    for device in ("d-1", "d-2"):
        assert (answers[device].duplicate, answers[device].accepted.samples) == (False, 50)


def test_where_dead_reckoning_fails_the_others_are_used_and_the_batch_may_come_again(phones: PhoneBook) -> None:
    answers = together(phones, {"d-1": body(0), "bad": body(0, POISON), "d-2": body(0)})
    assert isinstance(answers["bad"], FloatingPointError)
    for device in ("d-1", "d-2"):
        assert (answers[device].duplicate, answers[device].accepted.samples) == (False, 50)
    again = phones.post(Registered("bad", "hand"), body(0), time.time())
    assert isinstance(again, BatchReply)
    assert (again.duplicate, again.accepted.samples, again.accepted.scans) == (False, 50, 1)
    assert phones.post(Registered("bad", "hand"), body(0), time.time()).duplicate


def test_a_phone_that_fails_again_and_again_is_kept_apart(phones: PhoneBook) -> None:
    together(phones, {"bad": body(0, POISON)})
    together(phones, {"d-1": body(0)})
    walk = phones._entries["d-1"].phone.walk
    answers = together(phones, {"d-1": body(1), "bad": body(0, POISON)})
    assert isinstance(answers["bad"], FloatingPointError)
    assert phones._entries["d-1"].phone.walk is walk
