"""Bodies of the camera set-up: what is asked and what is answered. Pixels, metres on the plan, degrees."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import msgspec

from services.api.replies import Reply, Ring
from shared.site.calibration import MOST_PAIRS

__all__ = [
    "CALIBRATION_EXAMPLES",
    "BoardCorners",
    "BoardMark",
    "CalibrationSave",
    "CalibrationSaved",
    "CalibrationTrial",
    "CalibrationTry",
    "CalibrationView",
    "GridLineView",
    "Pair",
    "PairReport",
    "Placement",
    "PlacementSave",
    "Placements",
    "RectangleMark",
    "StillOpened",
]

Metre = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
Pixel = Annotated[float, msgspec.Meta(ge=-1e5, le=1e5)]
Length = Annotated[float, msgspec.Meta(gt=0, le=1000)]
Degrees = Annotated[float, msgspec.Meta(ge=-360, le=360)]
Side = Annotated[int, msgspec.Meta(ge=16, le=16384)]
Corners = Annotated[int, msgspec.Meta(ge=3, le=30)]


class Order(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A body that is sent."""


class Pair(Order, frozen=True, kw_only=True):
    """A pixel, and the place on the floor it shows."""

    pixel: tuple[Pixel, Pixel]
    place: tuple[Metre, Metre]


class RectangleMark(Order, frozen=True, kw_only=True):
    """A rectangle of known size on the floor: its corners counter-clockwise on the plan, the first at ``corner``."""

    pixels: Annotated[list[tuple[Pixel, Pixel]], msgspec.Meta(min_length=4, max_length=4)]
    corner: tuple[Metre, Metre]
    angle: Degrees = 0.0
    """Direction from the first corner to the second, counter-clockwise from +x."""
    width: Length
    """From the first corner to the second."""
    depth: Length


class BoardMark(Order, frozen=True, kw_only=True):
    """A checkerboard lying on the floor: its inner corners as ``…/board`` found them, the first at ``corner``."""

    pixels: Annotated[list[tuple[Pixel, Pixel]], msgspec.Meta(min_length=9, max_length=900)]
    columns: Corners
    rows: Corners
    square: Annotated[float, msgspec.Meta(gt=0, le=10)]
    corner: tuple[Metre, Metre]
    angle: Degrees = 0.0
    """Direction of the first row."""


class CalibrationTry(Order, frozen=True, kw_only=True):
    """Pairs to try: clicked ones, and those of rectangles and checkerboards."""

    image_size: tuple[Side, Side]
    pairs: Annotated[list[Pair], msgspec.Meta(max_length=MOST_PAIRS)] = []
    rectangles: Annotated[list[RectangleMark], msgspec.Meta(max_length=10)] = []
    boards: Annotated[list[BoardMark], msgspec.Meta(max_length=5)] = []
    use_lens: bool = True
    """Whether a calibrated lens of this camera is taken into account."""


class CalibrationSave(Order, frozen=True, kw_only=True):
    """Pairs to save, with the area of interest; what a trial left out as wrong is left out here too."""

    image_size: tuple[Side, Side]
    pairs: Annotated[list[Pair], msgspec.Meta(min_length=4, max_length=MOST_PAIRS)]
    area_of_interest: Annotated[list[tuple[Pixel, Pixel]], msgspec.Meta(max_length=100)] | None = None
    """Pixels; null: the whole picture."""
    use_lens: bool = True


class StillOpened(Reply, frozen=True, kw_only=True):
    """Stills of one camera may be fetched until then."""

    words: str
    until: float


class BoardCorners(Reply, frozen=True, kw_only=True):
    """The inner corners of a checkerboard in the picture, row by row."""

    image_size: tuple[int, int]
    corners: Ring


class PairReport(Reply, frozen=True, kw_only=True):
    """One pair and how far off it is. Null: not to be told."""

    pixel: tuple[float, float]
    place: tuple[float, float]
    used: bool
    """False: it is taken for a wrong click, and was left out."""
    off_pixels: float | None
    off_metres: float | None
    alone_metres: float | None
    """Metres off by a camera fitted to all others."""
    shown: tuple[float, float] | None
    """Where the camera shows the place."""
    seen: tuple[float, float] | None
    """What place it sees at the pixel."""


class GridLineView(Reply, frozen=True, kw_only=True):
    """One line of a grid on the floor, as stretches of pixels."""

    axis: Literal["x", "y"]
    at: float
    pixels: list[Ring]


class CalibrationTrial(Reply, frozen=True, kw_only=True):
    """What comes of some pairs; nothing is stored."""

    camera: str
    pairs: list[PairReport]
    """All of them: clicked ones first, then those of rectangles, then of checkerboards."""
    median_metres: float
    """Of the used pairs' distances on the floor."""
    median_alone_metres: float | None
    """The same with each pair left out in turn: what to expect where nobody clicked."""
    position: tuple[float, float, float]
    """Where the camera hangs: hold it against the ceiling."""
    horizontal_fov: float
    """Degrees."""
    lens: bool
    """Whether a calibrated lens was taken into account."""
    words: list[str]
    """What to know, for who clicks."""
    step: float
    grid: list[GridLineView]
    footprint: Ring
    """The floor the camera sees, on the plan."""


class CalibrationView(Reply, frozen=True, kw_only=True):
    """How a camera is calibrated now: as saved, or else as the site file says."""

    camera: str
    floor: str
    kind: Literal["points", "pose", "tsai"]
    image_size: tuple[int, int]
    pairs: list[Pair]
    area_of_interest: Ring | None
    lens: bool
    saved: float | None
    """When it was saved in the browser; null: it is the site file's."""
    by: str
    pending: bool
    """The camera does not use it yet: it takes up what is saved within seconds, when it runs and sees pictures."""


class CalibrationSaved(Reply, frozen=True, kw_only=True):
    """It is on the disk."""

    words: str
    version: int


class Placement(Reply, frozen=True, kw_only=True):
    """One access point and where it hangs."""

    id: str
    floor: str
    kind: Literal["wifi", "ble"]
    position: tuple[Metre, Metre, Metre] | None
    saved: float | None
    """When it was placed in the browser; null: it is the site file's."""


class Placements(Reply, frozen=True, kw_only=True):
    """All access points of the site."""

    access_points: list[Placement]


class PlacementSave(Order, frozen=True, kw_only=True):
    """Where some access points hang, [x, y, z] in metres; null: as the site file says."""

    positions: Annotated[
        dict[str, tuple[Metre, Metre, Annotated[float, msgspec.Meta(ge=-10, le=100)]] | None],
        msgspec.Meta(min_length=1, max_length=10_000),
    ]


_PAIRS: list[dict[str, Any]] = [
    {"pixel": [1036.0, 868.0], "place": [5.0, 3.0]},
    {"pixel": [1330.0, 546.0], "place": [11.0, 3.5]},
    {"pixel": [1009.0, 401.0], "place": [15.0, 10.0]},
    {"pixel": [542.0, 571.0], "place": [6.0, 9.0]},
]
_OFF = {"used": True, "off_pixels": 0.4, "off_metres": 0.01, "alone_metres": None, "shown": [1036.3, 868.2]}
_AREA = [[0.0, 1079.0], [0.0, 380.0], [1919.0, 380.0], [1919.0, 1079.0]]
_BOARD = [[100.0 + 40 * column, 300.0 + 30 * row] for row in range(3) for column in range(3)]

CALIBRATION_EXAMPLES: dict[type[msgspec.Struct], dict[str, Any]] = {
    CalibrationTry: {
        "image_size": [1920, 1080],
        "pairs": _PAIRS,
        "rectangles": [
            {"pixels": _AREA, "corner": [2.0, 1.0], "angle": 0.0, "width": 6.0, "depth": 4.0},
        ],
        "boards": [
            {"pixels": _BOARD, "columns": 3, "rows": 3, "square": 0.1, "corner": [4.0, 2.0], "angle": 90.0},
        ],
        "use_lens": True,
    },
    CalibrationSave: {"image_size": [1920, 1080], "pairs": _PAIRS, "area_of_interest": _AREA, "use_lens": True},
    PlacementSave: {"positions": {"ap-1": [2.0, 13.5, 2.8]}},
    StillOpened: {"words": "camera lobby gives stills for 15 minutes", "until": 1767226500.0},
    BoardCorners: {"image_size": [1920, 1080], "corners": _BOARD},
    CalibrationTrial: {
        "camera": "lobby",
        "pairs": [{**_PAIRS[0], **_OFF, "seen": [5.01, 3.0]}],
        "median_metres": 0.01,
        "median_alone_metres": None,
        "position": [0.4, 0.9, 3.1],
        "horizontal_fov": 84.0,
        "lens": False,
        "words": ["Fitted camera: 3.1 m above the floor at (0.4, 0.9)."],
        "step": 1.0,
        "grid": [{"axis": "x", "at": 5.0, "pixels": [[[1036.0, 1079.0], [1030.0, 860.0]]]}],
        "footprint": [[1.0, 1.0], [15.0, 1.0], [15.0, 12.0], [1.0, 9.0]],
    },
    CalibrationView: {
        "camera": "lobby",
        "floor": "ground",
        "kind": "points",
        "image_size": [1920, 1080],
        "pairs": _PAIRS,
        "area_of_interest": _AREA,
        "lens": False,
        "saved": 1767225600.0,
        "by": "installer",
        "pending": False,
    },
    CalibrationSaved: {
        "words": "Saved: camera lobby, fusion of ground-floor and learning take it up within seconds, and nothing need "
        "be started again. A correction learned for the calibration before is taken back.",
        "version": 3,
    },
    Placements: {
        "access_points": [
            {"id": "ap-1", "floor": "ground", "kind": "wifi", "position": [2.0, 13.5, 2.8], "saved": None}
        ]
    },
}
