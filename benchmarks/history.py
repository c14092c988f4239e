"""How long does it take to look back into a month of a full museum?"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import msgspec
import numpy as np
from numpy.typing import NDArray
from rich.progress import Progress
from sqlalchemy import Engine, insert, text

from benchmarks.experiment import Experiment, ExperimentError, Figures, Options
from benchmarks.twin_speed import peak_memory
from benchmarks.world_run import load
from services.history.blocks import encode
from services.history.database import migrate, open_history
from services.history.desk import Desk, zones_of_site
from services.history.entries import Points
from services.history.store import Store
from services.history.tables import BlockRow, OccupancyRow
from shared.history_query import (
    AskDwell,
    AskFlows,
    AskHeatMap,
    AskOccupancy,
    AskTrajectory,
    HeatMap,
    HistoryQuestion,
    OccupancySeries,
    Refusal,
    Trajectory,
    decode_answer,
    numbers,
)
from shared.runner import ServiceError
from shared.site import Site

__all__ = ["EXPERIMENT", "fill", "main", "walks"]

DAYS, HOURS, PEOPLE = 30, 12, 100
FIRST_MINUTE = 29_453_820
"""1 January 2026, 9:00 UTC."""
DAY_MINUTES = 1440
TRIES = 20
"""Different devices and days that are asked for; of sums over a day a quarter of it."""
ROWS_AT_ONCE = 5000
WRITTEN_SECONDS = 60


def walks(site: Site, people: int, minutes: int, rng: np.random.Generator) -> NDArray[np.int32]:
    """Return where people are every second of a day, as blocks: shape (people, minutes, 7, 60).

    Everybody goes from one random place of the floor to the next at 0.3 to 1.4 m/s and stays there for a while, with a
    few centimetres of noise; ids and names are filled in elsewhere.
    """
    bounds = site.floors[0].plan().outline.bounds
    seconds = minutes * 60
    blocks = np.zeros((people, minutes, 7, 60), np.int32)
    blocks[:, :, 0] = 1000 * np.arange(60)
    for person in range(people):
        stops = seconds // 40 + 2
        places = rng.uniform(bounds[:2], bounds[2:], (stops, 2))
        legs = np.linalg.norm(np.diff(places, axis=0), axis=1) / rng.uniform(0.3, 1.4, stops - 1)
        stays = rng.exponential(45.0, stops)
        arrive = np.concatenate([[0.0], np.cumsum(legs + stays[:-1])])
        times = np.column_stack([arrive, arrive + stays]).ravel()
        at = np.repeat(places, 2, axis=0)
        where = np.column_stack([np.interp(np.arange(seconds), times, at[:, axis]) for axis in (0, 1)])
        where += rng.normal(0.0, 0.05, where.shape)
        blocks[person, :, 1:3] = np.rint(100.0 * where.reshape(minutes, 60, 2).transpose(0, 2, 1))
        blocks[person, :, 3] = rng.integers(8, 20, (minutes, 60))
        blocks[person, :, 4] = rng.integers(950, 1000, (minutes, 60))
        blocks[person, :, 5] = person + 1
    return blocks


def fill(engine: Engine, site: Site, days: int, hours: int, people: int, rng: np.random.Generator) -> Iterator[int]:
    """Store so many days, the same walks under other names each; yields the number of each day that is in."""
    floor = site.floors[0].id
    area = next(area.id for area in site.areas if area.floor == floor)
    payloads = [[encode(block) for block in person] for person in walks(site, people, 60 * hours, rng)]
    for day in range(days):
        rows = [
            {
                "kind": kind,
                "subject": f"d-{day:02d}-{person:03d}" if kind == "device" else str(person + 1),
                "minute": FIRST_MINUTE + DAY_MINUTES * day + minute,
                "area": area,
                "floor": floor,
                "step": 1.0,
                "points": payloads[person][minute],
                "tracks": f"{person + 1}:60" if kind == "device" else "",
            }
            for minute in range(60 * hours)
            for person in range(people)
            for kind in ("device", "track")
        ]
        counts = [
            {
                "kind": "zone",
                "place": zone.id,
                "minute": FIRST_MINUTE + DAY_MINUTES * day + minute,
                "counts": 12,
                "people": 12 * int(rng.integers(0, 30)),
                "most": 30,
                "phones": 60,
            }
            for minute in range(60 * hours)
            for zone in site.zones
        ]
        with engine.begin() as connection:
            for start in range(0, len(rows), ROWS_AT_ONCE):
                connection.execute(insert(BlockRow), rows[start : start + ROWS_AT_ONCE])
            if counts:
                connection.execute(insert(OccupancyRow), counts)
        yield day


def written(engine: Engine, site: Site, people: int) -> float:
    """Return the seconds it takes to write a second of everybody, five seconds at once as the service does."""
    store, floor, area = Store(engine), site.floors[0].id, site.areas[0].id
    begin = 60.0 * (FIRST_MINUTE - 2 * DAY_MINUTES)
    names = [f"written-{number}" for number in range(WRITTEN_SECONDS // 5)]
    began = time.perf_counter()
    for number, name in enumerate(names):
        entries = [
            Points(
                kind=kind,
                area=area,
                step=1.0,
                subject=[f"{kind[0]}-{person}" for person in range(people)],
                floor=[floor] * people,
                t=[begin + 5 * number + second] * people,
                x=[0.01 * person + 0.3 * second for person in range(people)],
                y=[1.0] * people,
                accuracy=[0.1] * people,
                probability=[0.9] * people,
                track=list(range(people)),
                state=[0] * people,
            )
            for second in range(5)
            for kind in ("device", "track")
        ]
        store.apply(name, entries, names)
    return (time.perf_counter() - began) / WRITTEN_SECONDS


def run(options: Options, progress: Progress) -> Figures:
    """Fill a database, ask it."""
    more = options.more
    _, site = load(options.scenario)
    rng = np.random.default_rng(options.seed)
    with tempfile.TemporaryDirectory(prefix="atrium-history-") as folder:
        url = more.database or f"sqlite:///{Path(folder) / 'history.db'}"
        try:
            migrate(url)
            engine = open_history(url)
        except ServiceError as error:
            raise ExperimentError(f"--database: {error}") from error
        task = progress.add_task("storing days", total=more.days)
        began = time.perf_counter()
        for _ in fill(engine, site, more.days, more.hours, more.people, rng):
            progress.advance(task)
        filled = time.perf_counter() - began
        asking = progress.add_task("asking", total=1)
        figures = _asked(engine, site, more, rng)
        progress.advance(asking)
        positions = 2.0 * more.days * more.hours * 3600 * more.people
        figures |= {
            "positions": positions,
            "bytes_per_position": _size(engine, Path(folder)) / positions,
            "fill_s": filled,
            "write_second_ms": 1000.0 * written(engine, site, more.people),
            "memory_mb": peak_memory(),
        }
        engine.dispose()
    return figures


def _asked(engine: Engine, site: Site, more: argparse.Namespace, rng: np.random.Generator) -> dict[str, float | None]:
    floor = site.floors[0].id

    def day(number: int) -> float:
        return 60.0 * (FIRST_MINUTE + DAY_MINUTES * number) - 9 * 3600.0

    chosen = [(int(rng.integers(more.days)), int(rng.integers(more.people))) for _ in range(TRIES)]
    some = sorted({number for number, _ in chosen})[: max(TRIES // 4, 1)]
    expected = more.hours * 3600
    ways = [
        AskTrajectory(device=f"d-{number:02d}-{person:03d}", since=day(number), until=day(number + 1))
        for number, person in chosen
    ]
    heat = [AskHeatMap(floor=floor, since=day(number), until=day(number + 1)) for number in some]
    dwell = [AskDwell(since=day(number), until=day(number + 1)) for number in some]
    flows = [AskFlows(since=day(number), until=day(number + 1)) for number in some]
    month = [AskOccupancy(step=3600, since=day(0), until=day(more.days))] * 3

    def whole_way(answer: object) -> bool:
        return isinstance(answer, Trajectory) and len(numbers(answer.t)) == expected

    def known_heat(answer: object) -> bool:
        return isinstance(answer, HeatMap) and any(value for row in answer.seconds for value in row)

    def desk() -> Desk:
        return Desk(engine, site, lambda: zones_of_site(site))

    took = {
        "device_day": _took(desk, ways, whole_way),
        "heat_map_day": _took(desk, heat, known_heat),
        "dwell_day": _took(desk, dwell),
        "flows_day": _took(desk, flows),
        "occupancy_month": _took(desk, month, lambda answer: isinstance(answer, OccupancySeries)),
    }
    figures: dict[str, float | None] = {}
    for name, seconds in took.items():
        figures[f"{name}_ms"] = 1000.0 * float(np.median(seconds))
        figures[f"{name}_worst_ms"] = 1000.0 * float(seconds.max())
    return figures


def _took(
    new_desk: Callable[[], Desk], questions: Sequence[HistoryQuestion], right: Callable[[object], bool] = lambda _: True
) -> NDArray[np.float64]:
    """Return the seconds from each question to its answer as it would leave for the bus; checks what it holds.

    Each is asked at a desk of its own, which remembers no sums of days.
    """
    seconds = []
    for question in questions:
        payload = msgspec.json.encode(question)
        desk = new_desk()
        began = time.perf_counter()
        told = desk.answer(payload)
        seconds.append(time.perf_counter() - began)
        answer = decode_answer(told)
        if isinstance(answer, Refusal) or not right(answer):
            raise ExperimentError(f"a wrong answer to {type(question).__name__}: {str(answer)[:200]}")
    return np.array(seconds)


def _size(engine: Engine, folder: Path) -> float:
    if engine.dialect.name == "sqlite":
        return float(sum(path.stat().st_size for path in folder.iterdir()))
    with engine.connect() as connection:
        return float(connection.scalar(text("SELECT pg_total_relation_size('history_blocks')")) or 0)


def _arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--days", type=int, default=DAYS, help=f"default {DAYS}")
    parser.add_argument("--hours", type=int, default=HOURS, help=f"of opening a day, default {HOURS}")
    parser.add_argument("--people", type=int, default=PEOPLE, help=f"inside at a time, default {PEOPLE}")
    parser.add_argument("--database", help="an empty database's URL, such as a PostgreSQL server's; default SQLite")


EXPERIMENT = Experiment(
    name="history",
    question="How long does it take to look back into a month of a full museum?",
    kind="speed",
    scenario="museum",
    seed=1,
    run=run,
    made="""A month is stored in SQLite: 100 people inside at a time for 12 hours a day, each with a phone, one position
a second under the name and one under the track, and the counts of each zone by the minute. The walks are random ways on
the museum's floor with a few centimetres of noise, the same every day under other names. Asked are the answers as they
leave for the bus, packed: a day of one device (20 of different days), a heat map of a day with cells of half a metre,
dwell and flows of a day, occupancy of the month by the hour. `write_second_ms` is the time to write a second of
everybody, name and track, five seconds at once as the service does. Nothing is remembered from one question to the
next; files are read through the system's cache.""",
    at_most={"device_day_ms": 100.0, "heat_map_day_ms": 2000.0},
    arguments=_arguments,
)


def main() -> int:
    """Run, print, write."""
    return EXPERIMENT.main()


if __name__ == "__main__":
    sys.exit(main())
