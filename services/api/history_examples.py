"""Examples of what the API answers about the past."""

from __future__ import annotations

from typing import Any

import msgspec

from services.api.erasure_replies import ErasureReport, Erasures, RetentionReport
from services.api.history_replies import DwellReport, FlowReport, HeatMapReport, OccupancyReport, TrajectoryReport

__all__ = ["HISTORY_EXAMPLES"]

_T = 1767225600.0
_PERIOD = {"since": _T, "until": _T + 86400.0}

HISTORY_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    TrajectoryReport: {
        "device": "d-7f3a",
        **_PERIOD,
        "t": [_T + 36000.0, _T + 36001.0],
        "floor": ["ground", "ground"],
        "x": [9.41, 10.3],
        "y": [3.2, 3.25],
        "accuracy": [0.12, 0.13],
        "probability": [0.97, 0.97],
        "track": [12, 12],
        "state": ["confirmed", "confirmed"],
    },
    OccupancyReport: {
        **_PERIOD,
        "step": 3600,
        "time_zone": "Europe/Rome",
        "t": [_T + 32400.0, _T + 36000.0],
        "places": [{"id": "entrance", "people": [None, 3.25], "most": [None, 9], "phones": [None, 1.5]}],
    },
    HeatMapReport: {
        "floor": "ground",
        **_PERIOD,
        "origin": [0.0, 0.0],
        "cell": 0.5,
        "seconds": [[12.0, 340.0, None], [None, 86.0, None]],
        "people": [[6, 41, None], [None, 12, None]],
    },
    DwellReport: {
        **_PERIOD,
        "places": [{"id": "entrance", "people": 212, "visits": 260, "mean": 41.3, "median": 28.0, "p90": 95.0}],
    },
    Erasures: {
        "t": _T + 10.0,
        "erasures": [
            {"device": "d-7f3a", "t": _T, "done": [{"service": "history", "t": _T + 4.0}], "waiting": ["learning"]}
        ],
    },
    ErasureReport: {
        "device": "d-7f3a",
        "t": _T,
        "done": [],
        "waiting": ["api", "fusion-hall", "geofence", "history", "learning"],
    },
    RetentionReport: {
        "t": _T,
        "kept": [
            {
                "service": "history",
                "what": "where phones were",
                "settings": ["history_phone_days"],
                "seconds": 2592000.0,
                "note": "one position every 1 s",
            }
        ],
        "silent": ["learning"],
    },
    FlowReport: {**_PERIOD, "zones": ["entrance", "model"], "counts": [[0, 131], [117, 0]]},
}
