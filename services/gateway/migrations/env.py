"""Run by Alembic: migrate over the connection that ``storage.migrate`` hands in."""

from alembic import context

from services.gateway.devices.storage import VERSION_TABLE, Base

context.configure(
    connection=context.config.attributes["connection"], target_metadata=Base.metadata, version_table=VERSION_TABLE
)
with context.begin_transaction():
    context.run_migrations()
