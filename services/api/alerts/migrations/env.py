"""Run by Alembic: migrate over the connection that ``database.migrate`` hands in."""

from alembic import context

from services.api.alerts.database import VERSION_TABLE
from services.api.alerts.tables import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, version_table=VERSION_TABLE
)
with context.begin_transaction():
    context.run_migrations()
