"""Examples of what the API answers about learning."""

from __future__ import annotations

from typing import Any

import msgspec

from services.api.learning_replies import (
    Learning,
    LearningAccessPoints,
    LearningAccuracy,
    LearningCameras,
    LearningDevices,
    LearningDone,
    LearningHistory,
)
from shared.learning_report import AreaLessons, MapGrid

__all__ = ["LEARNING_EXAMPLES"]

_T = 1767225600.0
_FIT: dict[str, Any] = {
    "access_point": "ap-5",
    "power_1m": -41.3,
    "path_loss_exponent": 2.31,
    "sigma": 3.4,
    "bias": -6.1,
    "readings": 412,
    "state": "changed",
    "position": None,
    "position_error": None,
    "words": "heard 6 dB weaker than ten minutes ago, everywhere: was something put in front of it?",
}
_ACCURACY: dict[str, Any] = {"rms": 0.81, "p50": 0.44, "p90": 1.35, "named": 0.93, "right": 0.96, "seconds": 5400.0}
_AREA: dict[str, Any] = {
    "area": "hall",
    "version": 3,
    "access_points": [_FIT],
    "tracks": {
        "good": 212,
        "refused": {"radio does not agree": 19, "too short": 41},
        "threshold": 0.4,
        "quality": 1.9,
    },
    "accuracy": _ACCURACY,
    "words": "radio model 3 is active since 14:05, 12 % better on held-out walks",
}
_CAMERA: dict[str, Any] = {
    "camera": "hall-east",
    "area": "hall",
    "version": 1,
    "options": {"learning_rate": 0.02},
    "score_t": [_T - 120.0, _T - 60.0, _T],
    "score": [1.4, 1.5, 1.7],
    "alignment": "fine",
    "offset": 0.06,
    "clock": 0.04,
    "clock_error": 0.02,
    "words": "",
}
_DEVICE: dict[str, Any] = {
    "device": "d-7f3a",
    "slope": 0.31,
    "offset": 0.12,
    "r2": 0.74,
    "steps": 640,
    "used": True,
    "heading_bias": 0.05,
    "heading_error": 0.03,
    "radio_offset": -1.8,
}
_ACTIVATION: dict[str, Any] = {
    "t": _T - 600.0,
    "kind": "radio",
    "subject": "hall",
    "version": 3,
    "decision": "activated",
    "reason": "explains the withheld readings of the last five minutes better",
    "gain": 0.21,
    "margin": 0.05,
    "evidence": {"readings": 1830.0, "rms before": 5.1, "rms after": 3.9},
    "by": "learning",
}

LEARNING_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    Learning: {
        "t": _T,
        "frozen": False,
        "may_change": False,
        "areas": [_AREA],
        "cameras": [_CAMERA],
        "devices": [_DEVICE],
        "history": [_ACTIVATION],
    },
    AreaLessons: _AREA,
    LearningAccessPoints: {"t": _T, "access_points": [{"area": "hall", "version": 3, "fit": _FIT}]},
    LearningCameras: {"t": _T, "cameras": [_CAMERA]},
    LearningDevices: {"t": _T, "devices": [_DEVICE]},
    LearningAccuracy: {"t": _T, "areas": [{"area": "hall", "accuracy": _ACCURACY}]},
    LearningHistory: {"t": _T, "history": [_ACTIVATION], "next": None},
    LearningDone: {"words": "area hall is back at radio model 2, as version 4", "version": 4},
    MapGrid: {
        "area": "hall",
        "kind": "visits",
        "subject": "",
        "unit": "visits per hour",
        "origin": [0.25, 0.25],
        "cell": 0.5,
        "rows": [[12.0, 8.5, None], [3.0, 0.0, None]],
    },
}
