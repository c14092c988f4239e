"""Models, decisions, what learners know, switches."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "learning_models",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("subject", sa.String(64), nullable=False),
        sa.Column("area", sa.String(64), nullable=False),
        sa.Column("version", sa.Integer, nullable=False),
        sa.Column("state", sa.String(16), nullable=False),
        sa.Column("payload", sa.LargeBinary, nullable=False),
        sa.Column("decided", sa.Float(53), nullable=False),
        sa.Column("since", sa.Float(53), nullable=False),
        sa.Column("replaced", sa.Integer, nullable=False),
        sa.Column("probation", sa.Boolean, nullable=False),
        sa.Column("reason", sa.Text, nullable=False),
        sa.Column("evidence", sa.Text, nullable=False),
    )
    op.create_index("ix_learning_models_of", "learning_models", ["kind", "subject", "version"], unique=True)
    op.create_table(
        "learning_decisions",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("subject", sa.String(64), nullable=False),
        sa.Column("told", sa.Text, nullable=False),
    )
    op.create_index("ix_learning_decisions_subject", "learning_decisions", ["subject"])
    op.create_table(
        "learning_learners",
        sa.Column("name", sa.String(128), primary_key=True),
        sa.Column("saved", sa.Float(53), nullable=False),
        sa.Column("state", sa.LargeBinary, nullable=False),
    )
    op.create_table(
        "learning_switches",
        sa.Column("name", sa.String(32), primary_key=True),
        sa.Column("enabled", sa.Boolean, nullable=False),
    )


def downgrade() -> None:
    for table in ("switches", "learners", "decisions", "models"):
        op.drop_table(f"learning_{table}")
