"""Alerts and webhooks as rows, on SQLite and on a real PostgreSQL."""

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path

import msgspec
import pytest
from postgres_server import postgres
from sqlalchemy import Engine, text
from test_api_state import alert

from services.api.alerts.alert_desk import AlertDesk
from services.api.alerts.database import SCHEMA, migrate, open_alerts
from services.api.alerts.event_numbers import BLOCK, EventNumbers
from services.api.alerts.inbox import FORGOTTEN, AcknowledgedError, AlertInbox, Told, Wanted
from services.api.alerts.webhook_replies import WebhookDefinition
from services.api.alerts.webhook_store import TooManyError, WebhookStore
from services.api.pseudonyms import Pseudonyms
from shared.messages import Alert
from shared.runner import ServiceError

ANY = Wanted()


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    with postgres() as running:
        migrate(running.url)
        yield running.url


@pytest.fixture(params=["sqlite", "postgresql"])
def engine(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Engine]:
    if request.param == "sqlite":
        url = f"sqlite:///{tmp_path / 'alerts.db'}"
        migrate(url)
    else:
        url = request.getfixturevalue("server")
    opened = open_alerts(url)
    assert SCHEMA.problem(opened) is None
    with opened.begin() as connection:
        for table in ("deliveries", "webhooks", "alerts", "event_numbers"):
            connection.execute(text(f"DELETE FROM api_{table}"))
    yield opened
    opened.dispose()


def told(one: Alert) -> Told:
    """An alert that was sent when it was measured, under an event of ten times its number."""
    return Told(one, one.t, int(10 * one.t))


def inbox_of(engine: Engine, *alerts: Alert, most: int = 1000) -> AlertInbox:
    inbox = AlertInbox(engine, most, 100.0)
    inbox.add([told(one) for one in alerts])
    return inbox


def ids(found: list[object]) -> list[str]:
    return [one.id for one in found]  # type: ignore[attr-defined]


def test_alerts_come_newest_first_page_by_page_and_in_the_order_they_came(engine: Engine) -> None:
    inbox = inbox_of(engine, alert(10), alert(8), alert(9, "model-corner"), alert(9, "model-corner"), alert(11))
    assert ids(inbox.newest(ANY, 10)) == ["a-11", "a-10", "a-9", "a-8"]
    assert ids(inbox.newest(ANY, 2, before="a-10")) == ["a-9", "a-8"]
    assert ids(inbox.newest(ANY, 2, before="a-8")) == []
    assert ids(inbox.arrived(ANY, 10, "")) == ["a-10", "a-8", "a-9", "a-11"], "told late is missed by nobody"
    assert ids(inbox.arrived(ANY, 2, "a-10")) == ["a-8", "a-9"]
    for ask in (lambda: inbox.newest(ANY, 2, "gone"), lambda: inbox.arrived(ANY, 2, "gone"), lambda: inbox.one("gone")):
        with pytest.raises(KeyError):
            ask()
    assert inbox.newest_ids(2) == ["a-9", "a-11"]
    assert [each.event for each in inbox.told_between(80, 110, 9)] == [90, 100]
    assert (inbox.event_of("a-8"), inbox.event_of("gone")) == (80, None)


def test_alerts_of_one_time_are_on_one_page_each(engine: Engine) -> None:
    inbox = inbox_of(engine, *[msgspec.structs.replace(alert(1), id=f"same-{n}") for n in range(5)])
    seen: list[str] = []
    while page := inbox.newest(ANY, 2, seen[-1] if seen else None):
        seen += ids(page)
    assert sorted(seen) == [f"same-{n}" for n in range(5)]


def test_every_filter_leaves_out_what_does_not_match(engine: Engine) -> None:
    met = msgspec.structs.replace(alert(3), kind="proximity", device="p", other_device="q")
    inbox = inbox_of(engine, alert(1), alert(2, "model-corner"), met)
    inbox.acknowledge("a-1", "guard", "", 50.0)
    assert ids(inbox.newest(Wanted(since=1.0), 9)) == ["a-3", "a-2"]
    assert ids(inbox.newest(Wanted(until=2.0), 9)) == ["a-2", "a-1"]
    assert ids(inbox.newest(Wanted(zone="entrance"), 9)) == ["a-3", "a-1"]
    assert ids(inbox.newest(Wanted(area="yard"), 9)) == []
    assert [ids(inbox.newest(Wanted(device=name), 9)) for name in ("p", "q", "r")] == [["a-3"], ["a-3"], []]
    assert ids(inbox.newest(Wanted(kinds=("proximity", "crowd")), 9)) == ["a-3"]
    assert ids(inbox.newest(Wanted(acknowledged=True), 9)) == ["a-1"]
    assert ids(inbox.newest(Wanted(acknowledged=False), 9)) == ["a-3", "a-2"]
    injected = "x' OR '1'='1"
    assert ids(inbox.newest(Wanted(zone=injected, device=injected, kinds=(injected,)), 9)) == []


def test_the_first_who_acknowledges_counts(engine: Engine) -> None:
    inbox = inbox_of(engine, alert(1))
    note = "<script>alert(1)</script>'; DROP TABLE api_alerts; --"
    seen = inbox.acknowledge("a-1", "guard", note, 50.0).acknowledged
    assert seen is not None
    assert (seen.by, seen.at, seen.note) == ("guard", 50.0, note)
    with pytest.raises(AcknowledgedError, match="acknowledged by guard"):
        inbox.acknowledge("a-1", "curator", "", 60.0)
    with pytest.raises(KeyError):
        inbox.acknowledge("a-2", "guard", "", 50.0)
    assert inbox.one("a-1").acknowledged == seen


def test_of_many_who_acknowledge_at_once_one_is_told_that_they_were_first(engine: Engine) -> None:
    inbox = inbox_of(engine, *[alert(n) for n in range(10)])
    together = threading.Barrier(6)

    def acknowledge(who: str, first: list[str]) -> None:
        together.wait()
        for number in range(10):
            with contextlib.suppress(AcknowledgedError):
                inbox.acknowledge(f"a-{number}", who, "", 50.0)
                first.append(f"a-{number} {who}")

    first: list[str] = []
    guards = [threading.Thread(target=acknowledge, args=(f"guard {n}", first)) for n in range(6)]
    for guard in guards:
        guard.start()
    for guard in guards:
        guard.join()
    assert sorted(first) == [f"a-{n} {inbox.one(f'a-{n}').acknowledged.by}" for n in range(10)]  # type: ignore[union-attr]


def test_what_is_too_old_or_too_much_is_deleted(engine: Engine) -> None:
    inbox = inbox_of(engine, *[alert(n) for n in range(6)], most=3)
    inbox.forget(now=102.5)
    assert ids(inbox.newest(ANY, 9)) == ["a-5", "a-4", "a-3"]
    inbox.forget(now=104.5)
    assert ids(inbox.newest(ANY, 9)) == ["a-5"]


def test_a_withdrawn_device_is_out_of_what_was_told_before_and_stays_out_of_webhooks(engine: Engine) -> None:
    store = WebhookStore(engine, 10, 10, 100.0)
    store.create(WebhookDefinition(url="https://host/"), "office", 0.0)
    inbox = AlertInbox(engine, 100, 100.0, store.enqueue)
    erased: list[str] = []
    pseudonyms = Pseudonyms()
    pseudonyms.add("q")
    desk = AlertDesk(engine, inbox, lambda _: None, lambda: None, erased.append, pseudonyms.without)
    met = msgspec.structs.replace(alert(1), device="p", other_device="q")
    assert desk.is_new(met)
    assert not desk.is_new(met), "known already"
    assert not desk.is_new(msgspec.structs.replace(alert(2), zone="no zone\0"))
    desk.write_down(told(met))
    desk.write()
    inbox.acknowledge("a-1", "office", "asked q to wait.", 50.0)
    desk.erase("q")
    desk.write()
    one = inbox.one("a-1")
    assert (one.device, one.other_device, erased) == ("p", None, ["q"])
    assert one.acknowledged is not None
    assert one.acknowledged.note == f"asked {pseudonyms.of('q')} to wait."
    assert inbox.newest(Wanted(device="q"), 9) == []
    (due,) = store.due(1e12, {}, 4, set())
    assert due.alert.other_device is None


def test_while_the_database_is_away_alerts_wait_in_order(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path / 'alerts.db'}"
    migrate(url)
    engine = open_alerts(url)
    inbox = AlertInbox(engine, 100, 1e12)
    heard: list[str | None] = []
    stopping = threading.Event()

    def tell(reason: str | None) -> None:
        heard.append(reason)
        if reason is not None and sum(each is not None for each in heard) == 1:
            with engine.begin() as connection:  # the table is back
                connection.execute(text("ALTER TABLE gone RENAME TO api_alerts"))
        elif reason is None and len(inbox.newest(ANY, 9)) == 3:
            stopping.set()

    desk = AlertDesk(engine, inbox, tell, lambda: None, lambda _: None)
    with engine.begin() as connection:
        connection.execute(text("ALTER TABLE api_alerts RENAME TO gone"))
    for number in (1, 2, 3):
        assert desk.is_new(alert(number))
        desk.write_down(told(alert(number)))
    desk.run(stopping)
    assert "api_alerts" in str(heard[0])
    assert ids(inbox.arrived(ANY, 9, "")) == ["a-1", "a-2", "a-3"]
    again = AlertDesk(engine, inbox, tell, lambda: None, lambda _: None)
    again.remember()
    assert not again.is_new(alert(2)), "a restart does not tell it again"


def test_a_webhook_gets_what_it_asked_for_and_what_failed_waits_or_dies(engine: Engine) -> None:
    store = WebhookStore(engine, 2, 10, 100.0)
    inbox = AlertInbox(engine, 100, 1e12, store.enqueue)
    inbox.add([told(alert(4))])
    # The clock is set back after that: what counts is the order in which things were written.
    every = store.create(WebhookDefinition(url="https://host/every"), "office", 1e9)
    some = store.create(WebhookDefinition(url="https://host/some", kinds=["exit"], zones=["nave"]), "office", 5.0)
    with pytest.raises(TooManyError, match="there are 2 webhooks"):
        store.create(WebhookDefinition(url="https://host/"), "office", 5.0)
    left = msgspec.structs.replace(alert(8, "nave"), kind="exit")
    inbox.add([told(alert(6)), told(alert(7, "nave")), told(left)])
    inbox.add([told(alert(6))])
    due = store.due(1e12, {}, 9, set())
    assert [(each.url[-5:], each.alert.id) for each in due] == [
        ("every", "a-6"),
        ("every", "a-7"),
        ("every", "a-8"),
        ("/some", "a-8"),
    ]
    assert [each.alert.id for each in store.due(1e12, {every.id: 1, some.id: 0}, 4, {due[0].delivery})] == ["a-7"]
    store.delivered(due[0], 10.0)
    store.failed(due[1], 10.0, "answered 500", again=2e12)
    store.failed(due[2], 10.0, "answered \x00500", again=None)
    assert [each.delivery for each in store.due(1e12, {}, 9, set())] == [due[3].delivery]
    now = store.one(every.id)
    assert (now.waiting, now.dead, now.delivered, now.failed, now.last_reason) == (1, 1, 1, 2, "answered  500")
    (letter,) = store.dead(every.id, 0, 10)
    assert (letter.alert.id, letter.attempts, letter.reason) == ("a-8", 1, "answered  500")
    assert store.replay(every.id, letter.id + 1000, 11.0) == 0
    assert store.replay(every.id, None, 11.0) == 1
    assert [(d.alert.id, d.attempts) for d in store.due(12.0, {}, 9, set()) if d.webhook == every.id] == [("a-8", 0)]
    store.change(some.id, WebhookDefinition(url="https://host/some", enabled=False))
    assert all(each.webhook == every.id for each in store.due(1e12, {}, 9, set()))
    store.delete(every.id)
    assert [hook.id for hook in store.all()] == [some.id]
    assert store.due(1e12, {}, 9, set()) == []
    for ask in (
        store.one,
        store.delete,
        lambda name: store.dead(name, 0, 1),
        lambda name: store.replay(name, None, 1.0),
    ):
        with pytest.raises(KeyError):
            ask(every.id)


def test_what_waits_for_a_receiver_that_is_away_has_a_bound(engine: Engine) -> None:
    store = WebhookStore(engine, 2, 3, 100.0)
    inbox = AlertInbox(engine, 100, 1e12, store.enqueue)
    hook = store.create(WebhookDefinition(url="https://host/"), "office", 0.0)
    inbox.add([told(alert(n)) for n in range(5)])
    assert (store.one(hook.id).waiting, store.one(hook.id).dead) == (3, 2)
    assert [letter.reason for letter in store.dead(hook.id, 0, 9)] == ["more than 3 alerts were waiting"] * 2
    store.forget(now=1e12)
    assert store.one(hook.id).dead == 0


def test_what_waits_is_a_dead_letter_once_the_inbox_forgets_it_and_goes_out_again_as_room_allows(
    engine: Engine,
) -> None:
    store = WebhookStore(engine, 2, 4, 100.0)
    inbox = AlertInbox(engine, 2, 1e12, store.enqueue)
    hook = store.create(WebhookDefinition(url="https://host/"), "office", 0.0)
    for numbers in (range(4), range(4, 5)):
        inbox.add([told(alert(n)) for n in numbers])
        inbox.forget(now=50.0)
    assert [letter.alert.id for letter in store.dead(hook.id, 0, 9)] == ["a-0", "a-1", "a-2"]
    assert {letter.reason for letter in store.dead(hook.id, 0, 9)} == {FORGOTTEN}
    assert store.replay(hook.id, None, 60.0) == 2, "four may wait"
    assert [due.alert.id for due in store.due(60.0, {}, 9, set())] == ["a-0", "a-1"]
    assert store.replay(hook.id, store.dead(hook.id, 0, 1)[0].id, 60.0) == 0
    inbox.add([told(alert(n)) for n in range(5, 11)])
    store.forget(now=100.0)
    assert [letter.alert.id for letter in store.dead(hook.id, 0, 9)] == [f"a-{n}" for n in range(7, 11)]
    store.forget(now=1e12)
    assert store.one(hook.id).dead == 0
    for due in store.due(1e13, {}, 9, set()):
        store.delivered(due, 1e13)
    inbox.forget(now=50.0)
    assert ids(inbox.newest(ANY, 9)) == ["a-10", "a-9"], "an alert that nothing waits for goes"


def test_no_event_has_an_id_that_one_before_had_whatever_the_clock_says(engine: Engine) -> None:
    inbox_of(engine, alert(10))
    assert EventNumbers(engine, 0.0).first == 101, "above what an older version told"
    numbers = EventNumbers(engine, 2e6)
    assert numbers.first == int(2e12)
    numbers.keep(numbers.first + 7)
    assert EventNumbers(engine, 1e6).first > numbers.first + 7
    busy = EventNumbers(engine, 1e6)
    busy.keep(busy.first + BLOCK - 1)
    assert EventNumbers(engine, 1e6).first > busy.first + BLOCK


def test_the_api_has_its_tables_where_its_setting_says_and_says_so_when_it_has_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from services.api.settings import default_api_database_url

    monkeypatch.delenv("ATRIUM_API_DATABASE_URL", raising=False)
    monkeypatch.setenv("ATRIUM_DATABASE_URL", f"sqlite:///{tmp_path / 'one.db'}")
    assert default_api_database_url().endswith("one.db")
    monkeypatch.setenv("ATRIUM_API_DATABASE_URL", f"sqlite:///{tmp_path / 'two.db'}")
    opened = open_alerts(default_api_database_url())
    assert "run `atrium migrate` first" in str(SCHEMA.problem(opened))
    migrate(default_api_database_url())
    migrate(default_api_database_url())
    assert SCHEMA.problem(opened) is None
    opened.dispose()
    with pytest.raises(ServiceError, match=r"api_database_url: .*allowed: sqlite:///FILE"):
        open_alerts("nonsense")
