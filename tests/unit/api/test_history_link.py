"""Asking about the past: many readers cost one question, nothing of a device is kept, silence is told as such."""

import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec
import pytest
from api_app import api
from waiting import wait_until

from services.api.history_link import HistoryLink
from services.api.problems import ProblemError
from shared.history_query import AskDwell, AskTrajectory, Dwell, Flows, HistoryAnswer, Refusal, Trajectory
from shared.keys import Keys

DWELL = AskDwell(since=0.0, until=1.0)
WAY = AskTrajectory(device="d-1", since=0.0, until=1.0)
NOWHERE = Trajectory(
    device="d-1", floors=[], t=b"", x=b"", y=b"", accuracy=b"", probability=b"", track=b"", state=b"", floor=b""
)


class Double:
    """Answers the same to everything and counts."""

    def __init__(self, answer: HistoryAnswer | bytes | None) -> None:
        self.asked: list[bytes] = []
        self._answer = answer

    def __call__(self, key: str, timeout: float, payload: bytes | None) -> bytes | None:
        assert key == "atrium/1/hall/history/query"
        self.asked.append(payload or b"")
        if self._answer is None or isinstance(self._answer, bytes):
            return self._answer
        return msgspec.msgpack.encode(self._answer)


def test_many_readers_of_a_sum_ask_once_and_of_a_device_each_for_himself() -> None:
    double = Double(Dwell(places=[]))
    link = HistoryLink(Keys("hall"), double)
    assert [link.answer(DWELL, Dwell) for _ in range(20)] == [Dwell(places=[])] * 20
    assert len(double.asked) == 1
    link.answer(AskDwell(since=0.0, until=2.0), Dwell)
    assert len(double.asked) == 2
    double = Double(NOWHERE)
    link = HistoryLink(Keys("hall"), double)
    for _ in range(3):
        link.answer(WAY, Trajectory)
    assert len(double.asked) == 3


@pytest.mark.parametrize(
    ("answer", "status", "word"),
    [
        (None, 503, "not running"),
        (b"\xc1 no MessagePack", 503, "same version"),
        (Flows(zones=[], counts=[]), 503, "same version"),
        (Refusal(words="the database is away"), 503, "database"),
        (Refusal(words="no", field="floor", found="roof", allowed="ground"), 404, "no"),
        (Refusal(words="no", field="until", found="1", allowed="later"), 422, "no"),
    ],
)
def test_what_is_no_answer_is_a_problem(answer: HistoryAnswer | bytes | None, status: int, word: str) -> None:
    with pytest.raises(ProblemError) as caught:
        HistoryLink(Keys("hall"), Double(answer)).answer(DWELL, Dwell)
    assert caught.value.problem.status == status
    assert word in caught.value.problem.detail
    assert bool(caught.value.headers) == (status == 503)


def test_questions_that_take_long_leave_other_requests_alone_and_are_refused_at_once(tmp_path: Path) -> None:
    go_on = threading.Event()
    with api(tmp_path) as here, ThreadPoolExecutor(60) as crowd:

        def slow(*_: object) -> bytes:
            assert go_on.wait(30.0)
            return msgspec.msgpack.encode(Refusal(words="enough"))

        here.ask = slow
        path = "/v1/heatmap?since=1767225600&until=1769817600&cell="
        asked = [crowd.submit(here.client.get, f"{path}{1 + number / 100}") for number in range(60)]
        wait_until(lambda: sum(one.done() for one in asked) >= 52, 20.0, "all but eight refused")
        assert here.client.get("/v1/webhooks").status_code == 200, "which needs a thread, too"
        refused = {(one.result().status_code, one.result().headers["Retry-After"]) for one in asked if one.done()}
        assert refused == {(429, "5")}
        go_on.set()
        answers = sorted(one.result().status_code for one in asked)
        assert answers == [429] * 52 + [503] * 8
        assert here.client.get(f"{path}3").status_code == 503, "the seats are free again"
