"""Alerts, webhooks, deliveries that wait or failed."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "api_alerts",
        sa.Column("seq", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("id", sa.String(200), nullable=False, unique=True),
        sa.Column("t", sa.Float(53), nullable=False),
        sa.Column("sent", sa.Float(53), nullable=False),
        sa.Column("zone", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("area", sa.String(64), nullable=False),
        sa.Column("device", sa.String(64)),
        sa.Column("other_device", sa.String(64)),
        sa.Column("event", sa.BigInteger, nullable=False),
        sa.Column("told", sa.LargeBinary, nullable=False),
        sa.Column("acknowledged", sa.Float(53)),
        sa.Column("acknowledged_by", sa.String(200), nullable=False),
        sa.Column("note", sa.Text, nullable=False),
        sqlite_autoincrement=True,
    )
    for column in ("t", "sent", "event", "device", "other_device", "acknowledged"):
        op.create_index(f"ix_api_alerts_{column}", "api_alerts", [column])
    op.create_index("ix_api_alerts_zone", "api_alerts", ["zone", "t"])
    op.create_table(
        "api_webhooks",
        sa.Column("id", sa.String(32), primary_key=True),
        sa.Column("name", sa.String(200), nullable=False),
        sa.Column("url", sa.String(2000), nullable=False),
        sa.Column("kinds", sa.Text, nullable=False),
        sa.Column("zones", sa.Text, nullable=False),
        sa.Column("enabled", sa.Boolean, nullable=False),
        sa.Column("secret", sa.String(100), nullable=False),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("created_by", sa.String(200), nullable=False),
        sa.Column("delivered", sa.Integer, nullable=False),
        sa.Column("failed", sa.Integer, nullable=False),
        sa.Column("last_success", sa.Float(53)),
        sa.Column("last_failure", sa.Float(53)),
        sa.Column("last_reason", sa.String(300), nullable=False),
    )
    op.create_table(
        "api_deliveries",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("webhook", sa.String(32), sa.ForeignKey("api_webhooks.id", ondelete="CASCADE"), nullable=False),
        sa.Column("alert", sa.Integer, sa.ForeignKey("api_alerts.seq", ondelete="CASCADE"), nullable=False),
        sa.Column("dead", sa.Boolean, nullable=False),
        sa.Column("attempts", sa.Integer, nullable=False),
        sa.Column("due", sa.Float(53), nullable=False),
        sa.Column("reason", sa.String(300), nullable=False),
        sqlite_autoincrement=True,
    )
    op.create_index("ix_api_deliveries_due", "api_deliveries", ["webhook", "dead", "due"])
    op.create_index("ix_api_deliveries_alert", "api_deliveries", ["alert"])


def downgrade() -> None:
    for table in ("deliveries", "webhooks", "alerts"):
        op.drop_table(f"api_{table}")
