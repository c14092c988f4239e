"""Schema versions of the API's own tables (Alembic)."""
