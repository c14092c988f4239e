"""By which tracks a device was carried stands beside its block."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.add_column("history_blocks", sa.Column("tracks", sa.Text, nullable=False, server_default=""))


def downgrade() -> None:
    op.drop_column("history_blocks", "tracks")
