"""What the API keeps of learning's answers, and how long it waits for them."""

from collections.abc import Callable

import msgspec
import pytest

from services.api.learning_link import IMPORT_PATIENCE, PATIENCE, LearningLink
from shared.keys import Keys
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import LearningReport


class Learning:
    """Answers every question, and notes how long it was given."""

    def __init__(self) -> None:
        self.patience: list[float] = []
        self.meanwhile: Callable[[], None] = lambda: None

    def ask(self, key: str, timeout: float, payload: bytes | None) -> bytes:
        self.patience.append(timeout)
        self.meanwhile()
        if payload is None:
            return msgspec.json.encode(LearningReport(t=float(len(self.patience))))
        return msgspec.json.encode(LearningAnswer(done=True, words="done"))


@pytest.mark.parametrize("meanwhile", [False, True])
def test_a_report_from_before_an_erasure_is_not_kept(meanwhile: bool) -> None:
    learning = Learning()
    link = LearningLink(Keys("test"), learning.ask)
    if meanwhile:
        learning.meanwhile = link.forget
    assert link.report().t == 1.0
    learning.meanwhile = lambda: None
    if not meanwhile:
        assert link.report().t == 1.0  # kept
        link.forget()
    assert link._report is None
    assert link.report().t == 2.0


def test_an_import_is_waited_for_longer_than_other_orders() -> None:
    learning = Learning()
    link = LearningLink(Keys("test"), learning.ask)
    link.tell(LearningCommand(do="freeze"))
    link.tell(LearningCommand(do="import", bundle=msgspec.Raw(b"{}")))
    assert learning.patience == [PATIENCE, IMPORT_PATIENCE]
    assert IMPORT_PATIENCE > 5 * PATIENCE
