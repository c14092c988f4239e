"""The learning page in words and tables: HTML made of a report. All text in it comes from elsewhere and is escaped."""

from __future__ import annotations

import math
from collections.abc import Sequence
from html import escape

from services.dashboard.learning_charts import device_name
from shared.learning_report import (
    AccessPointFit,
    Activation,
    AreaLessons,
    CameraLessons,
    DeviceLessons,
    LearningReport,
    TrackLessons,
)

__all__ = [
    "access_points_table",
    "accuracy_table",
    "cameras_table",
    "devices_table",
    "history_table",
    "model_name",
    "moment",
    "summary",
]

_SIGNS = {
    "fine": "✓", "few readings": "…", "changed": "▲", "moved": "◆", "silent": "✕",
    "not placed": "?", "unknown": "…", "doubtful": "?", "knocked": "▲", "corrected": "✓",
    "activated": "✓", "refused": "–", "rolled back": "↶", "imported": "↓",
}  # fmt: skip
"""So that nothing is said by colour alone."""
_TONES = {
    "fine": "good", "corrected": "good", "activated": "good", "imported": "good",
    "changed": "wait", "doubtful": "wait", "rolled back": "wait", "moved": "wait", "knocked": "bad", "silent": "bad",
    "not placed": "wait",
}  # fmt: skip
_KINDS = {
    "radio": "radio model",
    "detector": "detector settings",
    "stride": "stride",
    "heading": "heading",
    "alignment": "camera alignment",
}
REASONS = 4
"""Why walks do not teach that are told at most."""
NOTHING = '<p class="empty">{words}</p>'


def summary(report: LearningReport) -> str:
    """Return what goes on now, one sentence a line."""
    lines = []
    if report.frozen:
        lines.append("<strong>Frozen by hand:</strong> what is learned does not go live until somebody unfreezes it.")
    for area in report.areas:
        lines.append(f"<strong>Area {escape(area.area)}:</strong> {_sentence(area)}{_walks(area.tracks)}")
        lines += [_warning(fit.access_point, fit.state, fit.words + _place(fit)) for fit in _odd(area)]
    for camera in report.cameras:
        if camera.words and camera.alignment not in ("doubtful", "knocked"):
            lines.append(f"<strong>Camera {escape(camera.camera)}:</strong> {escape(camera.words)}")
        elif camera.alignment in ("doubtful", "knocked"):
            lines.append(_warning(camera.camera, camera.alignment, camera.words or "look whether it still hangs right"))
    if not lines:
        return NOTHING.format(words="Learning has just started: nobody with a phone has walked yet.")
    return '<ul class="now">' + "".join(f"<li>{line}</li>" for line in lines) + "</ul>"


def accuracy_table(areas: Sequence[AreaLessons]) -> str:
    """Return how far off Atrium believes to be, by area."""
    known = [area for area in areas if area.accuracy.rms is not None]
    if not known:
        return NOTHING.format(words="Not known yet: it takes some minutes of people with phones who walk.")
    rows = [
        [
            escape(area.area),
            _number(area.accuracy.p50, 2),
            _number(area.accuracy.p90, 2),
            _number(area.accuracy.rms, 2),
            _share(area.accuracy.named),
            _share(area.accuracy.right),
            _span(area.accuracy.seconds),
        ]
        for area in known
    ]
    heads = ["area", "half within, m", "90 % within, m", "rms, m", "phones with a name", "names right", "rests on"]
    return _table(heads, rows)


def access_points_table(area: AreaLessons) -> str:
    """Return the fit and the residuals of each access point of one area."""
    if not area.access_points:
        return NOTHING.format(words=escape(area.words) or "Nobody with a phone has walked here yet.")
    rows = [
        [
            escape(fit.access_point),
            _state(fit.state),
            _number(fit.power_1m, 1),
            _number(fit.path_loss_exponent, 2),
            _residual(fit),
            _number(fit.readings, 0),
            escape(fit.words) + _place(fit),
        ]
        for fit in area.access_points
    ]
    heads = ["access point", "state", "P₀, dBm", "n", "heard − expected, dB", "readings", ""]
    return _table(heads, rows)


def cameras_table(cameras: Sequence[CameraLessons]) -> str:
    """Return how each camera stands, in space and in time."""
    if not cameras:
        return NOTHING.format(words="This site has no camera.")
    rows = [
        [
            escape(camera.camera),
            _state(camera.alignment),
            _number(camera.offset, 2),
            _number(camera.clock, 2, signed=True) + (f" ± {camera.clock_error:.2f}" if camera.clock_error else ""),
            _number(camera.score[-1] if camera.score else None, 2),
            ", ".join(f"{escape(name)} {value:g}" for name, value in camera.options.items()) or "as configured",
            escape(camera.words),
        ]
        for camera in cameras
    ]
    heads = ["camera", "alignment", "off by, m", "pictures late by, s", "quality", "options", ""]
    return _table(heads, rows)


def devices_table(devices: Sequence[DeviceLessons]) -> str:
    """Return what was learned of each phone."""
    if not devices:
        return NOTHING.format(words="Nobody with a phone has walked yet, or this dashboard may not know of phones.")
    rows = [
        [
            escape(device_name(device.device)),
            "in use" if device.used else "not sure yet",
            _number(device.r2, 2),
            _number(device.steps, 0),
            _degrees(device.heading_bias)
            + ("" if device.heading_error is None else f" ± {_degrees(device.heading_error)}"),
            _number(device.radio_offset, 1, signed=True),
        ]
        for device in devices
    ]
    return _table(["phone", "own stride", "R²", "steps", "heading turned by, °", "hears more by, dB"], rows)


def history_table(history: Sequence[Activation]) -> str:
    """Return what was decided, newest first, with reasons and evidence."""
    if not history:
        return NOTHING.format(
            words="Nothing was decided yet: a candidate must first win on walks it did not learn from."
        )
    rows = [
        [
            moment(row.t),
            escape(model_name(row)),
            _state(row.decision),
            escape(row.reason) + (" <em>(by hand)</em>" if row.by == "operator" else ""),
            _number(row.gain, 2, signed=True) + ("" if row.margin is None else f" (needs {row.margin:.2f})"),
            ", ".join(f"{escape(name)} {value:g}" for name, value in row.evidence.items()),
        ]
        for row in history
    ]
    return _table(["when", "what", "decision", "why", "gain", "evidence"], rows)


def model_name(row: Activation) -> str:
    """Return what a model is called, not escaped."""
    subject = device_name(row.subject) if row.kind in ("stride", "heading") else row.subject
    return f"{_KINDS[row.kind]} of {subject}, version {row.version}"


def moment(t: float) -> str:
    """Return a time that the browser writes in its own time zone."""
    return f'<time data-t="{t:.0f}"></time>'


def _warning(subject: str, state: str, words: str) -> str:
    sign = f'<span class="state {_TONES.get(state, "")}"><b aria-hidden="true">{_SIGNS[state]}</b></span>'
    return f"{sign} <strong>{escape(subject)}</strong> ({state}): {escape(words)}"


def _sentence(area: AreaLessons) -> str:
    if area.words:
        return escape(area.words)
    if area.version:
        return f"radio model {area.version} is active."
    return "the radio is as the site file says; nothing better is known yet."


def _walks(tracks: TrackLessons) -> str:
    """Return how many of the last walks teach, and why the others do not, the commonest reasons first."""
    unused = sum(tracks.refused.values())
    if not tracks.good + unused:
        return ""
    reasons = sorted(tracks.refused.items(), key=lambda row: -row[1])[:REASONS]
    why = ", ".join(f"{escape(reason)} ({count})" for reason, count in reasons)
    said = f"{tracks.good} of the last {tracks.good + unused} walks teach"
    return f'<br><span class="count">{said}{f"; the others do not: {why}" if why else ""}.</span>'


def _odd(area: AreaLessons) -> list[AccessPointFit]:
    return [
        fit for fit in area.access_points if fit.words and fit.state in ("changed", "moved", "silent", "not placed")
    ]


def _state(state: str) -> str:
    return f'<span class="state {_TONES.get(state, "")}"><b aria-hidden="true">{_SIGNS[state]}</b> {state}</span>'


def _residual(fit: AccessPointFit) -> str:
    """Return mean and spread of the residuals, as numbers and as a bar from −12 to 12 dB."""
    if fit.bias is None or fit.sigma is None or not math.isfinite(fit.bias + fit.sigma):
        return "–"

    def at(level: float) -> float:
        return 60.0 + 5.0 * min(max(level, -12.0), 12.0)

    left, right = at(fit.bias - fit.sigma), at(fit.bias + fit.sigma)
    bar = (
        '<svg class="residual" viewBox="0 0 120 14" aria-hidden="true"><path d="M60 0V14" stroke="#9aa4b0"/>'
        f'<rect x="{left:.1f}" y="4" width="{right - left:.1f}" height="6" rx="3" fill="#0072b2" opacity=".35"/>'
        f'<circle cx="{at(fit.bias):.1f}" cy="7" r="4" fill="#0072b2"/></svg>'
    )
    return f"{bar} <span>{_number(fit.bias, 1, signed=True)} ± {fit.sigma:.1f}</span>"


def _place(fit: AccessPointFit) -> str:
    if fit.position is None:
        return ""
    sure = "" if fit.position_error is None else f" to within {fit.position_error:.1f} m"
    return f" Heard from ({fit.position[0]:.1f}, {fit.position[1]:.1f}){sure}."


def _number(value: float | None, digits: int, signed: bool = False) -> str:
    if value is None:
        return "–"
    return f"{value:{'+' if signed else ''}.{digits}f}".replace("-", "−")


def _share(value: float | None) -> str:
    return "–" if value is None else f"{100.0 * value:.0f} %"


def _degrees(value: float | None) -> str:
    return "–" if value is None else f"{math.degrees(value):.0f}".replace("-", "−")


def _span(seconds: float) -> str:
    return f"{seconds / 3600.0:.1f} h" if seconds >= 3600.0 else f"{seconds / 60.0:.0f} min"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table that becomes a list of cards on a narrow screen, where each cell names its column."""
    head = "".join(f'<th scope="col">{escape(name)}</th>' for name in heads)
    body = "".join(
        "<tr>"
        + f'<th scope="row">{row[0]}</th>'
        + "".join(
            f'<td data-head="{escape(name)}"{"" if cell else " class=blank"}>{cell}</td>'
            for name, cell in zip(heads[1:], row[1:], strict=True)
        )
        + "</tr>"
        for row in rows
    )
    return f"<table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table>"
