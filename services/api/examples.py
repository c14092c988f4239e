"""One example for each documented body, shown by the OpenAPI document; a test decodes each as what it exemplifies."""

from __future__ import annotations

from typing import Any

import msgspec

from services.api.admin.examples import ADMIN_EXAMPLES, RULE
from services.api.alerts.examples import ALERT_EXAMPLES
from services.api.calibration_replies import CALIBRATION_EXAMPLES
from services.api.history_examples import HISTORY_EXAMPLES
from services.api.learning_examples import LEARNING_EXAMPLES
from services.api.replies import (
    Cameras,
    Devices,
    HealthReport,
    Position,
    Positions,
    SiteView,
    Tracks,
    ZoneReport,
    Zones,
)

__all__ = ["EXAMPLES"]

_POSITION: dict[str, Any] = {
    "device": "d-7f3a",
    "area": "hall",
    "floor": "ground",
    "x": 9.41,
    "y": 3.2,
    "covariance": [0.04, 0.0, 0.05],
    "accuracy": 0.224,
    "vx": 0.9,
    "vy": 0.1,
    "t": 1767225600.2,
    "age": 0.08,
    "track": 12,
    "probability": 0.97,
    "state": "confirmed",
}
_CAMERA: dict[str, Any] = {
    "camera": "hall-east",
    "area": "hall",
    "state": "ok",
    "reason": "",
    "frames": 5021,
    "dropped": 0,
    "frames_per_s": 15.0,
    "t": 1767225599.9,
    "age": 0.4,
}
_CORNERS = [[7.0, 0.0], [13.0, 0.0], [13.0, 2.5], [7.0, 2.5]]

_ZONE: dict[str, Any] = {
    "id": "entrance",
    "name": "Entrance",
    "floor": "ground",
    "shape": "area",
    "points": _CORNERS,
    "rules": [{**RULE, "id": "enter", "kind": "enter"}, {**RULE, "id": "exit", "kind": "exit"}],
    "polygon": _CORNERS,
    "alert_on": ["enter", "exit"],
    "inside": 2,
    "unseen": 0,
    "etag": '"a1b2c3d4e5f60718a1"',
}

EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    **LEARNING_EXAMPLES,
    **CALIBRATION_EXAMPLES,
    **HISTORY_EXAMPLES,
    **ALERT_EXAMPLES,
    **ADMIN_EXAMPLES,
    ZoneReport: _ZONE,
    Position: _POSITION,
    Positions: {"t": 1767225600.28, "positions": [_POSITION], "next": None},
    Devices: {
        "t": 1767225600.28,
        "devices": [
            {
                "device": "d-7f3a",
                "state": "confirmed",
                "area": "hall",
                "floor": "ground",
                "zones": ["entrance"],
                "probability": 0.97,
                "t": 1767225600.2,
                "age": 0.08,
            }
        ],
        "next": None,
    },
    Tracks: {
        "t": 1767225600.28,
        "tracks": [
            {
                **{name: value for name, value in _POSITION.items() if name not in ("device", "probability")},
                "device": "d-7f3a",
                "device_since": 1767225561.4,
                "probability": 0.97,
                "runner_up": "d-11c0",
                "runner_up_probability": 0.02,
                "former": [3],
                "sources": ["d-7f3a", "hall-east"],
                "quality": 0.93,
            }
        ],
        "next": None,
    },
    Zones: {
        "t": 1767225600.28,
        "zones": [
            _ZONE,
        ],
    },
    Cameras: {"t": 1767225600.28, "cameras": [_CAMERA]},
    HealthReport: {
        "t": 1767225600.28,
        "status": "degraded",
        "problems": ["the geofence service is not running: no alerts are raised"],
        "services": [{"service": "fusion", "instance": "hall", "alive": True}],
        "areas": [{"area": "hall", "t": 1767225600.2, "age": 0.08, "people": 14}],
        "cameras": [_CAMERA],
    },
    SiteView: {
        "site": "hall",
        "name": "Demo hall",
        "north": 90.0,
        "floors": [
            {
                "id": "ground",
                "name": "Ground floor",
                "level": 0,
                "outline": [[0.0, 0.0], [20.0, 0.0], [20.0, 12.0], [0.0, 12.0]],
                "walls": [[[0.0, 0.0], [8.0, 0.0]]],
                "obstacles": [{"id": "vase", "polygon": [[4.4, 3.4], [5.6, 3.4], [5.6, 4.6], [4.4, 4.6]]}],
            }
        ],
        "areas": [{"id": "hall", "floor": "ground"}],
        "cameras": [
            {
                "id": "hall-east",
                "area": "hall",
                "floor": "ground",
                "position": [10.0, -3.0, 8.0],
                "footprint": [[0.0, 0.0], [20.0, 0.0], [20.0, 12.0], [0.0, 12.0]],
            }
        ],
        "access_points": [{"id": "ap-1", "floor": "ground", "position": [0.3, 0.3, 2.8], "kind": "wifi"}],
        "zones": [{"id": "entrance", "name": "Entrance", "floor": "ground", "polygon": _CORNERS, "shape": "area"}],
    },
}
