"""Schema versions of the gateway's tables (Alembic)."""
