"""A learned map drawn on its floor plan: one SVG, with its legend, that needs nothing else.

Colours are told apart by people who are colour blind as well: cividis from little to much, and blue over white to
orange for what is above and below.
"""

from __future__ import annotations

import html
from collections.abc import Callable, Sequence

from shared.learning_report import MapGrid
from shared.site import AccessPoint, Floor

__all__ = ["map_svg"]

Place = Callable[[float, float], tuple[float, float]]
"""From metres on the plan to pixels."""

CIVIDIS = ("#00224e", "#123570", "#3b496c", "#575d6d", "#707173", "#8a8678", "#a59c74", "#c3b369", "#e1cc55", "#fee838")
BLUE_ORANGE = (
    "#2d3f8f", "#4f6bb5", "#8098cf", "#b3c1e3", "#dfe4f0", "#f6e3cc", "#f2c48c", "#e59c49", "#c8741a", "#96520c",
)  # fmt: skip
WIDTH = 720.0
"""Pixels; the height follows the plan."""
MARGIN = 16.0
LEGEND = 68.0
HIGHEST = 2.5
"""Times the width."""
FINE = 3.0
"""Ends of a scale that differ by less are told with decimals."""

_TITLES = {
    "visits": "Where people walked",
    "occlusion": "Where nobody walks although many pass close by",
    "radio": "What a phone is expected to hear of {subject}",
    "shadowing": "What the plain distance law gets wrong of {subject}",
    "magnetic": "Strength of the magnetic field",
}
_WORDS = {
    "visits": ("seldom", "often"),
    "radio": ("weak", "strong"),
    "shadowing": ("weaker than by distance", "stronger"),
    "magnetic": ("weak", "strong"),
}


def map_svg(grid: MapGrid, floor: Floor, access_points: Sequence[AccessPoint]) -> str:
    """Return the picture of a map.

    Args:
        grid: the map.
        floor: it lies on; drawn over it.
        access_points: of the floor; the one the map is of is marked. Those nobody has placed are left out.
    """
    x0, y0 = (min(point[axis] for point in floor.outline) for axis in (0, 1))
    x1, y1 = (max(point[axis] for point in floor.outline) for axis in (0, 1))
    wide, high = max(x1 - x0, 1e-6), max(y1 - y0, 1e-6)
    scale = min((WIDTH - 2 * MARGIN) / wide, HIGHEST * WIDTH / high)

    def place(x: float, y: float) -> tuple[float, float]:
        return MARGIN + (x - x0) * scale, MARGIN + (y1 - y) * scale

    height = high * scale + 2 * MARGIN + LEGEND
    title = _TITLES[grid.kind].format(subject=grid.subject)
    known = [value for row in grid.rows for value in row if value is not None]
    low, top = _range(grid.kind, known)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH:.0f} {height:.0f}" role="img" '
        f'font-family="system-ui, sans-serif" font-size="17"><title>{html.escape(title)}</title>',
        f'<rect width="{WIDTH:.0f}" height="{height:.0f}" fill="#fff"/>',
        f'<path d="{_ring(floor.outline, place)}" fill="#eef1f5"/>',
    ]
    side = grid.cell * scale
    parts += _cells(grid, low, top, place, side)
    for obstacle in floor.obstacles:
        parts.append(
            f'<path d="{_ring(obstacle.polygon, place)}" fill="none" stroke="#4a5563" stroke-dasharray="4 3"/>'
        )
    for wall in floor.walls:
        parts.append(f'<path d="{_line(wall, place)}" fill="none" stroke="#26323f" stroke-width="3"/>')
    parts.append(f'<path d="{_ring(floor.outline, place)}" fill="none" stroke="#26323f" stroke-width="1.5"/>')
    for point in access_points:
        parts += _access_point(point, place, marked=point.id == grid.subject)
    parts += _legend(grid, low, top, bool(known), height - LEGEND + 12.0)
    return "".join([*parts, "</svg>"])


def _range(kind: str, known: Sequence[float]) -> tuple[float, float]:
    """Return what the ends of the colour scale stand for: all but the few most extreme cells lie between."""
    if kind == "occlusion" or not known:
        return 0.0, 1.0
    ordered = sorted(known)
    cut = int(0.02 * len(ordered))
    low, top = ordered[cut], ordered[-1 - cut]
    if kind == "visits":
        low = 0.0
    if kind == "shadowing":
        top = max(abs(low), abs(top), 1.0)
        low = -top
    return low, max(top, low + 1e-6)


def _palette(kind: str) -> tuple[str, ...]:
    if kind == "occlusion":
        return ("#dbe7f3", "#96520c")
    return BLUE_ORANGE if kind == "shadowing" else CIVIDIS


def _ring(points: Sequence[tuple[float, float]], place: Place) -> str:
    return f"{_line(points, place)}Z"


def _line(points: Sequence[tuple[float, float]], place: Place) -> str:
    return "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in (place(*point) for point in points))


def _access_point(point: AccessPoint, place: Place, marked: bool) -> list[str]:
    if point.position is None:
        return []
    x, y = place(point.position[0], point.position[1])
    if not marked:
        return [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="#fff" stroke="#26323f"/>']
    name, anchor = html.escape(point.id), "end" if x > 0.5 * WIDTH else "start"
    shift = -13.0 if x > 0.5 * WIDTH else 13.0
    return [
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="8" fill="#fff" stroke="#26323f" stroke-width="3"/>',
        f'<text x="{x + shift:.1f}" y="{y + 5:.1f}" text-anchor="{anchor}" font-weight="700" stroke="#fff" '
        f'stroke-width="4" paint-order="stroke" fill="#26323f">{name}</text>',
    ]


def _cells(grid: MapGrid, low: float, top: float, place: Place, side: float) -> list[str]:
    """Return one path for each colour; cells of one colour side by side are one rectangle."""
    colours = _palette(grid.kind)
    paths: dict[str, list[str]] = {}
    for row, values in enumerate(grid.rows):
        levels = [-1 if value is None else _level(value, low, top, len(colours)) for value in values]
        begin = 0
        for column in range(1, len(levels) + 1):
            if column < len(levels) and levels[column] == levels[begin]:
                continue
            if levels[begin] >= 0:
                x, y = place(grid.origin[0] + (begin - 0.5) * grid.cell, grid.origin[1] + (row + 0.5) * grid.cell)
                wide = (column - begin) * side
                path = f"M{x:.1f} {y:.1f}h{wide:.1f}v{side:.1f}h{-wide:.1f}z"
                paths.setdefault(colours[levels[begin]], []).append(path)
            begin = column
    return [
        f'<path fill="{colour}" shape-rendering="crispEdges" d="{"".join(path)}"/>' for colour, path in paths.items()
    ]


def _level(value: float, low: float, top: float, count: int) -> int:
    return min(max(int((value - low) / (top - low) * count), 0), count - 1)


def _legend(grid: MapGrid, low: float, top: float, known: bool, y: float) -> list[str]:
    text = '<text x="{x:.0f}" y="{y:.0f}" fill="#26323f"{more}>{words}</text>'
    box = (
        '<rect x="{x:.0f}" y="{y:.0f}" width="{w:.0f}" height="16" fill="{colour}" stroke="#8a94a0" stroke-width=".5"/>'
    )
    if not known:
        return [text.format(x=MARGIN, y=y + 12, more="", words="Nothing is known of this area yet.")]
    if grid.kind == "occlusion":
        words = (("#96520c", "blocked"), ("#dbe7f3", "walked on"), ("#eef1f5", "not known yet"))
        parts = []
        for number, (colour, word) in enumerate(words):
            x = MARGIN + 190.0 * number
            parts += [box.format(x=x, y=y, w=26, colour=colour), text.format(x=x + 34, y=y + 14, more="", words=word)]
        return parts
    colours = _palette(grid.kind)
    wide = 36.0
    parts = [box.format(x=MARGIN + n * wide, y=y, w=wide, colour=colour) for n, colour in enumerate(colours)]
    end = MARGIN + wide * len(colours)
    few, many = _WORDS[grid.kind]
    digits = 0 if top - low >= FINE else 1 if top - low >= 0.1 * FINE else 2
    first, last = f"{low:.{digits}f} ({few})", f"{top:.{digits}f} {grid.unit} ({many})"
    parts.append(text.format(x=MARGIN, y=y + 34, more="", words=html.escape(first)))
    parts.append(text.format(x=end, y=y + 34, more=' text-anchor="end"', words=html.escape(last)))
    parts.append(box.format(x=end + 24, y=y, w=26, colour="#eef1f5"))
    parts.append(text.format(x=end + 58, y=y + 14, more="", words="not known yet"))
    return parts
