"""Models as rows: one decision, one transaction; what is live is never in doubt."""

from pathlib import Path

import msgspec
import numpy as np
import pytest
from learning_models import power_of, radio, stride
from sqlalchemy import Engine, event, inspect, select
from sqlalchemy.orm import Session
from typer.testing import CliRunner

from services.cli.main import app
from services.gateway.devices.database import schema_problem as gateway_problem
from services.learning.activation.database import SCHEMA, in_memory, migrate, open_learning
from services.learning.activation.rows import KEPT_MODELS, Decided
from services.learning.activation.store import ModelStore, NoSuchModelError, NothingBeforeError
from services.learning.activation.tables import Base, DecisionRow, LearnerRow, ModelRow
from shared.messages import RadioModelUpdate, StrideModel, encode
from shared.runner import ServiceError


@pytest.fixture
def engine(tmp_path: Path) -> Engine:
    url = f"sqlite:///{tmp_path / 'learning.db'}"
    migrate(url)
    return open_learning(url)


@pytest.fixture
def store(engine: Engine) -> ModelStore:
    return ModelStore(engine)


def how(t: float = 100.0, reason: str = "wins", **more: object) -> Decided:
    return Decided(t, t - 5.0, reason, **more)  # type: ignore[arg-type]


def activate(store: ModelStore, power: float, t: float = 100.0) -> int:
    return store.activate(radio(power=power), "radio", "hall", "hall", how(t)).version


def test_the_migration_makes_the_very_tables_the_program_uses(engine: Engine) -> None:
    made = inspect(engine)
    for table in Base.metadata.sorted_tables:
        columns = {column["name"]: column["nullable"] for column in made.get_columns(table.name)}
        assert columns == {column.name: column.nullable for column in table.columns}, table.name
    assert "alembic_version_learning" in made.get_table_names()
    assert SCHEMA.problem(engine) is None
    assert "has no learning tables: run `atrium migrate` first" in str(SCHEMA.problem(open_learning("sqlite://")))


def test_a_database_that_cannot_be_used_is_named_with_its_setting() -> None:
    with pytest.raises(ServiceError, match=r"learning_database_url: .*allowed: sqlite:///FILE"):
        open_learning("nonsense")


def test_a_model_that_goes_live_is_numbered_and_the_one_before_is_superseded(store: ModelStore) -> None:
    assert store.active("radio", "hall") is None
    assert [activate(store, -40.0), activate(store, -41.0, 200.0)] == [1, 2]
    live = store.active("radio", "hall")
    assert live is not None
    assert (live.version, live.replaced, live.probation, live.decided, live.since) == (2, 1, True, 200.0, 195.0)
    assert isinstance(live.model, RadioModelUpdate)
    assert (live.model.version, live.model.t, live.model.reason) == (2, 200.0, "wins")
    assert [(one.version, one.state) for one in store.models()] == [(2, "active"), (1, "superseded")]
    assert power_of(store.before(live)) == -40.0


def test_numbers_of_numpy_are_stored_like_any_others(store: ModelStore) -> None:
    ruled = how(gain=np.float64(0.25), margin=np.float64(0.1), evidence={"error before": np.float32(0.5)})
    store.activate(radio(power=-40.0), "radio", "hall", "hall", ruled)
    [told] = store.history()
    assert (told.gain, told.margin, told.evidence) == (0.25, 0.1, {"error before": 0.5})


def test_a_roll_back_is_a_new_version_of_the_model_before_and_the_next_goes_one_further(store: ModelStore) -> None:
    for power in (-40.0, -41.0, -42.0):
        activate(store, power)
    assert power_of(store.roll_back("radio", "hall", how(300.0, "worse")).model) == -41.0
    back = store.roll_back("radio", "hall", how(400.0, "worse still", by="operator"))
    assert (back.version, power_of(back.model), back.probation) == (5, -40.0, False)
    configured = store.roll_back("radio", "hall", how(500.0, "all of it"))
    assert (configured.version, power_of(configured.model)) == (6, None)
    told = store.history()
    assert [one.decision for one in told] == ["rolled back"] * 3 + ["activated"] * 3
    assert (told[1].by, told[1].reason) == ("operator", "worse still")


def test_a_model_made_live_by_hand_is_one_step_back_like_any_other(store: ModelStore) -> None:
    for power in (-40.0, -41.0, -42.0):
        activate(store, power)
    store.promote(store.get("radio", "hall", 2), how(by="operator"))
    powers = [power_of(store.roll_back("radio", "hall", how()).model) for _ in range(4)]
    assert powers == [-42.0, -41.0, -40.0, None]
    with pytest.raises(NothingBeforeError, match="radio of 'hall' is as configured already; allowed: none now"):
        store.roll_back("radio", "hall", how())


def test_the_way_back_passes_over_what_nobody_could_use(engine: Engine, store: ModelStore) -> None:
    for power in (-40.0, -41.0, -42.0):
        activate(store, power)
    with Session(engine) as session, session.begin():
        row = session.scalars(select(ModelRow).where(ModelRow.version == 2)).one()
        row.payload = encode(radio(power=1e6))
    assert power_of(store.roll_back("radio", "hall", how()).model) == -40.0
    assert power_of(store.roll_back("radio", "hall", how()).model) is None


def test_a_decision_of_a_newer_program_is_passed_over(engine: Engine, store: ModelStore) -> None:
    activate(store, -40.0)
    activate(store, -41.0)
    with Session(engine) as session, session.begin():
        row = session.scalars(select(DecisionRow)).first()
        assert row is not None
        row.told = row.told.replace('"activated"', '"merged"')
    assert [one.version for one in store.history()] == [2]


def test_without_a_live_model_a_roll_back_says_what_there_is(store: ModelStore) -> None:
    activate(store, -40.0)
    with pytest.raises(NoSuchModelError, match="no radio model of 'east' is active; allowed: hall"):
        store.roll_back("radio", "east", how())


def test_what_takes_a_stride_back_is_the_line_of_nobody(store: ModelStore) -> None:
    store.activate(stride(), "stride", "d-1", "hall", how())
    back = store.roll_back("stride", "d-1", how())
    assert isinstance(back.model, StrideModel)
    assert (back.model.slope, back.model.offset, back.model.version) == (0.0, 0.0, 2)


def test_a_refused_model_keeps_its_number_and_does_not_go_live(store: ModelStore) -> None:
    evidence = {"gain": 0.1, "nothing": float("nan")}
    refused = store.refuse(radio(), "radio", "hall", "hall", how(evidence=evidence, gain=-0.1, margin=0.01))
    assert (refused.version, refused.state) == (1, "refused")
    assert store.active("radio", "hall") is None
    assert activate(store, -40.0) == 2
    told = store.history()[-1]
    assert (told.decision, told.gain, told.margin, told.evidence) == ("refused", -0.1, 0.01, {"gain": 0.1})


def test_history_and_models_are_bounded_and_the_way_back_is_kept(store: ModelStore) -> None:
    activate(store, -40.0)
    activate(store, -41.0)
    for number in range(2 * KEPT_MODELS):
        store.refuse(radio(power=-50.0 - number), "radio", "hall", "hall", how())
    versions = {one.version: one.state for one in store.models()}
    assert versions[2] == "active"
    assert versions[1] == "superseded"
    assert len(versions) <= KEPT_MODELS
    assert power_of(store.roll_back("radio", "hall", how()).model) == -40.0


def test_a_decision_that_fails_half_way_leaves_nothing(engine: Engine, store: ModelStore) -> None:
    activate(store, -40.0)

    @event.listens_for(engine, "before_cursor_execute")
    def fail(_c: object, _cursor: object, statement: str, *_: object) -> None:
        if statement.startswith("INSERT INTO learning_decisions"):
            raise OSError("the disk is full")

    with pytest.raises(OSError, match="full"):
        activate(store, -41.0)
    event.remove(engine, "before_cursor_execute", fail)
    assert [(one.version, one.state) for one in store.models()] == [(1, "active")]
    assert len(store.history()) == 1
    assert activate(store, -41.0) == 2


def test_a_restart_finds_models_decisions_states_and_the_switch(engine: Engine, store: ModelStore) -> None:
    activate(store, -40.0)
    store.states.save({"radio/hall": b'{"n":1}'}, 5.0)
    store.states.save({"radio/hall": b'{"n":2}'}, 6.0)
    store.freeze(True)
    again = ModelStore(open_learning(engine.url.render_as_string()))
    assert [power_of(one.model) for one in again.all_active()] == [-40.0]
    assert again.states.read() == {"radio/hall": b'{"n":2}'}
    assert again.frozen
    again.freeze(False)
    assert not store.frozen


def test_only_states_that_changed_are_written(engine: Engine, store: ModelStore) -> None:
    store.states.save({"a": b"1", "b": b"1"}, 5.0)
    store.states.save({"a": b"1", "b": b"2"}, 6.0)
    with Session(engine) as session:
        assert {row.name: (row.saved, row.state) for row in session.query(LearnerRow)} == {
            "a": (5.0, b"1"),
            "b": (6.0, b"2"),
        }


def test_a_state_that_cannot_be_told_now_stays_as_it_is_until_it_is_given_up(engine: Engine, store: ModelStore) -> None:
    store.states.save({"a": b"1", "b": b"1"}, 5.0)
    store.states.save({"a": b"2"}, 6.0)
    assert store.states.read() == {"a": b"2", "b": b"1"}
    for one in (store, ModelStore(engine)):
        one.states.save({"a": b"2"}, 7.0, gone=["b", "c"])
        assert one.states.read() == {"a": b"2"}
        one.states.save({"a": b"2", "b": b"1"}, 8.0)


def test_what_is_not_understood_is_set_aside_and_takes_its_place_again(engine: Engine, store: ModelStore) -> None:
    store.states.save({"a": b"weeks"}, 5.0)
    store.states.set_aside("a", back=False)
    assert store.states.read() == {"aside/a": b"weeks"}
    store.states.save({"a": b"minutes"}, 6.0)
    again = ModelStore(engine)
    again.states.set_aside("a", back=True)
    assert again.states.read() == {"a": b"weeks", "aside/a": b"minutes"}
    again.states.set_aside("a", back=False)
    assert again.states.read() == {"aside/a": b"weeks"}, "the newer of two that nobody understands"


def test_what_nobody_here_uses_goes_in_time_or_with_whoever_withdraws(store: ModelStore) -> None:
    store.states.save({"mine": b"d-1", "a": b"d-1", "b": b"d-2"}, 5.0)
    store.states.forget("d-1", ["mine"])
    assert store.states.read() == {"mine": b"d-1", "b": b"d-2"}
    store.states.let_go(["mine"], 5.0)
    assert "b" in store.states.read()
    store.states.let_go(["mine"], 5.1)
    assert store.states.read() == {"mine": b"d-1"}


def test_the_live_version_is_told_without_its_model(store: ModelStore) -> None:
    assert store.live_version("radio", "hall") == 0
    activate(store, -40.0)
    activate(store, -41.0)
    assert store.live_version("radio", "hall") == 2


def test_a_row_that_cannot_be_read_any_more_is_left_out(engine: Engine, store: ModelStore) -> None:
    activate(store, -40.0)
    with Session(engine) as session, session.begin():
        session.query(ModelRow).update({"payload": b"{}"})
    assert store.all_active() == []
    assert store.active("radio", "hall") is None


def test_an_erased_phone_leaves_no_row(store: ModelStore) -> None:
    for device in ("d-1", "d-2"):
        store.activate(stride(device), "stride", device, "hall", how())
    activate(store, -40.0)
    store.forget("d-1")
    left = msgspec.json.encode([msgspec.to_builtins(one.model) for one in store.models()])
    assert b"d-1" not in left + msgspec.json.encode(store.history())
    assert [(one.kind, one.subject) for one in store.all_active()] == [("radio", "hall"), ("stride", "d-2")]


def test_an_experiment_keeps_its_models_in_memory() -> None:
    store = ModelStore(in_memory())
    assert activate(store, -40.0) == 1
    assert [one.version for one in store.all_active()] == [1]


def test_the_command_migrates_both_services_databases_and_may_do_so_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("ATRIUM_DATABASE_URL", f"sqlite:///{tmp_path / 'one.db'}")
    monkeypatch.delenv("ATRIUM_LEARNING_DATABASE_URL", raising=False)
    for _ in range(2):
        done = CliRunner().invoke(app, ["migrate"])
        assert done.exit_code == 0, done.output
    engine = open_learning(f"sqlite:///{tmp_path / 'one.db'}")
    assert (SCHEMA.problem(engine), gateway_problem(engine)) == (None, None)
    monkeypatch.setenv("ATRIUM_LEARNING_DATABASE_URL", f"sqlite:///{tmp_path / 'two.db'}")
    assert CliRunner().invoke(app, ["migrate"]).exit_code == 0
    assert SCHEMA.problem(open_learning(f"sqlite:///{tmp_path / 'two.db'}")) is None
