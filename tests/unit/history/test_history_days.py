"""A period is the sum of its local days; days that are over are summed once, others each time."""

import datetime
from pathlib import Path
from zoneinfo import ZoneInfo

import msgspec
import pytest
from history_world import bring_in, frame, fresh
from sqlalchemy import Engine

from services.history import desk as desk_module
from services.history.day_sums import DaySums
from services.history.desk import Desk
from services.history.sampling import Sampler
from shared.history_query import AskDwell, AskHeatMap, Dwell, HeatMap, HistoryAnswer, HistoryQuestion, decode_answer
from shared.site import Site, load_site
from shared.zones import ZoneDefinition

ROME = ZoneInfo("Europe/Rome")
SQUARE = ZoneDefinition(id="square", floor="ground", points=[(0.0, 0.0), (4.0, 0.0), (4.0, 4.0), (0.0, 4.0)])


def local(day: int, hour: int) -> float:
    return datetime.datetime(2026, 7, day, hour, tzinfo=ROME).timestamp()


@pytest.fixture
def site(project: Path) -> Site:
    return load_site(project / "deploy/sites/hall/site.yaml").model_copy(update={"time_zone": "Europe/Rome"})


def filled(folder: Path, people: int) -> Engine:
    """Three days on which the same track numbers stood in one place for twenty seconds."""
    engine = fresh(folder)
    sampler = Sampler(1.0, {"hall": "ground"})
    entries = []
    for day in (1, 2, 3):
        for second in range(20):
            rows = [(track, 1.0, 1.0, None) for track in range(people)]
            entries += sampler.tracks(frame(local(day, 12) + second, rows))
    bring_in(engine, entries)
    return engine


def ask(desk: Desk, question: HistoryQuestion) -> HistoryAnswer:
    return decode_answer(desk.answer(msgspec.json.encode(question)))


def test_a_track_s_number_is_somebody_else_the_next_day_and_days_that_are_over_are_read_once(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine, now = filled(tmp_path, 25), [local(3, 13)]
    desk = Desk(engine, site, lambda: [SQUARE], lambda: now[0])
    read: list[float] = []
    real = desk_module.parts_of

    def parts_of(engine: Engine, kind: str, since: float, until: float, floor: str | None = None) -> object:
        read.append(since)
        return real(engine, kind, since, until, floor)

    monkeypatch.setattr(desk_module, "parts_of", parts_of)
    heat = AskHeatMap(floor="ground", since=local(1, 0), until=local(3, 13), cell=2.0)
    dwell = AskDwell(since=local(1, 0), until=local(3, 13))
    for _ in range(2):
        told = ask(desk, heat)
        assert isinstance(told, HeatMap)
        assert (told.people[0][0], told.seconds[0][0]) == (75, 1500.0)
        assert {value for row in told.people for value in row} == {75, None}
        stays = ask(desk, dwell)
        assert isinstance(stays, Dwell)
        assert (stays.places[0].people, stays.places[0].mean) == (75, 20.0)
    assert [read.count(local(day, 0)) for day in (1, 2, 3)] == [2, 2, 4]


def test_few_people_a_day_are_too_few_however_many_days(site: Site, tmp_path: Path) -> None:
    desk = Desk(filled(tmp_path, 24), site, lambda: [SQUARE], lambda: local(3, 13))
    told = ask(desk, AskHeatMap(floor="ground", since=local(1, 0), until=local(4, 0), cell=2.0))
    assert isinstance(told, HeatMap)
    assert told.people[0][0] is None, "who sits there every day would be told of alone"
    stays = ask(desk, AskDwell(since=local(1, 0), until=local(4, 0)))
    assert isinstance(stays, Dwell)
    assert stays.places[0].people is None


def test_two_periods_that_differ_by_seconds_tell_the_same(site: Site, tmp_path: Path) -> None:
    """The difference of two sums would tell of one person what neither tells."""
    desk = Desk(filled(tmp_path, 25), site, lambda: [SQUARE], lambda: local(3, 13))
    answers = {
        desk.answer(msgspec.json.encode(AskHeatMap(floor="ground", since=begin, until=end, cell=2.0)))
        for begin, end in ((local(2, 12), local(2, 12) + 11.0), (local(2, 12) + 7.0, local(2, 12) + 899.0))
    }
    (told,) = map(decode_answer, answers)
    assert isinstance(told, HeatMap)
    assert told.seconds[0][0] == 500.0


def test_sums_of_days_are_made_anew_after_a_while_and_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    now, made = [10_000.0], []

    def get(key: str, until: float) -> str:
        return DAYS.get(key, until, lambda _: 40, lambda: made.append(key) or key)

    monkeypatch.setattr("services.history.day_sums.MOST_BYTES", 100)
    DAYS = DaySums(lambda: now[0])  # noqa: N806
    for _ in range(3):
        get("over", 1000.0)
        get("just over", 9900.0)
    assert made == ["over", "just over", "just over", "just over"]
    now[0] += 4000.0
    get("over", 1000.0)
    assert made.count("over") == 2
    for key in ("a", "b", "over"):
        get(key, 1000.0)
    assert made.count("over") == 3, "the oldest gave way"
