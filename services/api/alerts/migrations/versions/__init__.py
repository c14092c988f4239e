"""Schema versions of the tables of alerts and webhooks (Alembic)."""
