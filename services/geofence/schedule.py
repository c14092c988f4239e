"""Does a rule hold at a time? Days and clock of the site's time zone."""

from __future__ import annotations

from datetime import datetime, tzinfo

from shared.zones import Schedule

__all__ = ["holds"]


def holds(schedule: Schedule | None, t: float, zone: tzinfo) -> bool:
    """Return whether ``schedule`` holds at ``t``, seconds since the epoch; one past midnight belongs to its first day.

    On the night clocks change, a local time that comes twice holds twice and one that never comes never does.
    """
    if schedule is None:
        return True
    local = datetime.fromtimestamp(t, zone)
    clock, today = f"{local:%H:%M}", local.weekday()
    since, until = schedule.since, schedule.until
    if since < until:
        return since <= clock < until and today in schedule.days
    if since == until:
        return today in schedule.days
    return (clock >= since and today in schedule.days) or (clock < until and (today - 1) % 7 in schedule.days)
