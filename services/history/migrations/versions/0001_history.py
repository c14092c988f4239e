"""Blocks of positions, alerts, occupancy, who is erased, what of the spool is in."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "history_blocks",
        sa.Column("id", sa.BigInteger().with_variant(sa.Integer, "sqlite"), primary_key=True, autoincrement=True),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("subject", sa.Text, nullable=False),
        sa.Column("minute", sa.BigInteger, nullable=False),
        sa.Column("area", sa.Text, nullable=False),
        sa.Column("floor", sa.Text, nullable=False),
        sa.Column("step", sa.Float(53), nullable=False),
        sa.Column("points", sa.LargeBinary, nullable=False),
    )
    of = ["kind", "subject", "minute", "area", "floor"]
    op.create_index("ix_history_blocks_of", "history_blocks", of, unique=True)
    op.create_index("ix_history_blocks_minute", "history_blocks", ["kind", "minute"])
    op.create_table(
        "history_alerts",
        sa.Column("id", sa.Text, primary_key=True),
        sa.Column("t", sa.Float(53), nullable=False),
        sa.Column("zone", sa.Text, nullable=False),
        sa.Column("kind", sa.Text, nullable=False),
        sa.Column("device", sa.Text, nullable=True),
        sa.Column("other_device", sa.Text, nullable=True),
        sa.Column("told", sa.Text, nullable=False),
    )
    op.create_index("ix_history_alerts_t", "history_alerts", ["t"])
    op.create_index("ix_history_alerts_device", "history_alerts", ["device"])
    op.create_index("ix_history_alerts_other_device", "history_alerts", ["other_device"])
    op.create_table(
        "history_occupancy",
        sa.Column("kind", sa.Text, primary_key=True),
        sa.Column("place", sa.Text, primary_key=True),
        sa.Column("minute", sa.BigInteger, primary_key=True, autoincrement=False),
        sa.Column("counts", sa.Integer, nullable=False),
        sa.Column("people", sa.BigInteger, nullable=False),
        sa.Column("most", sa.Integer, nullable=False),
        sa.Column("phones", sa.BigInteger, nullable=False),
    )
    op.create_index("ix_history_occupancy_minute", "history_occupancy", ["minute"])
    op.create_table(
        "history_erased",
        sa.Column("device", sa.Text, primary_key=True),
        sa.Column("t", sa.Float(53), nullable=False),
    )
    op.create_table("history_applied", sa.Column("name", sa.Text, primary_key=True))


def downgrade() -> None:
    for table in ("applied", "erased", "occupancy", "alerts", "blocks"):
        op.drop_table(f"history_{table}")
