"""One thread takes what waits at once: small tasks first, each owner's in order, none lost, none hurt by another."""

import asyncio
import threading
from collections.abc import Iterator, Sequence

import pytest

from services.gateway.phones.group_worker import (
    HEAVIEST_GROUP,
    LARGEST_GROUP,
    LIGHT,
    ClosedError,
    FullError,
    GroupWorker,
)


class Doubling:
    """Doubles numbers; refuses negative ones, fails on a thousand; can be held back."""

    def __init__(self) -> None:
        self.groups: list[list[int]] = []
        self.go_on = threading.Event()
        self.go_on.set()
        self.begun = threading.Event()

    def work(self, tasks: Sequence[int]) -> list[int | Exception]:
        self.begun.set()
        assert self.go_on.wait(10.0)
        self.groups.append(list(tasks))
        if 1000 in tasks:
            raise RuntimeError("a mistake")
        return [ValueError("negative") if task < 0 else 2 * task for task in tasks]


@pytest.fixture
def doubling() -> Doubling:
    return Doubling()


@pytest.fixture
def worker(doubling: Doubling) -> Iterator[GroupWorker[int, int]]:
    made: GroupWorker[int, int] = GroupWorker(doubling.work, 200, lambda: None, "doubling")
    yield made
    doubling.go_on.set()
    made.close()


def held(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    """Keep the worker busy with one task."""
    doubling.go_on.clear()
    worker.submit(0)
    assert doubling.begun.wait(10.0)


def test_what_comes_while_a_group_is_worked_on_becomes_the_next_in_order(
    doubling: Doubling, worker: GroupWorker[int, int]
) -> None:
    held(doubling, worker)
    answers = [worker.submit(task) for task in (1, 2, -3, 4)]
    doubling.go_on.set()
    assert [answers[k].result(10.0) for k in (0, 1, 3)] == [2, 4, 8]
    with pytest.raises(ValueError, match="negative"):
        answers[2].result(10.0)
    assert doubling.groups == [[0], [1, 2, -3, 4]]


def test_a_group_is_no_larger_than_its_first_can_wait_for(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    held(doubling, worker)
    answers = [worker.submit(task) for task in range(LARGEST_GROUP + 10)]
    doubling.go_on.set()
    assert [answer.result(10.0) for answer in answers] == [2 * task for task in range(LARGEST_GROUP + 10)]
    assert [len(group) for group in doubling.groups] == [1, LARGEST_GROUP, 10]


def test_more_than_may_wait_is_refused_at_once(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    held(doubling, worker)
    for task in range(200):
        worker.submit(task)
    with pytest.raises(FullError):
        worker.submit(200)


def test_a_mistake_is_told_to_its_group_and_the_next_is_worked_on(worker: GroupWorker[int, int]) -> None:
    with pytest.raises(RuntimeError, match="a mistake"):
        worker.submit(1000).result(10.0)
    assert worker.submit(4).result(10.0) == 8


def test_what_is_called_comes_between_groups(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    held(doubling, worker)
    threading.Timer(0.05, doubling.go_on.set).start()
    assert worker.call(lambda: list(doubling.groups)) == [[0]]


def test_heavy_tasks_come_in_small_groups_after_light_ones(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    held(doubling, worker)
    heavy = HEAVIEST_GROUP // 2
    answers = [worker.submit(task, heavy, f"flush {task}") for task in (1, 2, 3)]
    answers += [worker.submit(task, LIGHT, "live") for task in (4, 5)]
    doubling.go_on.set()
    assert [answer.result(10.0) for answer in answers] == [2, 4, 6, 8, 10]
    assert doubling.groups == [[0], [4, 5], [1, 2], [3]]


def test_a_task_alone_may_be_heavier_than_a_group(doubling: Doubling, worker: GroupWorker[int, int]) -> None:
    assert worker.submit(1, 10 * HEAVIEST_GROUP).result(10.0) == 2


def test_light_tasks_do_not_overtake_a_heavy_one_of_the_same_owner(
    doubling: Doubling, worker: GroupWorker[int, int]
) -> None:
    held(doubling, worker)
    answers = [worker.submit(task, weight, "one") for task, weight in ((1, 0), (2, LIGHT + 1), (3, 0))]
    answers.append(worker.submit(4, 0, "other"))
    doubling.go_on.set()
    assert [answer.result(10.0) for answer in answers] == [2, 4, 6, 8]
    assert doubling.groups == [[0], [1, 4], [2, 3]]
    worker.submit(5, 0, "one").result(10.0)
    assert not worker._heavy_of


def test_a_closed_worker_answers_what_waits_and_refuses_the_rest(
    doubling: Doubling, worker: GroupWorker[int, int]
) -> None:
    held(doubling, worker)
    answers = [worker.submit(task, LIGHT * task) for task in range(1, 100)]
    threading.Timer(0.05, doubling.go_on.set).start()
    worker.close()
    assert [answer.result(0.0) for answer in answers] == [2 * task for task in range(1, 100)]
    with pytest.raises(ClosedError):
        worker.submit(1)
    with pytest.raises(ClosedError):
        worker.call(lambda: None)


def test_an_event_loop_gets_its_answers_and_one_that_gave_up_harms_nobody(
    doubling: Doubling, worker: GroupWorker[int, int]
) -> None:
    async def ask() -> list[int]:
        held(doubling, worker)
        answers = [worker.submit_soon(task) for task in (1, 2, 3)]
        answers[1].cancel()
        doubling.go_on.set()
        return [await answers[0], await answers[2]]

    assert asyncio.run(ask()) == [2, 6]
