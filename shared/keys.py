"""Every key of the bus, built here and nowhere else: ``atrium/1/{site}/…`` where 1 is the schema version."""

from __future__ import annotations

import re

__all__ = ["SCHEMA_VERSION", "Keys", "is_identifier"]

SCHEMA_VERSION = 1

_IDENTIFIER = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}")


def is_identifier(text: str) -> bool:
    """Whether ``text`` may name a site, camera, device, area, zone or floor: letters, digits, ``_ . -``, at most 64."""
    return _IDENTIFIER.fullmatch(text) is not None


class Keys:
    """The keys of one site. Pass ``"*"`` for a wildcard over one part.

    Raises:
        ValueError: an identifier holds a character that no key may hold.
    """

    def __init__(self, site: str) -> None:
        self.root = f"atrium/{SCHEMA_VERSION}/{_part(site)}"

    def detections(self, camera: str = "*") -> str:
        """DetectionFrame, each frame also when empty; newest wins."""
        return f"{self.root}/camera/{_part(camera)}/detections"

    def camera_status(self, camera: str = "*") -> str:
        """CameraStatus on change, cached."""
        return f"{self.root}/camera/{_part(camera)}/status"

    def radio(self, device: str = "*") -> str:
        """RadioScan, each scan, reliable."""
        return f"{self.root}/device/{_part(device)}/radio"

    def motion(self, device: str = "*") -> str:
        """MotionBatch, about once a second, reliable."""
        return f"{self.root}/device/{_part(device)}/motion"

    def tracks(self, area: str = "*") -> str:
        """TrackFrame, each chunk."""
        return f"{self.root}/tracks/{_part(area)}"

    def revisions(self, area: str = "*") -> str:
        """Revision: where fusion thinks better of the last seconds."""
        return f"{self.root}/revisions/{_part(area)}"

    def chunks(self, area: str = "*") -> str:
        """ChunkMark: what fusion consumed, in order; reliable."""
        return f"{self.root}/fusion/{_part(area)}/chunk"

    def fusion_state(self, area: str = "*") -> str:
        """Queryable: the tracker's state at the last chunk boundary, for recorders that join in mid-run."""
        return f"{self.root}/fusion/{_part(area)}/state"

    def rescore(self, area: str = "*") -> str:
        """Queryable: a candidate model → how well it explains the last minutes, beside the active one."""
        return f"{self.root}/fusion/{_part(area)}/rescore"

    def alert(self, zone: str = "*") -> str:
        """Alert, reliable, cached."""
        return f"{self.root}/alert/{_part(zone)}"

    def zones(self) -> str:
        """ZoneSet (``shared.zones``): all zones as staff keep them, from the API; cached."""
        return f"{self.root}/config/zones"

    def setup(self) -> str:
        """SetupTold (``shared.setup_told``): what is set up in the browser, from the API; cached."""
        return f"{self.root}/config/setup"

    def occupancy(self) -> str:
        """Occupancy: how many people are in each zone, every few seconds; from geofence."""
        return f"{self.root}/occupancy"

    def history(self) -> str:
        """Queryable: a question about the past (``shared.history_query``) → its answer; MessagePack."""
        return f"{self.root}/history/query"

    def still(self, camera: str = "*") -> str:
        """Queryable: one picture of a camera for its calibration; the only way a picture leaves, off by default."""
        return f"{self.root}/camera/{_part(camera)}/still"

    def erased(self, device: str = "*", service: str = "*") -> str:
        """ErasureDone: a store has forgotten a device whose owner withdrew consent; cached."""
        return f"{self.root}/erased/{_part(device)}/{_part(service)}"

    def stride_model(self, device: str = "*") -> str:
        """StrideModel, on activation, cached."""
        return f"{self.root}/model/stride/{_part(device)}"

    def heading_model(self, device: str = "*") -> str:
        """HeadingModel, on activation, cached."""
        return f"{self.root}/model/heading/{_part(device)}"

    def radio_model(self, area: str = "*") -> str:
        """RadioModelUpdate, on activation, cached."""
        return f"{self.root}/model/radio/{_part(area)}"

    def alignment(self, camera: str = "*") -> str:
        """CameraAlignment, on activation, cached."""
        return f"{self.root}/model/alignment/{_part(camera)}"

    def detector_settings(self, camera: str = "*") -> str:
        """DetectorSettings, on activation, cached."""
        return f"{self.root}/camera/{_part(camera)}/settings"

    def redetect(self, camera: str = "*") -> str:
        """Queryable: candidate detector options → what the camera would have detected in the last minutes."""
        return f"{self.root}/camera/{_part(camera)}/redetect"

    def learning_report(self) -> str:
        """Queryable: what is learned, how well it fits, what was activated and why; JSON."""
        return f"{self.root}/learning/report"

    def learning_command(self) -> str:
        """Queryable: activate, roll back, freeze, export or import a model → what was done, or why not; JSON."""
        return f"{self.root}/learning/command"

    def erasure(self, device: str = "*") -> str:
        """Erasure, reliable: who withdrew consent."""
        return f"{self.root}/erasure/{_part(device)}"

    def withdrawal(self) -> str:
        """Queryable: end a phone's consent for a visitor who asks staff (``shared.withdrawal``) → what came of it."""
        return f"{self.root}/gateway/withdrawal"

    def kept(self, service: str = "*", instance: str = "*") -> str:
        """Queryable: what a process keeps of people, and for how long (``shared.kept``); every service answers."""
        return f"{self.root}/kept/{_part(service)}/{_part(instance)}"

    def health(self, service: str = "*", instance: str = "*") -> str:
        """Queryable: what a process finds wrong, JSON of plain words by topic; every service answers."""
        return f"{self.root}/health/{_part(service)}/{_part(instance)}"

    def alive(self, service: str = "*", instance: str = "*") -> str:
        """Liveliness token of one running service."""
        return f"{self.root}/alive/{_part(service)}/{_part(instance)}"


def _part(text: str) -> str:
    if text == "*" or is_identifier(text):
        return text
    raise ValueError(f"{text!r} cannot be part of a key: use 1 to 64 of the letters, digits, '_', '.' and '-'")
