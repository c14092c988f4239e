"""The HTTP interface for staff software: live positions, tracks, zones, alerts, cameras, site, health, one stream.

A thin, read-only view of the bus. Everything it shows it keeps in memory, bounded (``live_state``); the bytes of a hot
reply are built once per frame, not once per request. ``docs/api.md`` is the reference for its users.
"""
