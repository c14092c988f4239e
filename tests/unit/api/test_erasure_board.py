"""Whose consent was withdrawn, and where that was carried out, in whatever order it is told."""

import pytest

from services.api.erasures import KEPT, ErasureBoard, OwnErasures
from shared.messages import Erasure, ErasureDone


@pytest.mark.parametrize("turned", [False, True])
def test_a_store_that_acknowledged_is_not_waited_for(turned: bool) -> None:
    board = ErasureBoard(["hall"])
    told = [Erasure(t=10.0, device="d-1"), ErasureDone(t=12.0, device="d-1", service="history")]
    for message in reversed(told) if turned else told:
        board.take(message)
    board.take(ErasureDone(t=99.0, device="d-1", service="history"))
    board.take(Erasure(t=20.0, device="d-2"))
    newest, first = board.report(30.0).erasures
    assert (newest.device, newest.waiting) == ("d-2", ["api", "fusion-hall", "geofence", "history", "learning"])
    assert (first.device, first.t, first.waiting) == ("d-1", 10.0, ["api", "fusion-hall", "geofence", "learning"])
    assert [(store.service, store.t) for store in first.done] == [("history", 12.0)]


def test_no_more_is_kept_than_the_gateway_tells() -> None:
    board = ErasureBoard(["hall"])
    for number in range(KEPT + 5):
        board.take(ErasureDone(t=float(number), device=f"d-{number}", service="history"))
    rows = board.report(0.0).erasures
    assert (len(rows), rows[-1].device) == (KEPT, "d-5")


def test_the_api_is_done_once_every_part_is() -> None:
    told: list[str] = []
    own = OwnErasures(("alerts", "books"), told.append)
    own.of("alerts")("d-1")
    own.of("books")("d-2")
    own.of("alerts")("d-1")
    assert told == []
    own.of("books")("d-1")
    assert told == ["d-1"]
