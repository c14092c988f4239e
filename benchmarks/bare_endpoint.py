"""What the gateway's speed is measured against: a bare FastAPI endpoint with typed models of the same batch."""

from __future__ import annotations

import sys
import threading

from fastapi import FastAPI
from pydantic import BaseModel

from shared.http_server import serve

__all__ = ["app"]


class Imu(BaseModel):
    """Columns."""

    t: list[float]
    ax: list[float]
    ay: list[float]
    az: list[float]
    gx: list[float]
    gy: list[float]
    gz: list[float]
    mx: list[float]
    my: list[float]
    mz: list[float]


class Scan(BaseModel):
    """One scan."""

    t: float
    address: list[str]
    rssi: list[float]


class TypedBatch(BaseModel):
    """The batch that phones post."""

    sent: float
    seq: int
    imu: Imu
    radio: list[Scan]


class TypedReply(BaseModel):
    """A small reply."""

    seq: int
    samples: int
    readings: int


app = FastAPI()


@app.post("/v1/devices/{device}/batches")
async def post_batch(device: str, batch: TypedBatch) -> TypedReply:
    """Do nothing with a batch."""
    return TypedReply(seq=batch.seq, samples=len(batch.imu.t), readings=sum(len(scan.rssi) for scan in batch.radio))


if __name__ == "__main__":
    serve(app, "127.0.0.1", int(sys.argv[1]), threading.Event())
