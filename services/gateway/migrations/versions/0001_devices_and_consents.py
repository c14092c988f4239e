"""Devices and consents."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.create_table(
        "gateway_devices",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("token_sha256", sa.String(64), nullable=True, unique=True),
        sa.Column("name", sa.String(64), nullable=False),
        sa.Column("platform", sa.String(64), nullable=False),
        sa.Column("carrying", sa.String(16), nullable=False),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("revoked", sa.Float(53), nullable=True),
    )
    op.create_table(
        "gateway_consents",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("device", sa.String(64), sa.ForeignKey("gateway_devices.id"), nullable=False),
        sa.Column("version", sa.String(64), nullable=False),
        sa.Column("given", sa.Float(53), nullable=False),
        sa.Column("withdrawn", sa.Float(53), nullable=True),
    )
    op.create_index("ix_gateway_consents_device", "gateway_consents", ["device"])


def downgrade() -> None:
    op.drop_table("gateway_consents")
    op.drop_table("gateway_devices")
