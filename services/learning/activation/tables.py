"""What is stored of models: learning's tables. Learning is their one writer."""

from __future__ import annotations

from sqlalchemy import Float, Index, LargeBinary, String, Text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

__all__ = ["Base", "DecisionRow", "LearnerRow", "ModelRow", "SwitchRow"]


class Base(DeclarativeBase):
    """Learning's tables."""


class ModelRow(Base):
    """One model: a message of the bus, whose version counts per kind and subject."""

    __tablename__ = "learning_models"
    __table_args__ = (Index("ix_learning_models_of", "kind", "subject", "version", unique=True),)

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    kind: Mapped[str] = mapped_column(String(16))
    subject: Mapped[str] = mapped_column(String(64))
    area: Mapped[str] = mapped_column(String(64))
    version: Mapped[int]
    state: Mapped[str] = mapped_column(String(16))
    """imported, active, superseded, refused or rolled back."""
    payload: Mapped[bytes] = mapped_column(LargeBinary)
    """The message, JSON."""
    decided: Mapped[float] = mapped_column(Float(53))
    """When it got its state, wall clock."""
    since: Mapped[float] = mapped_column(Float(53))
    """The sensors' time then: what is newer was measured under it."""
    replaced: Mapped[int]
    """The version that was active before; 0: as configured."""
    probation: Mapped[bool]
    """Whether it is still to be held against the one it replaced."""
    reason: Mapped[str] = mapped_column(Text)
    evidence: Mapped[str] = mapped_column(Text)
    """JSON, numbers by name."""


class DecisionRow(Base):
    """One decision: an ``Activation`` of the report."""

    __tablename__ = "learning_decisions"

    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    kind: Mapped[str] = mapped_column(String(16))
    subject: Mapped[str] = mapped_column(String(64), index=True)
    told: Mapped[str] = mapped_column(Text)
    """The ``Activation``, JSON."""


class LearnerRow(Base):
    """What a learner knows, so that a restart does not begin learning anew."""

    __tablename__ = "learning_learners"

    name: Mapped[str] = mapped_column(String(128), primary_key=True)
    saved: Mapped[float] = mapped_column(Float(53))
    state: Mapped[bytes] = mapped_column(LargeBinary)


class SwitchRow(Base):
    """What an operator has switched."""

    __tablename__ = "learning_switches"

    name: Mapped[str] = mapped_column(String(32), primary_key=True)
    enabled: Mapped[bool]
