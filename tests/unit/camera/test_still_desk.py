"""A still leaves a camera only where it may, only for a while, never often; and it is the whole picture."""

import cv2
import msgspec
import numpy as np
import pytest
from waiting import wait_until

from services.camera.still_desk import StillDesk
from shared.camera_still import StillAnswer, StillQuestion

PICTURE = np.random.default_rng(0).integers(0, 255, (48, 64, 3)).astype(np.uint8)


class Asked:
    """A question as the bus brings it."""

    def __init__(self, payload: bytes) -> None:
        self.payload = payload
        self.told: bytes | None = None

    def answer(self, payload: bytes) -> None:
        assert self.told is None, "answered twice"
        self.told = payload


class Clock:
    def __init__(self) -> None:
        self.t = 1000.0

    def __call__(self) -> float:
        return self.t


@pytest.fixture
def clock() -> Clock:
    return Clock()


@pytest.fixture
def desk(clock: Clock) -> StillDesk:
    return StillDesk("door", True, 15.0, clock, clock)


def ask(desk: StillDesk, do: str, **more: object) -> StillAnswer:
    question = Asked(msgspec.json.encode({"do": do, "by": "me", **more}))
    desk.take(question)  # type: ignore[arg-type]
    told = wait_until(lambda: question.told, 10, "an answer")
    assert told is not None
    return msgspec.json.decode(told, type=StillAnswer)


def test_where_the_setting_is_off_nothing_is_given_and_nothing_is_kept(clock: Clock) -> None:
    desk = StillDesk("door", False, 15.0, clock, clock)
    desk.offer(PICTURE, 1.0)
    assert desk._newest is None
    for do in ("open", "look", "board"):
        told = ask(desk, do)
        assert told.refusal == "off"
        assert "ATRIUM_ALLOW_STILLS" in told.words
        assert not told.jpeg


def test_a_still_needs_a_permission_that_ends_by_itself(desk: StillDesk, clock: Clock) -> None:
    desk.offer(PICTURE, 999.0)
    assert ask(desk, "look").refusal == "closed"
    assert ask(desk, "open").until == 1000.0 + 900.0
    given = ask(desk, "look")
    assert (given.refusal, given.t, given.width, given.height) == ("", 999.0, 64, 48)
    shown = cv2.imdecode(np.frombuffer(given.jpeg, np.uint8), cv2.IMREAD_COLOR)
    assert shown.shape == PICTURE.shape
    clock.t += 900.0
    assert ask(desk, "look").refusal == "closed"


def test_stills_are_no_video(desk: StillDesk, clock: Clock) -> None:
    desk.offer(PICTURE, 999.0)
    ask(desk, "open")
    assert ask(desk, "look").refusal == ""
    clock.t += 0.9
    assert ask(desk, "look").refusal == "busy"
    assert ask(desk, "board", columns=9, rows=6).refusal == "busy"
    clock.t += 0.1
    assert ask(desk, "look").refusal == ""


def test_before_the_first_picture_and_after_the_end_there_is_none(desk: StillDesk) -> None:
    ask(desk, "open")
    assert ask(desk, "look").refusal == "no-picture"
    desk.offer(PICTURE, 999.0)
    desk.close()
    assert ask(desk, "look").refusal == "off"


def test_a_board_on_the_floor_is_found_and_none_is_said_to_be_none(desk: StillDesk, clock: Clock) -> None:
    ask(desk, "open")
    desk.offer(PICTURE, 999.0)
    assert ask(desk, "board", columns=9, rows=6).refusal == "no-board"
    clock.t += 1.0
    board = np.full((360, 480, 3), 230, np.uint8)
    for row in range(5):
        for column in range(6):
            if (row + column) % 2:
                board[60 + 40 * row : 100 + 40 * row, 90 + 40 * column : 130 + 40 * column] = 20
    desk.offer(cv2.GaussianBlur(board, (3, 3), 0), 1000.0)
    found = ask(desk, "board", columns=5, rows=4)
    assert found.refusal == ""
    expected = [(129.5 + 40 * column, 99.5 + 40 * row) for row in range(4) for column in range(5)]
    assert np.allclose(sorted(found.corners), sorted(expected), atol=0.5)
    clock.t += 1.0
    assert "columns" in ask(desk, "board", columns=1, rows=4).words


@pytest.mark.parametrize("payload", [b"", b"{}", b'{"do": "all"}', b'{"do": "look", "x": 1}', b"\xff"])
def test_what_is_no_question_is_refused(desk: StillDesk, payload: bytes) -> None:
    question = Asked(payload)
    desk.take(question)  # type: ignore[arg-type]
    assert question.told is not None
    assert msgspec.json.decode(question.told, type=StillAnswer).refusal == "not-understood"


def test_a_question_says_what_it_wants() -> None:
    assert msgspec.json.decode(msgspec.json.encode(StillQuestion(do="look", by="me")), type=StillQuestion).by == "me"
