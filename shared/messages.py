"""The language of the bus: one Struct per message, columnar, JSON on the wire.

Conventions (docs/architecture.md, "The bus"): ``t`` is the time of *measurement* in seconds since the epoch (UTC);
metres, seconds, radians, dBm, m/s², rad/s, µT; headings run counter-clockwise from the plan's +x axis. A message holds
parallel columns, never a list of small objects. Unknown fields are ignored, so that versions can meet. ``seq`` counts
the messages of one publisher since it started, so that gaps can be counted.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeVar

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

__all__ = [
    "Alert",
    "AlertKind",
    "CameraAlignment",
    "CameraStatus",
    "ChunkMark",
    "DetectionFrame",
    "DetectorSettings",
    "Erasure",
    "ErasureDone",
    "HeadingModel",
    "InertialColumns",
    "Message",
    "MessageError",
    "MotionBatch",
    "Occupancy",
    "RadioModelFile",
    "RadioModelUpdate",
    "RadioScan",
    "Revision",
    "StrideModel",
    "TrackFrame",
    "TrackState",
    "decode",
    "encode",
]

Probability = Annotated[float, Meta(ge=0.0, le=1.0)]
Covariance = tuple[float, float, float]
"""A symmetric 2 x 2 covariance in m², written (xx, xy, yy)."""
Box = tuple[float, float, float, float]
"""left, top, width, height in pixels of the camera's own image."""
AlertKind = Literal["enter", "exit", "dwell", "cross", "crowd", "proximity", "speed"]
TrackState = Literal["confirmed", "coasting", "unseen"]
"""``coasting``: no camera saw it just now; ``unseen``: a device followed by its steps and radio alone."""


class MessageError(ValueError):
    """A payload is not the message it should be: the text names the field and what was expected."""


class Message(msgspec.Struct, frozen=True, kw_only=True):
    """What every message carries: when it was *measured*."""

    t: float

    def __post_init__(self) -> None:
        """Parallel columns must be parallel: a message that is not is refused where it is made or decoded."""
        columns = self.columns()
        present = [name for name in self.optional_columns() if getattr(self, name)]
        for names in ((*columns, *present), self.event_columns()):
            if len({len(getattr(self, name)) for name in names}) > 1:
                lengths = {name: len(getattr(self, name)) for name in names}
                raise ValueError(f"{type(self).__name__}: columns of different lengths: {lengths}")

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """Names of the parallel columns, all of one length."""
        return ()

    @classmethod
    def optional_columns(cls) -> tuple[str, ...]:
        """Columns parallel to those that a sender may leave empty."""
        return ()

    @classmethod
    def event_columns(cls) -> tuple[str, ...]:
        """Columns parallel to each other, of a length of their own."""
        return ()


class DetectionFrame(Message, frozen=True, kw_only=True):
    """What one camera saw in one frame, on the ground plane; published also when nobody was seen."""

    camera: str
    floor: str
    seq: int
    x: list[float] = []
    y: list[float] = []
    covariance: list[Covariance] = []
    confidence: list[Probability] = []
    box: list[Box] = []

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per detection."""
        return ("x", "y", "covariance", "confidence", "box")


class CameraStatus(Message, frozen=True, kw_only=True):
    """How a camera is doing, published on change and cached for late joiners."""

    camera: str
    state: Literal["starting", "ok", "degraded", "ended"]
    reason: str = ""
    """In plain words, for an operator; empty when all is well."""
    frames: int = 0
    dropped: int = 0
    frames_per_s: float = 0.0
    origin: float | None = None
    """The measurement time of the source's first frame in this pass (a looping file has one per loop)."""
    settings_version: int = 0
    """Of the learned DetectorSettings in use; 0: as configured."""
    geometry: str = ""
    """``shared.site.geometry_digest`` of the calibration in use; empty where whoever tells does not say."""


class RadioScan(Message, frozen=True, kw_only=True):
    """Signal strengths one device measured (or was heard with) at one time, access points by their *site ids*."""

    device: str
    seq: int
    kind: Literal["wifi", "ble"] = "wifi"
    access_point: list[str] = []
    rssi: list[float] = []
    heard_by_site: bool = False
    """True where fixed receivers at these access points heard the device, not the other way round."""
    late: bool = False
    """True where it came too long after it was measured: for history and window fusion, not for live positions."""

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per access point heard."""
        return ("access_point", "rssi")


class MotionBatch(Message, frozen=True, kw_only=True):
    """What a phone's inertial data say about its walk between ``t_start`` and ``t``."""

    device: str
    seq: int
    t_start: float
    activity: Literal["still", "walking", "other"]
    step_t: list[float] = []
    """When each step ended, s."""
    step_t_variance: list[float] = []
    length: list[float] = []
    length_variance: list[float] = []
    """m², of one step taken by itself: with what all steps of a walk share (``length_scale_variance``)."""
    heading: list[float] = []
    heading_variance: list[float] = []
    """rad², of one step taken by itself: with what all steps of a walk share (``heading_bias_variance``)."""
    other_heading: list[float] = []
    """Where the heading is one of two (which side a phone is turned to, front or back of a pocket): the other one."""
    other_probability: list[Probability] = []
    """Of ``other_heading`` being right."""
    magnetic: list[float] = []
    """µT, strength of the magnetic field at each step, the phone's own iron taken off as far as it is known."""
    walk: int = 0
    """Counts up when steps begin anew: the steps of one walk share a heading bias and a stride scale."""
    heading_bias_variance: float = 0.0
    """rad², of the error all headings of this walk have in common; part of ``heading_variance``."""
    length_scale_variance: float = 0.0
    """Of the factor by which all lengths of this walk are wrong; ``length² x`` this is part of ``length_variance``."""
    turn_t: list[float] = []
    """When the phone's carrier had turned a corner, s."""
    turn: list[float] = []
    """By how much, radians, left is positive."""
    late: bool = False
    """True where it came too long after it was measured: for history and window fusion, not for live positions."""
    revises_from: float | None = None
    """Where set, steps since this time replace the ones published before."""

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per step."""
        return ("step_t", "length", "length_variance", "heading", "heading_variance")

    @classmethod
    def optional_columns(cls) -> tuple[str, ...]:
        """What not every sender knows of a step."""
        return ("step_t_variance", "other_heading", "other_probability", "magnetic")

    @classmethod
    def event_columns(cls) -> tuple[str, ...]:
        """One entry per turn."""
        return ("turn_t", "turn")


class InertialColumns(msgspec.Struct, frozen=True, kw_only=True):
    """Raw inertial samples in the phone's own axes (x right, y to the top, z out of the screen)."""

    t: list[float]
    ax: list[float]
    ay: list[float]
    az: list[float]
    gx: list[float]
    gy: list[float]
    gz: list[float]
    mx: list[float] = []
    my: list[float] = []
    mz: list[float] = []


class TrackFrame(Message, frozen=True, kw_only=True):
    """Everybody in one area at the time of the newest detection of one chunk.

    A pure function of the chunks before it: wall-clock stamps travel in the bus's attachment, never here, so that a
    live run and the replay of its recording are the same to the byte.
    """

    area: str
    chunk: int
    tracker: str
    cameras: list[str] | None = None
    """From which cameras frames are in this chunk, people seen or not; None: whoever tells does not say."""
    track: list[int] = []
    floor: list[str] = []
    x: list[float] = []
    y: list[float] = []
    covariance: list[Covariance] = []
    vx: list[float] = []
    vy: list[float] = []
    state: list[TrackState] = []
    device: list[str | None] = []
    """The device this person carries; None is "not sure" or "carries none"."""
    probability: list[Probability] = []
    """Of ``device`` being right; where device is None, of the person carrying none of the known ones."""
    runner_up: list[str | None] = []
    runner_up_probability: list[Probability] = []
    former: list[list[int]] = []
    """The ids of earlier tracks of the same person, oldest first."""
    sources: list[list[str]] = []
    """Cameras and devices that fed the track in this chunk."""
    quality: list[Probability] = []

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per track."""
        return (
            "track",
            "floor",
            "x",
            "y",
            "covariance",
            "vx",
            "vy",
            "state",
            "device",
            "probability",
            "runner_up",
            "runner_up_probability",
            "former",
            "sources",
            "quality",
        )


class Revision(Message, frozen=True, kw_only=True):
    """What fusion now thinks of some devices' last seconds, where it is no longer what its frames said.

    For device i all that was said of the times from ``since[i]`` to ``t`` is replaced by the points with
    ``of == i``, oldest first; a device without points was nowhere in this area.
    """

    area: str
    chunk: int
    tracker: str
    device: list[str] = []
    since: list[float] = []
    of: list[int] = []
    """Which device of ``device`` each point is of."""
    at: list[float] = []
    track: list[int] = []
    """The track that carried it; 0 where no camera saw it."""
    x: list[float] = []
    y: list[float] = []
    covariance: list[Covariance] = []
    probability: list[Probability] = []

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per point."""
        return ("of", "at", "track", "x", "y", "covariance", "probability")

    @classmethod
    def event_columns(cls) -> tuple[str, ...]:
        """One entry per device."""
        return ("device", "since")


class ChunkMark(Message, frozen=True, kw_only=True):
    """Fusion closed a chunk: the trace ids of exactly what it consumed, in order. What makes replay exact."""

    area: str
    chunk: int
    t_start: float
    t_end: float
    consumed: list[str] = []


class Alert(Message, frozen=True, kw_only=True):
    """Something a rule of a zone asks for: somebody entered or left it, stayed, crossed a line, came too near …"""

    id: str
    zone: str
    kind: AlertKind
    area: str
    track: int
    """0 where it is about nobody alone: a crowd."""
    floor: str
    x: float
    y: float
    device: str | None = None
    rule: str = ""
    """Id of the zone's rule; empty: the site file's ``alert_on``."""
    value: float | None = None
    """What was found: seconds of dwell, people of a crowd, metres of proximity, m/s; ``limit``: what is allowed."""
    limit: float | None = None
    direction: Literal["forward", "backward"] | None = None
    """Of ``cross``."""
    other_track: int | None = None
    """Of ``proximity``, and ``other_device`` likewise."""
    other_device: str | None = None


class Occupancy(Message, frozen=True, kw_only=True):
    """How many people are in each zone at ``t``, from geofence every few seconds."""

    zone: list[str] = []
    people: list[int] = []
    """Whom cameras see, with a phone or without."""
    phones: list[int] = []
    """Known devices among them, or followed by radio and steps alone."""
    blind: list[str] = []
    """Zones that no camera can see now: nobody knows how many are there, and ``zone`` leaves them out."""

    @classmethod
    def columns(cls) -> tuple[str, ...]:
        """One entry per zone."""
        return ("zone", "people", "phones")


class StrideModel(Message, frozen=True, kw_only=True):
    """A person's own step length by cadence, as learned from tracks or calibrated: ``length = slope f + offset``."""

    device: str
    version: int
    slope: float
    """m per step/s."""
    offset: float
    """m."""
    scale_variance: float
    """Of the factor by which this line may be wrong for this person."""


class HeadingModel(Message, frozen=True, kw_only=True):
    """By how much a phone's headings are turned, as learned from the tracks it was on: heard minus walked."""

    device: str
    version: int
    bias: float
    """Radians, to be taken off its headings."""
    variance: float
    """rad², of what remains of it on another walk."""


class RadioModelFile(msgspec.Struct, frozen=True, kw_only=True):
    """A radio model of m access points as files and messages hold it: JSON a person can read; dBm, dB², metres."""

    format: Literal["atrium-radio-model/1"]
    site: str
    access_points: list[str]
    positions: list[tuple[float, float, float] | None]
    """None where nobody knows."""
    power_1m: list[float]
    exponent: list[float]
    origin: tuple[float, float]
    """Centre of the first cell of the shadowing map."""
    cell: Annotated[float, Meta(gt=0.0)]
    mean: list[list[list[float]]]
    """By access point, row and column: heard minus expected, dB."""
    variance: list[list[list[Annotated[float, Meta(ge=0.0)]]]]
    located: list[str] = []
    """The access points whose position was learned; elsewhere the site file says where they stand."""


class RadioModelUpdate(Message, frozen=True, kw_only=True):
    """From now on an area's radio is this; ``model`` None: as the site file says."""

    area: str
    version: int
    """Counts up with every activation of this area; a return to an older model is a new version."""
    model: RadioModelFile | None = None
    reason: str = ""
    """Why, in plain words."""


class DetectorSettings(Message, frozen=True, kw_only=True):
    """From now on a camera's detector works with these options; one that is not named keeps its configured value."""

    camera: str
    version: int
    options: dict[str, float] = {}
    reason: str = ""


class CameraAlignment(Message, frozen=True, kw_only=True):
    """A correction of a camera's calibration: a homography of the plan, applied to the floor positions it computes."""

    camera: str
    version: int
    homography: tuple[float, float, float, float, float, float, float, float, float]
    """3 x 3 by rows, from the plan as calibrated to the true plan, metres; the unit matrix takes a correction back."""
    reason: str = ""
    geometry: str = ""
    """``shared.site.geometry_digest`` of the calibration it corrects: of no other is it true."""


class Erasure(Message, frozen=True, kw_only=True):
    """A device's consent was withdrawn: everybody forgets which track it was on, from now on."""

    device: str


class ErasureDone(Message, frozen=True, kw_only=True):
    """A store has nothing more of a device whose consent was withdrawn; ``t``: when that was so."""

    device: str
    service: str


M = TypeVar("M", bound=Message)

_encoder = msgspec.json.Encoder()
_decoders: dict[type[Message], msgspec.json.Decoder[Any]] = {}


def encode(message: Message) -> bytes:
    """Return the message as JSON. NaN and infinity become null, which no decoder accepts: they cannot travel."""
    return _encoder.encode(message)


def decode(payload: bytes, kind: type[M]) -> M:
    """Return the message of type ``kind`` held in ``payload``.

    Raises:
        MessageError: the payload is not JSON, a field is missing or has the wrong type, or columns differ in length.
    """
    decoder = _decoders.get(kind)
    if decoder is None:
        decoder = _decoders[kind] = msgspec.json.Decoder(kind)
    try:
        message: M = decoder.decode(payload)
    except (msgspec.DecodeError, ValueError, RecursionError) as error:
        raise MessageError(f"{kind.__name__}: {error}") from error
    return message


def positions(frame: DetectionFrame | TrackFrame) -> NDArray[np.float64]:
    """Return the positions of a frame as an array of shape (n, 2), metres."""
    return np.column_stack([np.asarray(frame.x, float), np.asarray(frame.y, float)])


def covariances(frame: DetectionFrame | TrackFrame) -> NDArray[np.float64]:
    """Return the covariances of a frame as an array of shape (n, 2, 2), m²."""
    packed = np.asarray(frame.covariance, float).reshape(-1, 3)
    return packed[:, [0, 1, 1, 2]].reshape(-1, 2, 2)


def pack_covariances(matrices: NDArray[np.float64]) -> list[Covariance]:
    """Return (n, 2, 2) covariances in the form messages carry."""
    packed: list[Covariance] = [tuple(row) for row in matrices.reshape(-1, 4)[:, [0, 1, 3]].tolist()]
    return packed
