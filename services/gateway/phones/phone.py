"""What does the gateway remember of one phone? Its clock, its walk, the batches seen, and what is still to publish."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from services.gateway.phones.batch_check import Limits, check_batch
from services.gateway.phones.clock import ClockAligner
from services.gateway.phones.seen_numbers import SeenNumbers
from services.gateway.protocol import Accepted, Batch, RadioReadings
from services.gateway.reckoning.dead_reckoning import Carrying, DeadReckoner, InertialSamples, Motion, Walk
from shared.angles import wrap
from shared.messages import HeadingModel, MotionBatch, RadioScan
from shared.walking.stride import StrideLine

__all__ = ["NATIVE", "Intake", "Phone"]

NATIVE = "native"
"""Source of the batches that an app of ours numbers itself; every adapter is a source of its own."""
LATENESS = 5.0
"""Seconds after which a measurement is no use for live positions."""


@dataclass(slots=True)
class Intake:
    """What one batch came to."""

    duplicate: bool
    received: float
    clock_offset: float
    clock_drift: float
    samples: InertialSamples | None = None
    """Still to be advanced."""
    seq: int = -1
    source: str = NATIVE
    radio: Sequence[RadioReadings] = ()
    """Still to be told."""
    used_samples: int = 0
    scans: int = 0
    readings: int = 0
    late: bool = False
    ignored: dict[str, int] = field(default_factory=dict)

    @property
    def accepted(self) -> Accepted:
        """How much was used."""
        return Accepted(samples=self.used_samples, scans=self.scans, readings=self.readings)

    def ignore(self, reason: str, count: int) -> None:
        """Count what was not used."""
        if count:
            self.ignored[reason] = self.ignored.get(reason, 0) + count


class Phone:
    """The state of one phone: a pure state machine, a batch in, messages for the bus into ``outbox``.

    A batch is taken in two steps, ``admit`` and ``tell``; between them the dead reckoning of many phones is advanced at
    once. One that was not told counts as never seen. ``take`` does all of it for one phone.

    Args:
        device: its id.
        access_points: address in lower case → site id of the access point.
        carrying: how it is carried.
        line: the carrier's own stride model, where there is one.
        lateness: seconds after which a measurement is marked late.
    """

    def __init__(
        self,
        device: str,
        access_points: Mapping[str, str],
        carrying: Carrying = "unknown",
        line: StrideLine | None = None,
        lateness: float = LATENESS,
    ) -> None:
        self.device = device
        self.outbox: deque[RadioScan | MotionBatch] = deque()
        """What is neither on the bus nor stored; a batch is acknowledged only when this is empty."""
        self.walk = Walk(carrying, line)
        self.turned: HeadingModel | None = None
        """By how much its headings are turned, where that was learned; may be set at any time."""
        self.failed = False
        """Whether dead reckoning failed on its last batch: the next is advanced apart from those of other phones."""
        self._access_points = access_points
        self._lateness = lateness
        self._clock = ClockAligner()
        self._seen: dict[str, SeenNumbers] = {}
        """By source."""
        self._radio_seq = 0
        self._motion_seq = 0

    def take(self, batch: Batch, received: float, limits: Limits, reckoner: DeadReckoner) -> Intake:
        """Check and use one batch that arrived at server time ``received``.

        Raises:
            RequestError: the batch is refused; nothing of it was used.
        """
        intake = self.admit(batch, received, limits)
        if not intake.duplicate:
            before = self.walk.late
            motions: Sequence[Motion] = ()
            if intake.samples is not None:
                (motions,) = reckoner.advance([self.walk], [intake.samples])
            self.tell(intake, motions, self.walk.late - before)
        return intake

    def admit(self, batch: Batch, received: float, limits: Limits, source: str = NATIVE) -> Intake:
        """Check one batch and learn the phone's clock from it; what else it holds stands in the intake.

        Args:
            batch: as it came.
            received: server time.
            limits: of a batch.
            source: who numbered it.

        Raises:
            RequestError: the batch is refused; nothing of it was used.
        """
        samples = check_batch(batch, limits)
        duplicate = batch.seq in self._seen.setdefault(source, SeenNumbers())
        echo = None if batch.echo is None else (batch.echo.replied, batch.echo.arrived)
        offset = self._clock.observe(batch.sent, received, echo)
        if duplicate:
            return Intake(True, received, offset, self._clock.drift)
        return Intake(False, received, offset, self._clock.drift, samples, batch.seq, source, batch.radio)

    def tell(self, intake: Intake, motions: Sequence[Motion], dropped: int) -> None:
        """Note a batch as seen; put its scans and what dead reckoning made of it into the outbox.

        Args:
            intake: of the batch, which is no duplicate.
            motions: what its samples came to.
            dropped: how many of its samples were too late to be used.
        """
        self._seen[intake.source].add(intake.seq)
        for scan in intake.radio:
            self._take_scan(scan, intake)
        intake.scans, intake.radio = len(intake.radio), ()
        samples, intake.samples = intake.samples, None
        intake.used_samples = (0 if samples is None else len(samples.t)) - dropped
        intake.ignore("samples whose time had passed", dropped)
        for motion in motions:
            self._tell(motion, intake)

    def rest(self) -> None:
        """Give the memory of an idle phone back; its clock, its calibration and the batches seen are kept."""
        self.walk.rest()

    def _is_late(self, t: float, intake: Intake) -> bool:
        late = intake.received - t > self._lateness
        intake.late = intake.late or late
        return late

    def _take_scan(self, scan: RadioReadings, intake: Intake) -> None:
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
        intake.readings += len(strongest)
        intake.ignore("unknown address", unknown)
        intake.ignore("access point heard twice in a scan", again)
        t = scan.t + self._clock.offset_at(scan.t)
        late = self._is_late(t, intake)
        if strongest:
            self.outbox.append(
                RadioScan(
                    t=t,
                    device=self.device,
                    seq=self._radio_seq,
                    kind=scan.kind,
                    access_point=list(strongest),
                    rssi=list(strongest.values()),
                    late=late,
                )
            )
            self._radio_seq += 1

    def _tell(self, motion: Motion, intake: Intake) -> None:
        offset = self._clock.offset_at(motion.t)
        t = motion.t + offset
        steps = {}
        if self.turned is not None:
            motion = _turned_back(motion, self.turned)
        if len(motion.step_t):
            steps = {
                "step_t": (motion.step_t + offset).tolist(),
                "step_t_variance": motion.step_t_variance.tolist(),
                "length": motion.length.tolist(),
                "length_variance": motion.length_variance.tolist(),
                "heading": motion.heading.tolist(),
                "heading_variance": motion.heading_variance.tolist(),
                "other_heading": motion.other_heading.tolist(),
                "other_probability": motion.other_probability.tolist(),
            }
            if np.isfinite(motion.magnetic).all():
                steps["magnetic"] = np.round(motion.magnetic, 1).tolist()
        if len(motion.turn_t):
            steps |= {"turn_t": (motion.turn_t + offset).tolist(), "turn": motion.turn.tolist()}
        self.outbox.append(
            MotionBatch(
                t=t,
                t_start=motion.t_start + offset,
                device=self.device,
                seq=self._motion_seq,
                activity=motion.activity,
                walk=motion.walk,
                heading_bias_variance=motion.heading_bias_variance,
                length_scale_variance=motion.length_scale_variance,
                late=self._is_late(t, intake),
                **steps,
            )
        )
        self._motion_seq += 1


def _turned_back(motion: Motion, model: HeadingModel) -> Motion:
    """Return a motion without the bias that was learned of its phone.

    What remains of it was learned from walks of all sorts: a phone that knows its headings less well now is believed.
    """
    more = max(model.variance - motion.heading_bias_variance, 0.0)
    return replace(
        motion,
        heading=wrap(motion.heading - model.bias),
        heading_variance=motion.heading_variance + more,
        other_heading=wrap(motion.other_heading - model.bias),
        heading_bias_variance=motion.heading_bias_variance + more,
    )
