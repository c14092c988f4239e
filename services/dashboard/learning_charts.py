"""The charts of the learning page, as options of Apache ECharts.

Lines are told apart by colour (Okabe and Ito's, for the colour blind too), by dashes and by marks.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from shared.learning_report import AccessPointFit, CameraLessons, DeviceLessons
from shared.walking.stride import by_height

__all__ = ["device_name", "path_loss_chart", "score_chart", "stride_chart"]

COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#5b5b00", "#26323f")
DASHES = ("solid", "dashed", "dotted")
MARKS = ("circle", "rect", "triangle", "diamond")
DISTANCES = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Metres."""
CADENCES = (1.3, 2.3)
"""Steps per second people walk with."""
FINE_POINTS = 240
"""Points of a line; more of them are thinned out."""

Options = dict[str, Any]


def path_loss_chart(fits: Sequence[AccessPointFit]) -> Options:
    """Return how strong each access point is expected to be at a distance."""
    series = [
        _line(
            number,
            fit.access_point,
            [[d, round(fit.power_1m - 10.0 * fit.path_loss_exponent * math.log10(d), 1)] for d in DISTANCES],
        )
        for number, fit in enumerate(fits)
        if fit.state != "not placed"
    ]
    axis = _axis("distance, m") | {"type": "log", "logBase": 2, "min": 1, "max": 32}
    return _chart(series, axis, _axis("expected, dBm") | {"scale": True})


def score_chart(cameras: Sequence[CameraLessons]) -> Options:
    """Return how well the tracks each camera feeds are supported, over time."""
    series = []
    for number, camera in enumerate(cameras):
        every = max(1, math.ceil(len(camera.score_t) / FINE_POINTS))
        points = list(zip(camera.score_t, camera.score, strict=False))[::every]
        series.append(_line(number, camera.camera, [[1000.0 * t, round(score, 3)] for t, score in points]))
    return _chart(series, {"type": "time"}, _axis("quality per second") | {"scale": True})


def stride_chart(devices: Sequence[DeviceLessons]) -> Options:
    """Return each phone's step length by cadence: used ones as a line, others dotted, and what is usual in grey."""
    lengths = by_height(np.array(CADENCES))
    usual = _line(0, "usual", [[c, round(float(m), 3)] for c, m in zip(CADENCES, lengths, strict=True)])
    usual |= {"lineStyle": {"color": "#9aa4b0", "width": 6, "opacity": 0.5}, "itemStyle": {"color": "#9aa4b0"}}
    series = [usual | {"symbol": "none"}]
    for number, device in enumerate(devices):
        if device.slope is None or device.offset is None:
            continue
        line = _line(number, device_name(device.device), _ends(device.slope, device.offset))
        line["lineStyle"]["type"] = "solid" if device.used else "dotted"
        series.append(line)
    axis = _axis("steps per second") | {"min": CADENCES[0], "max": CADENCES[1]}
    return _chart(series, axis, _axis("step length, m") | {"scale": True})


def device_name(device: str) -> str:
    """Return how the page calls a phone: as the live map does, by the last signs of its id."""
    return f"Phone {device[-4:] if len(device) > 10 else device}"


def _ends(slope: float, offset: float) -> list[list[float]]:
    return [[cadence, round(slope * cadence + offset, 3)] for cadence in CADENCES]


def _line(number: int, name: str, points: list[list[float]]) -> Options:
    colour = COLOURS[number % len(COLOURS)]
    return {
        "type": "line",
        "name": name,
        "data": points,
        "symbol": MARKS[number % len(MARKS)],
        "symbolSize": 7,
        "showAllSymbol": len(points) < 20,
        "showSymbol": len(points) < 20,
        "itemStyle": {"color": colour},
        "lineStyle": {"color": colour, "width": 2, "type": DASHES[number // len(COLOURS) % len(DASHES)]},
    }


def _axis(name: str) -> Options:
    return {"type": "value", "name": name, "nameLocation": "middle", "nameGap": 28}


def _chart(series: list[Options], x: Options, y: Options) -> Options:
    return {
        "animation": False,
        "aria": {"enabled": True},
        "textStyle": {"fontFamily": "inherit", "color": "#26323f"},
        "grid": {"left": 56, "right": 18, "top": 40, "bottom": 44},
        "legend": {"type": "scroll", "top": 4, "left": 8, "right": 8},
        "tooltip": {"trigger": "axis", "confine": True},
        "xAxis": x,
        "yAxis": y | {"nameGap": 40},
        "series": series,
    }
