"""Up to which id events may have been told."""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "api_event_numbers",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("reserved", sa.BigInteger, nullable=False),
    )


def downgrade() -> None:
    op.drop_table("api_event_numbers")
