"""Schema versions of history's tables (Alembic)."""
