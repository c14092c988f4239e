"""Schema versions of learning's tables (Alembic)."""
