"""What does the gateway remember of one phone? Its clock, its walk, the batches seen, and what is still to publish."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from services.gateway.phones.batch_check import Limits, check_batch
from services.gateway.phones.clock import ClockAligner
from services.gateway.protocol import Accepted, Batch, RadioReadings
from services.gateway.reckoning.dead_reckoning import DeadReckoner, Motion, Walk
from shared.messages import MotionBatch, RadioScan

__all__ = ["Intake", "Phone"]

SEQ_WINDOW = 256
"""Batches may overtake each other by this many; an older ``seq`` counts as seen."""


@dataclass(frozen=True, slots=True)
class Intake:
    """What one batch came to."""

    duplicate: bool
    clock_offset: float
    accepted: Accepted
    ignored: dict[str, int]


class Phone:
    """The state of one phone: a pure state machine, a batch in, messages for the bus into ``outbox``.

    Args:
        device: its id.
        access_points: address in lower case → site id of the access point.
        north: direction of north on the plan, radians.
        heading_known: False for a phone in a pocket or bag.
    """

    def __init__(self, device: str, access_points: dict[str, str], north: float, heading_known: bool) -> None:
        self.device = device
        self.outbox: deque[RadioScan | MotionBatch] = deque()
        """What is not yet on the bus; a batch is acknowledged only when this is empty."""
        self._access_points = access_points
        self._reckoner = DeadReckoner(north)
        self._heading_known = heading_known
        self._clock = ClockAligner()
        self._walk: Walk | None = None
        self._seen: set[int] = set()
        self._highest = -1
        self._radio_seq = 0
        self._motion_seq = 0

    def take(self, batch: Batch, received: float, limits: Limits) -> Intake:
        """Check and use one batch that arrived at server time ``received``.

        Raises:
            RequestError: the batch is refused; nothing of it was used.
        """
        samples = check_batch(batch, limits)
        echo = None if batch.echo is None else (batch.echo.replied, batch.echo.arrived)
        offset = self._clock.observe(batch.sent, received, echo)
        if batch.seq in self._seen or batch.seq <= self._highest - SEQ_WINDOW:
            return Intake(True, offset, Accepted(), {})
        self._note(batch.seq)
        ignored: dict[str, int] = {}
        readings = sum(self._take_scan(scan, offset, ignored) for scan in batch.radio)
        used = 0
        if samples is not None:
            walk = self._walk = self._walk or Walk("hand" if self._heading_known else "pocket")
            late = walk.late
            for motion in self._reckoner.advance([walk], [samples])[0]:
                self._tell(motion, offset)
            late = walk.late - late
            used = len(samples.t) - late
            if late:
                ignored["samples whose time had passed"] = late
        return Intake(False, offset, Accepted(samples=used, scans=len(batch.radio), readings=readings), ignored)

    def rest(self) -> None:
        """Give the memory of an idle phone back; its clock and the batches seen are kept."""
        self._walk = None

    def _note(self, seq: int) -> None:
        self._seen.add(seq)
        if seq > self._highest:
            self._highest = seq
            if len(self._seen) > 2 * SEQ_WINDOW:
                self._seen = {number for number in self._seen if number > seq - SEQ_WINDOW}

    def _take_scan(self, scan: RadioReadings, offset: float, ignored: dict[str, int]) -> int:
        """Translate addresses to site ids; an address the site does not know goes no further than this line."""
        strongest: dict[str, float] = {}
        unknown = again = 0
        for address, rssi in zip(scan.address, scan.rssi, strict=True):
            access_point = self._access_points.get(address.lower())
            if access_point is None:
                unknown += 1
            elif access_point in strongest:
                again += 1
                strongest[access_point] = max(rssi, strongest[access_point])
            else:
                strongest[access_point] = rssi
        for reason, count in (("unknown address", unknown), ("access point heard twice in a scan", again)):
            if count:
                ignored[reason] = ignored.get(reason, 0) + count
        if strongest:
            self.outbox.append(
                RadioScan(
                    t=scan.t + offset,
                    device=self.device,
                    seq=self._radio_seq,
                    kind=scan.kind,
                    access_point=list(strongest),
                    rssi=list(strongest.values()),
                )
            )
            self._radio_seq += 1
        return len(strongest)

    def _tell(self, motion: Motion, offset: float) -> None:
        self.outbox.append(
            MotionBatch(
                t=motion.t + offset,
                t_start=motion.t_start + offset,
                device=self.device,
                seq=self._motion_seq,
                activity=motion.activity,
                step_t=(motion.step_t + offset).tolist(),
                length=motion.length.tolist(),
                length_variance=motion.length_variance.tolist(),
                heading=motion.heading.tolist(),
                heading_variance=motion.heading_variance.tolist(),
                step_t_variance=motion.step_t_variance.tolist(),
                other_heading=motion.other_heading.tolist(),
                other_probability=motion.other_probability.tolist(),
                walk=motion.walk,
                heading_bias_variance=motion.heading_bias_variance,
                length_scale_variance=motion.length_scale_variance,
                turn_t=(motion.turn_t + offset).tolist(),
                turn=motion.turn.tolist(),
            )
        )
        self._motion_seq += 1
