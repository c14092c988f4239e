"""What does a phone write to the gateway? Its batch as the JSON that ``docs/phone-app.md`` asks for."""

from __future__ import annotations

from typing import Any

import numpy as np

from services.simulator.phones.phone_batch import PhoneBatch

__all__ = ["body_of"]


def body_of(batch: PhoneBatch, epoch: float = 0.0) -> dict[str, Any]:
    """Return the body of ``POST …/batches`` without ``echo``: plain lists, times on the phone's clock.

    Args:
        batch: what was measured.
        epoch: true time of world second zero; 0 leaves world seconds.
    """
    body: dict[str, Any] = {"sent": epoch + batch.sent_stamp, "seq": batch.seq}
    columns = batch.imu
    if columns is not None:
        body["imu"] = {"t": np.round(epoch + columns.pop("t"), 4).tolist()}
        body["imu"].update((name, np.round(column, 4).tolist()) for name, column in columns.items())
    body["radio"] = [
        {"t": round(epoch + t, 4), "kind": scan.kind, "address": list(scan.address), "rssi": list(scan.rssi)}
        for t, scan in zip(batch.scan_stamps.tolist(), batch.scans, strict=True)
    ]
    return body
