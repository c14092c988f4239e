"""What tells one calibration of a camera from another."""

from __future__ import annotations

import hashlib

from shared.site.site_file import PointsGeometry, PoseGeometry, TsaiGeometry

__all__ = ["geometry_digest"]


def geometry_digest(geometry: TsaiGeometry | PointsGeometry | PoseGeometry) -> str:
    """Return 16 hexadecimal digits of what a calibration says, of a Tsai calibration what its file says."""
    told = geometry.file.read_bytes() if isinstance(geometry, TsaiGeometry) else geometry.model_dump_json().encode()
    return hashlib.sha256(told).hexdigest()[:16]
