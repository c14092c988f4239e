"""Run by Alembic: migrate over the connection that ``database.migrate`` hands in."""

from alembic import context

from services.history.database import VERSION_TABLE
from services.history.tables import Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, version_table=VERSION_TABLE
)
with context.begin_transaction():
    context.run_migrations()
