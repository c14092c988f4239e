"""Models as rows: what is live, what was, what was refused and why. One transaction per decision.

Whatever is decided is stored first and published then: a process that is killed in between publishes it when it
starts again, for at every start all active models are published anew.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from sqlalchemy import Engine, delete, select
from sqlalchemy.orm import Session

from services.learning.activation.content import Contents
from services.learning.activation.history import page
from services.learning.activation.kinds import PERSONAL, as_configured, is_configured, kind_of, subject_of
from services.learning.activation.rows import (
    Decided,
    StoredModel,
    Went,
    active_row,
    known,
    let_go,
    make_live,
    new_row,
    read_row,
    rows_of,
    which,
    write_decision,
)
from services.learning.activation.states import LearnerStates
from services.learning.activation.tables import DecisionRow, ModelRow, SwitchRow
from shared.learning_report import Activation, ModelKind
from shared.messages import Message

__all__ = ["ModelStore", "NoSuchModelError", "NothingBeforeError", "UnusableModelError"]


class NoSuchModelError(LookupError):
    """There is no such model: the text says what there is instead."""


class NothingBeforeError(LookupError):
    """A roll-back has nowhere to go: the text says what could be rolled back instead."""


class UnusableModelError(ValueError):
    """A model may not go live: the text says what it says that no model may say, and what is allowed."""


class ModelStore:
    """The models of one site. Used by one thread.

    Args:
        engine: an open database with learning's tables.
        contents: knows what models may say.

    Attributes:
        states: what the learners know.
    """

    def __init__(self, engine: Engine, contents: Contents | None = None) -> None:
        self._engine = engine
        self._contents = contents or Contents()
        self.states = LearnerStates(engine)

    def problem(self, model: Message) -> str:
        """Return why a model may not go live; empty: it may."""
        if is_configured(model):
            return ""
        return self._contents.problem(model)

    def outlived(self, model: Message) -> bool:
        """Whether a model corrects a calibration that its camera has no more."""
        return bool(self._contents.outlived(model))

    # -- what there is ---------------------------------------------------------------------------------------------

    def active(self, kind: ModelKind, subject: str) -> StoredModel | None:
        """Return the model that is live; None: as configured."""
        with Session(self._engine) as session:
            row = active_row(session, kind, subject)
            return None if row is None else read_row(row)

    def live_version(self, kind: ModelKind, subject: str) -> int:
        """Return the version that is live, without reading the model; 0: as configured."""
        with Session(self._engine) as session:
            where = (*which(kind, subject), ModelRow.state == "active")
            return session.scalar(select(ModelRow.version).where(*where)) or 0

    def all_active(self) -> list[StoredModel]:
        """Return all live models; a row that cannot be read any more is left out."""
        return self._read(ModelRow.state == "active")

    def on_probation(self) -> list[StoredModel]:
        """Return the live models that are still to be held against those they replaced."""
        return self._read(ModelRow.probation)

    def imported(self) -> list[StoredModel]:
        """Return the models from elsewhere that wait to be tried."""
        return self._read(ModelRow.state == "imported")

    def get(self, kind: ModelKind, subject: str, version: int) -> StoredModel:
        """Return one model.

        Raises:
            NoSuchModelError: it is not there, or not any more.
        """
        with Session(self._engine) as session:
            row = session.scalar(rows_of(kind, subject).where(ModelRow.version == version))
            found = None if row is None else read_row(row)
        if found is None:
            raise NoSuchModelError(f"version: found {version}; allowed: {self._versions(kind, subject)}")
        return found

    def models(self) -> list[StoredModel]:
        """Return all models, by kind and subject, newest first."""
        return self._read()

    def before(self, model: StoredModel) -> Message:
        """Return the model that ``model`` replaced; as configured where there was none, or it is gone."""
        former = self._former(model)
        return as_configured(model.kind, model.subject, model.decided) if former is None else former.model

    def _former(self, model: StoredModel) -> StoredModel | None:
        """Return the newest model before ``model`` that can be used; None: as configured."""
        while model.replaced:
            try:
                model = self.get(model.kind, model.subject, model.replaced)
            except NoSuchModelError:
                return None
            if not self.problem(model.model):
                return model
        return None

    def history(self, most: int = 200) -> list[Activation]:
        """Return the latest decisions, newest first."""
        return self.decisions(None, None, None, most, personal=True)[0][:most]

    def decisions(
        self, kind: ModelKind | None, subject: str | None, before: float | None, most: int, *, personal: bool
    ) -> tuple[list[Activation], bool]:
        """Return a page of decisions and whether there are older ones; see ``history.page``."""
        with Session(self._engine) as session:
            return page(session, kind, subject, before, most, personal=personal)

    # -- decisions, one transaction each -----------------------------------------------------------------------------

    def activate(self, model: Message, kind: ModelKind, subject: str, area: str, how: Decided) -> StoredModel:
        """Make a model live, in the place of the one that was."""
        return self._activate(model, kind, subject, area, how, "activated", probation=True)

    def refuse(self, model: Message, kind: ModelKind, subject: str, area: str, how: Decided) -> StoredModel:
        """Write down a model that does not go live."""
        with Session(self._engine) as session, session.begin():
            row = new_row(session, model, kind, subject, area, "refused", how)
            write_decision(session, row, "refused", how)
            let_go(session, kind, subject)
            return known(row)

    def take_in_all(
        self, models: Sequence[tuple[Message, ModelKind, str, str]], how: Sequence[Decided], *, live: bool = False
    ) -> list[StoredModel]:
        """Write down models from elsewhere, (message, kind, subject, area) each, all of them or none.

        Args:
            models: what comes in.
            how: why and when, of each.
            live: whether they are live from now on; else they wait.

        Raises:
            UnusableModelError: one may not go live and should.
        """
        if live:
            for model, *_ in models:
                self._check(model)
        with Session(self._engine) as session, session.begin():
            rows = []
            for (model, kind, subject, area), why in zip(models, how, strict=True):
                # One at a time waits to be tried: the newer takes the place of an older one.
                waiting = (*which(kind, subject), ModelRow.state == "imported")
                session.execute(delete(ModelRow).where(*waiting))
                if live:
                    rows.append(make_live(session, model, kind, subject, area, why, "activated", probation=False))
                    continue
                rows.append(new_row(session, model, kind, subject, area, "imported", why))
                write_decision(session, rows[-1], "imported", why)
                let_go(session, kind, subject)
            return [known(row) for row in rows]

    def judged(self, model: StoredModel, how: Decided) -> None:
        """Write down that an imported model was refused by the gate."""
        with Session(self._engine) as session, session.begin():
            row = session.scalar(rows_of(model.kind, model.subject).where(ModelRow.version == model.version))
            if row is not None:
                row.state, row.reason, row.decided = "refused", how.reason, how.t
                write_decision(session, row, "refused", how)

    def promote(self, model: StoredModel, how: Decided) -> StoredModel:
        """Make a model live that is stored already, as a new version; one that was imported waits no more.

        Raises:
            UnusableModelError: it may not go live; nothing has changed.
        """
        return self._activate(
            model.model, model.kind, model.subject, model.area, how, "activated", probation=how.by == "learning",
            origin=model.version if model.state == "imported" else None,
        )  # fmt: skip

    def roll_back(self, kind: ModelKind, subject: str, how: Decided) -> StoredModel:
        """Return to the model before the one that is live, as a new version.

        Raises:
            NoSuchModelError: no model of the kind and subject ever went live.
            NothingBeforeError: it is as configured already.
        """
        current = self.active(kind, subject)
        if current is None:
            raise NoSuchModelError(
                f"subject: no {kind} model of {subject!r} is active; allowed: {self._subjects(kind)}"
            )
        if not current.replaced and is_configured(current.model):
            raise NothingBeforeError(f"{kind} of {subject!r} is as configured already; allowed: {self._subjects(kind)}")
        former = self._former(current)
        model = as_configured(kind, subject, current.decided) if former is None else former.model
        return self._activate(
            model, kind, subject, current.area, how, "rolled back", probation=False,
            replaced=0 if former is None else former.replaced,
        )  # fmt: skip

    def settle(self, kind: ModelKind, subject: str) -> None:
        """End the probation of the live model: it has stood it."""
        with Session(self._engine) as session, session.begin():
            row = active_row(session, kind, subject)
            if row is not None:
                row.probation = False

    def _activate(
        self, model: Message, kind: ModelKind, subject: str, area: str, how: Decided, decision: Went, **more: Any
    ) -> StoredModel:
        self._check(model)
        with Session(self._engine) as session, session.begin():
            return known(make_live(session, model, kind, subject, area, how, decision, **more))

    def _check(self, model: Message) -> None:
        if why := self.problem(model):
            raise UnusableModelError(f"{kind_of(model)} model of {subject_of(model)[:64]}: {why}")

    # -- switch, erasure ---------------------------------------------------------------------------------------------

    @property
    def frozen(self) -> bool:
        """Whether an operator has switched activation off."""
        with Session(self._engine) as session:
            row = session.get(SwitchRow, "frozen")
            return row is not None and row.enabled

    def freeze(self, frozen: bool) -> None:
        """Switch activation off or on again, over restarts."""
        with Session(self._engine) as session, session.begin():
            session.merge(SwitchRow(name="frozen", enabled=frozen))

    def phones(self) -> set[str]:
        """Return the phones of which a model is kept, live or not."""
        with Session(self._engine) as session:
            return set(session.scalars(select(ModelRow.subject).where(ModelRow.kind.in_(PERSONAL)).distinct()))

    def forget(self, device: str) -> None:
        """Delete all that is of one phone, decisions included."""
        with Session(self._engine) as session, session.begin():
            session.execute(delete(ModelRow).where(ModelRow.kind.in_(PERSONAL), ModelRow.subject == device))
            session.execute(delete(DecisionRow).where(DecisionRow.kind.in_(PERSONAL), DecisionRow.subject == device))

    def _read(self, *which: Any) -> list[StoredModel]:
        order = (ModelRow.kind, ModelRow.subject, ModelRow.version.desc())
        with Session(self._engine) as session:
            rows = session.scalars(select(ModelRow).where(*which).order_by(*order)).all()
            return [model for row in rows if (model := read_row(row)) is not None]

    def _versions(self, kind: ModelKind, subject: str) -> str:
        with Session(self._engine) as session:
            rows = session.scalars(rows_of(kind, subject).order_by(ModelRow.version)).all()
            return ", ".join(str(row.version) for row in rows) or f"none, there is no {kind} model of {subject!r}"

    def _subjects(self, kind: ModelKind) -> str:
        live = (model for model in self.all_active() if model.kind == kind)
        changed = {model.subject for model in live if model.replaced or not is_configured(model.model)}
        return ", ".join(sorted(changed)) or "none now"
