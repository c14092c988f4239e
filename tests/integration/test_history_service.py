"""The history service on a real router: what happens is asked for later, over restarts and databases that go away."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from history_in_process import DEADLINE, KEYS, Teller, ask, running
from history_world import NOON
from postgres_server import PostgresServer, postgres
from sqlalchemy import create_engine, func, select
from waiting import wait_until

from services.history.database import migrate
from services.history.entries import AlertTold, Points
from services.history.spool import Spool
from services.history.tables import AlertRow, BlockRow
from shared.bus import Bus
from shared.history_query import (
    AskDwell,
    AskFlows,
    AskHeatMap,
    AskOccupancy,
    AskTrajectory,
    Dwell,
    Flows,
    HeatMap,
    OccupancySeries,
    Refusal,
    Trajectory,
    decode_answer,
    numbers,
)
from shared.messages import Erasure, ErasureDone
from shared.runner import ServiceError
from shared.site import Site, load_site
from shared.zones import ZoneDefinition

SITE = "deploy/sites/hall/site.yaml"


@pytest.fixture(scope="module")
def site(project: Path) -> Site:
    return load_site(project / SITE)


def points(bus: Bus, device: str = "d-1", until: float = 3600.0) -> int:
    answer = ask(bus, AskTrajectory(device=device, since=NOON, until=NOON + until))
    assert isinstance(answer, Trajectory), answer
    return len(numbers(answer.t))


def counted(bus: Bus, question: AskOccupancy) -> tuple[list[float | None], list[int | None]]:
    """Mean and greatest number of people of the first place."""
    answer = ask(bus, question)
    assert isinstance(answer, OccupancySeries), answer
    return answer.places[0].people, answer.places[0].most


def test_what_happens_is_told_when_it_is_asked_for(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    migrate(f"sqlite:///{tmp_path / 'history.db'}")
    with running(site, project, zenoh_router, tmp_path), Bus([zenoh_router]) as bus:
        teller = Teller(bus)
        square = [(2.0, 2.0), (18.0, 2.0), (18.0, 10.0), (2.0, 10.0)]
        teller.zones(1, [ZoneDefinition(id="round", floor="ground", points=square)])
        teller.walk(0, 60, people=24)
        wait_until(lambda: points(bus) == 60, DEADLINE, "the walk")
        teller.revise(50.0, 59.0)
        teller.alert(1, "d-1")
        teller.count(0.0, 4)
        teller.count(5.0, 6)
        wait_until(lambda: points(bus) == 51, DEADLINE, "its last ten seconds to be revised")
        hour = {"since": NOON, "until": NOON + 3600.0}
        way = ask(bus, AskTrajectory(device="d-1", **hour))
        assert isinstance(way, Trajectory)
        assert numbers(way.x)[-1] == 1.0
        assert numbers(way.track, whole=True).tolist() == [1] * 50 + [0]
        assert way.floors == ["ground"]
        thin = ask(bus, AskTrajectory(device="d-1", step=10.0, **hour))
        assert isinstance(thin, Trajectory)
        assert numbers(thin.t).tolist() == [NOON + s for s in (0, 10, 20, 30, 40, 50)]

        heat = ask(bus, AskHeatMap(floor="ground", cell=1.0, **hour))
        assert isinstance(heat, HeatMap)
        told = [value for row in heat.seconds for value in row if value is not None]
        assert heat.origin == (0.0, 0.0)
        assert (len(heat.seconds), len(heat.seconds[0])) == (12, 20)
        assert len(told) > 15
        assert sum(told) > 0.8 * 24 * 60
        assert {value for row in heat.people for value in row} <= {None, 21, 22, 23, 24}
        alone = ask(bus, AskHeatMap(floor="ground", cell=1.0, of="phones", **hour))
        assert isinstance(alone, HeatMap)
        assert all(value is None for row in alone.seconds for value in row), "one phone is no crowd"

        dwell = ask(bus, AskDwell(**hour))
        assert isinstance(dwell, Dwell)
        assert [(row.id, row.people, round(row.mean or 0.0)) for row in dwell.places] == [("round", 24, 60)]
        flows = ask(bus, AskFlows(**hour))
        assert isinstance(flows, Flows)
        assert (flows.zones, flows.counts) == (["round"], [[0]])
        asked = AskOccupancy(step=60, zones=["entrance"], since=NOON, until=NOON + 120)
        wait_until(lambda: counted(bus, asked) == ([5.0, None], [6, None]), DEADLINE, "the mean of both counts")
        assert counted(bus, AskOccupancy(of="area", step=86400, **hour)) == ([24.0], [24])


def test_a_question_that_makes_no_sense_is_told_what_is_allowed(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    migrate(f"sqlite:///{tmp_path / 'history.db'}")
    hour = {"since": NOON, "until": NOON + 3600.0}
    with running(site, project, zenoh_router, tmp_path), Bus([zenoh_router]) as bus:
        for question, field in (
            (AskHeatMap(floor="roof", **hour), "floor"),
            (AskHeatMap(floor="ground", cell=0.1, since=NOON, until=NOON), "until"),
            (AskTrajectory(device="d-1", since=NOON, until=NOON + 30 * 86400.0), "until"),
            (AskTrajectory(device="d-1", since=-1.0, until=NOON), "since"),
            (AskOccupancy(zones=["nowhere"], **hour), "zone"),
            (AskOccupancy(step=61, **hour), "step"),
            (AskDwell(places=[ZoneDefinition(id="p", floor="ground", points=[(0, 0), (1, 1)])], **hour), "places"),
        ):
            refusal = ask(bus, question)
            assert isinstance(refusal, Refusal)
            assert refusal.field == field
            assert refusal.allowed
        for payload in (b"", b"{", b'{"type": "everything"}'):
            (told,) = [answer for _, answer in bus.ask(KEYS.history(), DEADLINE, payload)]
            assert isinstance(decode_answer(told), Refusal)


def test_a_database_without_tables_is_refused_in_one_line(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    with (
        pytest.raises(ServiceError, match="has no history tables: run `atrium migrate` first"),
        running(site, project, zenoh_router, tmp_path),
    ):
        pass


def test_who_withdrew_while_history_was_down_is_gone_and_that_is_told(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path
) -> None:
    migrate(f"sqlite:///{tmp_path / 'history.db'}")
    device = "d-1"
    with Bus([zenoh_router]) as bus:
        with running(site, project, zenoh_router, tmp_path):
            teller = Teller(bus)
            teller.walk(0, 30)
            teller.alert(1, device)
            wait_until(lambda: points(bus) == 30, DEADLINE, "the walk")
        teller.until_alone()
        done = bus.inbox()
        done.subscribe(KEYS.erased(), ErasureDone, cached=True)
        bus.publisher(KEYS.erasure(device), Erasure, cached=True).publish(Erasure(t=NOON + 30, device=device))
        with running(site, project, zenoh_router, tmp_path):
            told = wait_until(lambda: done.receive(0.1), DEADLINE, "the acknowledgement")
            message = told[0].message
            assert isinstance(message, ErasureDone)
            assert (message.device, message.service) == (device, "history")
            assert points(bus) == 0
            teller.until_heard()
            teller.walk(30, 40, people=2)
            area = AskOccupancy(of="area", since=NOON, until=NOON + 3600.0)
            wait_until(lambda: counted(bus, area)[1] == [2], DEADLINE, "both people, without names")
            assert points(bus) == 0
        with running(site, project, zenoh_router, tmp_path):
            assert points(bus) == 0, "not after a restart either"
    engine = create_engine(f"sqlite:///{tmp_path / 'history.db'}")
    with engine.connect() as connection:
        assert connection.scalars(select(AlertRow.device)).all() == [None]
        assert set(connection.scalars(select(BlockRow.kind))) == {"track"}


@pytest.fixture(scope="module")
def server() -> Iterator[PostgresServer]:
    with postgres() as running_server:
        yield running_server


def stored(url: str) -> Callable[[], int]:
    engine = create_engine(url.replace("postgresql://", "postgresql+psycopg://"))

    def count() -> int:
        with engine.connect() as connection:
            return connection.scalar(select(func.count()).select_from(AlertRow)) or 0

    return count


def waiting(folder: Path) -> tuple[int, int]:
    """How many positions of devices and how many alerts wait on disk."""
    spool = Spool(folder, 10**9)
    entries = [entry for path in sorted(folder.glob("*.spool")) for entry in spool.read(path.name)[0]]
    positions = [entry.t for entry in entries if isinstance(entry, Points) and entry.kind == "device"]
    return sum(map(len, positions)), sum(isinstance(entry, AlertTold) for entry in entries)


def test_nothing_is_lost_while_postgresql_is_away(
    site: Site, project: Path, zenoh_router: str, tmp_path: Path, server: PostgresServer
) -> None:
    migrate(server.url)
    with Bus([zenoh_router]) as bus:
        with running(site, project, zenoh_router, tmp_path, server.url) as service:
            teller = Teller(bus)
            teller.walk(0, 20)
            wait_until(lambda: points(bus) == 20, DEADLINE, "the first walk")
            server.stop()
            teller.walk(20, 40)
            for number in range(50):
                teller.alert(number)
            wait_until(lambda: service.health.problems().get("database"), DEADLINE, "health to tell of it")
            assert "wait on disk meanwhile" in service.health.problems()["database"]
            refusal = ask(bus, AskTrajectory(device="d-1", since=NOON, until=NOON + 60))
            assert isinstance(refusal, Refusal)
            assert (refusal.field, "database" in refusal.words) == ("", True)
            teller.walk(40, 60)
            wait_until(lambda: waiting(tmp_path / "spool") == (40, 50), DEADLINE, "two walks and all alerts on disk")
        teller.until_alone()
        # It stops and starts again while the database is away: what waits, waits.
        with running(site, project, zenoh_router, tmp_path, server.url) as service:
            wait_until(lambda: service.health.problems().get("database"), DEADLINE, "health to tell of it again")
            teller.until_heard()
            teller.walk(60, 80)
            server.start()
            wait_until(lambda: points(bus) == 80, DEADLINE, "all four walks")
            wait_until(lambda: stored(server.url)() == 50, DEADLINE, "all alerts, once each")
            wait_until(lambda: not service.health.problems(), DEADLINE, "health to tell that all is well")
            assert list((tmp_path / "spool").glob("*.spool")) == []
