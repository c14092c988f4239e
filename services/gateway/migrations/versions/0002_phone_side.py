"""Tokens with scopes, transmitters that receivers hear, trial walks, what waits for the bus, erasures too.

Tokens become signed: those handed out before are void, their phones enrol again.
"""

import sqlalchemy as sa
from alembic import op

revision = "0002"
down_revision = "0001"
branch_labels = None
depends_on = None


def upgrade() -> None:
    op.execute("UPDATE gateway_devices SET token_sha256 = NULL")
    op.create_table(
        "gateway_tokens",
        sa.Column("id", sa.String(64), primary_key=True),
        sa.Column("device", sa.String(64), sa.ForeignKey("gateway_devices.id"), nullable=False),
        sa.Column("scopes", sa.String(128), nullable=False),
        sa.Column("created", sa.Float(53), nullable=False),
        sa.Column("expires", sa.Float(53), nullable=False),
        sa.Column("revoked", sa.Float(53), nullable=True),
    )
    op.create_index("ix_gateway_tokens_device", "gateway_tokens", ["device"])
    op.create_table(
        "gateway_transmitters",
        sa.Column("digest", sa.String(64), primary_key=True),
        sa.Column("device", sa.String(64), sa.ForeignKey("gateway_devices.id"), nullable=False),
    )
    op.create_index("ix_gateway_transmitters_device", "gateway_transmitters", ["device"])
    op.create_table(
        "gateway_walkers",
        sa.Column("device", sa.String(64), sa.ForeignKey("gateway_devices.id"), primary_key=True),
        sa.Column("peak", sa.Float(53), nullable=True),
        sa.Column("mean", sa.Float(53), nullable=True),
        sa.Column("slope", sa.Float(53), nullable=True),
        sa.Column("offset", sa.Float(53), nullable=True),
        sa.Column("scale_variance", sa.Float(53), nullable=True),
        sa.Column("created", sa.Float(53), nullable=False),
    )
    op.create_table(
        "gateway_spool",
        sa.Column("id", sa.Integer, primary_key=True, autoincrement=True),
        sa.Column("device", sa.String(64), nullable=False),
        sa.Column("kind", sa.String(16), nullable=False),
        sa.Column("payload", sa.LargeBinary, nullable=False),
    )
    op.create_index("ix_gateway_spool_device", "gateway_spool", ["device"])
    op.create_table(
        "gateway_erasures",
        sa.Column("device", sa.String(64), primary_key=True),
        sa.Column("withdrawn", sa.Float(53), nullable=False),
    )


def downgrade() -> None:
    op.drop_table("gateway_erasures")
    op.drop_table("gateway_spool")
    op.drop_table("gateway_walkers")
    op.drop_table("gateway_transmitters")
    op.drop_table("gateway_tokens")
