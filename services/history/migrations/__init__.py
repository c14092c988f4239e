"""Schema of history's tables (Alembic)."""
