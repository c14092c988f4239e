"""Deliveries of technical trouble, which are of no alert."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None


def upgrade() -> None:
    with op.batch_alter_table("api_deliveries", table_kwargs={"sqlite_autoincrement": True}) as table:
        table.alter_column("alert", existing_type=sa.Integer, nullable=True)
        table.add_column(sa.Column("trouble", sa.LargeBinary))


def downgrade() -> None:
    op.execute("DELETE FROM api_deliveries WHERE alert IS NULL")
    with op.batch_alter_table("api_deliveries", table_kwargs={"sqlite_autoincrement": True}) as table:
        table.drop_column("trouble")
        table.alter_column("alert", existing_type=sa.Integer, nullable=False)
