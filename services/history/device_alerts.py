"""Out of the database: the alerts that were about one device."""

from __future__ import annotations

from sqlalchemy import Engine, or_, select

from services.history.tables import AlertRow
from shared.messages import Alert, decode

__all__ = ["MOST_ALERTS", "device_alerts"]

MOST_ALERTS = 10_000


def device_alerts(engine: Engine, device: str, since: float, until: float) -> list[Alert]:
    """Return the alerts about a device that were measured from ``since`` until just before ``until``, oldest first.

    They name no device, since another one may be in them. At most ``MOST_ALERTS``, the oldest.
    """
    about = or_(AlertRow.device == device, AlertRow.other_device == device)
    asked = (
        select(AlertRow.told).where(about, AlertRow.t >= since, AlertRow.t < until).order_by(AlertRow.t, AlertRow.id)
    )
    with engine.connect() as connection:
        return [decode(told.encode(), Alert) for told in connection.scalars(asked.limit(MOST_ALERTS))]
