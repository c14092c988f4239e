"""Who entered or left which zone: tracks and polygons in, alerts out.

``crossings`` is the state machine, ``zone_index`` the geometry under it; both are pure. ``service`` wires them
to the bus.
"""
