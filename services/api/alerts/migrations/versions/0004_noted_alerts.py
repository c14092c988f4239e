"""An index of the alerts that have a note, which an erasure looks through."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None


def upgrade() -> None:
    noted = sa.text("note != ''")
    op.create_index("ix_api_alerts_noted", "api_alerts", ["seq"], sqlite_where=noted, postgresql_where=noted)


def downgrade() -> None:
    op.drop_index("ix_api_alerts_noted", "api_alerts")
