"""Worked examples of every body, shown on the gateway's own page and tried by the tests."""

from __future__ import annotations

from typing import Any

import msgspec

from services.gateway import protocol
from services.gateway.adapters.find3 import Find3Post
from services.gateway.adapters.replies import AdapterReply, Find3Reply
from services.gateway.adapters.sensor_logger import SensorLoggerPush

__all__ = ["EXAMPLES"]

_POSITION: dict[str, Any] = {
    "t": 1767225602.4,
    "age": 0.2,
    "area": "hall",
    "floor": "ground",
    "x": 7.31,
    "y": 4.02,
    "covariance": [0.04, 0.0, 0.05],
    "probability": 0.93,
    "zones": [{"id": "exhibit-1", "name": "The first exhibit"}],
}
_RECORD: dict[str, Any] = {
    "device": "d-3f0c5b1e9a7d4c26",
    "name": "",
    "platform": "android",
    "carrying": "hand",
    "enrolled": 1767225600.12,
    "consents": [{"version": "1", "given": 1767225600.12}],
    "tokens": 1,
    "transmitters": 0,
    "waiting": 0,
    "trial_walks": {"peak": 1.2, "mean": 0.4, "slope": 0.31, "offset": 0.12},
    "position": _POSITION,
    "alerts": [],
    "learned": {"slope": 0.33, "offset": 0.1, "steps": 420, "heading_bias": 0.2, "radio_offset": -1.5},
    "kept": [{"service": "history", "what": "where phones were", "seconds": 2592000.0, "note": ""}],
    "silent": [],
}
_WAY: dict[str, Any] = {
    "since": 1767225600.12,
    "until": 1767229200.0,
    "t": [1767225602.4, 1767225603.4],
    "floor": ["ground", "ground"],
    "x": [7.31, 8.2],
    "y": [4.02, 4.1],
    "accuracy": [0.2, 0.2],
    "alerts": [],
}

EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    protocol.Enrolment: {
        "a phone in the hand": {
            "enrolment_key": "demo-enrolment-key",
            "consent": True,
            "name": "Museum guide",
            "platform": "android",
            "carrying": "hand",
        },
        "a phone in a pocket, with a tag that the site's receivers hear": {
            "enrolment_key": "demo-enrolment-key",
            "consent": True,
            "consent_version": "1",
            "carrying": "pocket",
            "transmitters": ["02:b7:00:00:00:01"],
            "staff_key": "a key that staff know",
        },
    },
    protocol.Enrolled: {
        "enrolled": {
            "device": "d-3f0c5b1e9a7d4c26",
            "token": "eyJhbGciOiJIUzI1NiIsImtpZCI6IjYxZTQ4ZWEzIiwidHlwIjoiSldUIn0.eyJzdWIiOiJkLTNmMGM1YjFlIn0.c2lnbmVk",
            "expires": 1767830400.12,
            "site": "hall",
            "consent_version": "1",
            "time": 1767225600.12,
            "batches": "/v1/devices/d-3f0c5b1e9a7d4c26/batches",
            "stream": "/v1/devices/d-3f0c5b1e9a7d4c26/stream",
            "position": "/v1/devices/d-3f0c5b1e9a7d4c26/position",
            "alerts": "/v1/devices/d-3f0c5b1e9a7d4c26/alerts",
        }
    },
    protocol.Consent: {"the text": {"version": "1", "text": "May this site follow where your phone is? …"}},
    protocol.Change: {"into the pocket": {"carrying": "pocket"}},
    protocol.OwnDevice: {"changed": {"device": "d-3f0c5b1e9a7d4c26", "carrying": "pocket"}},
    protocol.OwnRecord: {"a phone that has not been located": _RECORD},
    protocol.OwnExport: {"two seconds of a way": {"record": _RECORD, "ways": [_WAY]}},
    protocol.TokenRequest: {
        "for an app that posts": {"scopes": ["post"]},
        "to read for an hour": {"scopes": ["read"], "seconds": 3600},
    },
    protocol.NewToken: {
        "for an app that posts": {
            "id": "5d41402abc4b2a76",
            "token": "eyJhbGciOiJIUzI1NiIsImtpZCI6IjYxZTQ4ZWEzIiwidHlwIjoiSldUIn0.eyJzdWIiOiJkLTNmMGM1YjFlIn0.c2lnbmVk",
            "scopes": ["post"],
            "expires": 1767830400.12,
        }
    },
    protocol.Tokens: {
        "two": {
            "tokens": [
                {
                    "id": "9c1185a5c5e9fc54",
                    "scopes": ["post", "read", "manage"],
                    "created": 1767225600.12,
                    "expires": 1767830400.12,
                    "asking": True,
                },
                {
                    "id": "5d41402abc4b2a76",
                    "scopes": ["post"],
                    "created": 1767225700.0,
                    "expires": 1767830400.12,
                    "asking": False,
                },
            ]
        }
    },
    protocol.BatchReply: {
        "all of it is on the bus": {
            "seq": 0,
            "duplicate": False,
            "received": 1767225601.03,
            "replied": 1767225601.031,
            "clock_offset": 0.03,
            "clock_drift": 0.0,
            "late": False,
            "accepted": {"samples": 2, "scans": 1, "readings": 2},
            "ignored": {},
        }
    },
    protocol.TrialWalks: {
        "shortened: a walk has some hundred samples": {
            "walks": [
                {
                    "distance": 9.2,
                    "steps": 13,
                    "imu": {
                        "t": [1767225600.96, 1767225600.98],
                        "ax": [0.1, 0.2],
                        "ay": [0.3, 0.1],
                        "az": [9.8, 9.9],
                        "gx": [0, 0],
                        "gy": [0, 0],
                        "gz": [0.01, 0.01],
                    },
                }
            ]
        }
    },
    protocol.TrialWalksReply: {
        "of two walks": {
            "peak": 11.9,
            "mean": 10.6,
            "slope": 0.41,
            "offset": 0.01,
            "walks": [
                {"steps": 14, "cadence": 1.56, "step_length": 0.66},
                {"steps": 17, "cadence": 1.89, "step_length": 0.8},
            ],
        }
    },
    protocol.Position: {"in a zone": _POSITION},
    protocol.OwnAlerts: {
        "entered": {
            "alerts": [
                {
                    "t": 1767225601.9,
                    "kind": "enter",
                    "zone": "exhibit-1",
                    "name": "The first exhibit",
                    "floor": "ground",
                    "x": 7.02,
                    "y": 4.0,
                }
            ]
        }
    },
    protocol.ErrorReply: {
        "a field is wrong": {
            "status": 422,
            "detail": [
                {
                    "field": "imu.ax[3]",
                    "problem": "is not a finite number",
                    "found": "NaN or infinity",
                    "allowed": "finite numbers",
                }
            ],
            "retry_after": None,
        }
    },
    protocol.Batch: {
        "two samples and a scan": {
            "sent": 1767225601.0,
            "seq": 0,
            "imu": {
                "t": [1767225600.96, 1767225600.98],
                "ax": [0.1, 0.2],
                "ay": [0.3, 0.1],
                "az": [9.8, 9.9],
                "gx": [0, 0],
                "gy": [0, 0],
                "gz": [0.01, 0.01],
                "mx": [0, 0],
                "my": [20, 20],
                "mz": [-43, -43],
            },
            "radio": [
                {
                    "t": 1767225600.5,
                    "kind": "wifi",
                    "address": ["02:a7:00:00:00:01", "02:a7:00:00:00:02"],
                    "rssi": [-52, -61],
                }
            ],
        },
        "a beacon scan alone, with the last reply echoed": {
            "sent": 1767225602.0,
            "seq": 1,
            "radio": [{"t": 1767225601.7, "kind": "ble", "address": ["02:a7:00:00:00:03"], "rssi": [-70]}],
            "echo": {"replied": 1767225601.031, "arrived": 1767225601.06},
        },
    },
    SensorLoggerPush: {
        "two samples": {
            "messageId": 0,
            "sessionId": "5b0f1f5e-2a3c-4f0a-9a39-0c6f4a7b1d21",
            "deviceId": "9d1c64c2-77b1-4c05-8f56-8c1f9d0c1b7e",
            "payload": [
                {"name": "totalacceleration", "time": 1767225600960000000, "values": {"x": 0.1, "y": 0.3, "z": 9.8}},
                {"name": "gyroscope", "time": 1767225600960000000, "values": {"x": 0.0, "y": 0.0, "z": 0.01}},
                {"name": "totalacceleration", "time": 1767225600980000000, "values": {"x": 0.2, "y": 0.1, "z": 9.9}},
                {"name": "gyroscope", "time": 1767225600980000000, "values": {"x": 0.0, "y": 0.0, "z": 0.01}},
            ],
        }
    },
    AdapterReply: {
        "accepted": {
            "duplicate": False,
            "received": 1767225601.03,
            "late": False,
            "accepted": {"samples": 2, "scans": 0, "readings": 0},
            "ignored": {},
        }
    },
    Find3Post: {
        "what a phone heard": {
            "d": "visitor-17",
            "f": "hall",
            "t": 1767225600897,
            "s": {"wifi": {"02:a7:00:00:00:01": -47}, "bluetooth": {"02:a7:00:00:00:0b": -72}},
        }
    },
    Find3Reply: {"taken": {"success": True, "message": "inserted data"}},
}
