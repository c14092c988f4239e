"""Asking about the past: many readers cost one question, nothing of a device is kept, silence is told as such."""

import msgspec
import pytest

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
