"""How would peers track the same detections? norfair and Stone Soup, set up as their documentation suggests.

Each class prepares the detections in the peer's own types (not timed), then tracks frame after frame (timed), and gives
back the tracks of each frame. Parameters are keyword arguments, so that a reader can try others.
"""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime, timedelta
from typing import Any

import numpy as np
from norfair.filter import OptimizedKalmanFilterFactory
from norfair.tracker import Detection as NorfairDetection
from norfair.tracker import Tracker as Norfair
from numpy.typing import NDArray
from stonesoup.dataassociator.neighbour import GNNWith2DAssignment
from stonesoup.deleter.time import UpdateTimeStepsDeleter
from stonesoup.hypothesiser.distance import DistanceHypothesiser
from stonesoup.initiator.simple import MultiMeasurementInitiator
from stonesoup.measures import Mahalanobis
from stonesoup.models.measurement.linear import LinearGaussian
from stonesoup.models.transition.linear import CombinedLinearGaussianTransitionModel, ConstantVelocity
from stonesoup.predictor.kalman import KalmanPredictor
from stonesoup.tracker.simple import MultiTargetTracker
from stonesoup.types.detection import Detection as StoneSoupDetection
from stonesoup.types.state import GaussianState
from stonesoup.types.update import Update
from stonesoup.updater.kalman import KalmanUpdater

from shared.messages import DetectionFrame, TrackFrame, covariances, positions

__all__ = ["NorfairPeer", "StoneSoupPeer", "as_track_frames"]

Tracks = list[tuple[list[int], list[tuple[float, float]]]]
"""Of each frame: ids and positions."""

START = datetime(2009, 1, 1)


class NorfairPeer:
    """norfair with its Kalman filter on points in metres.

    Args:
        distance: metres; farther detections never belong to a track.
        delay: frames of hits before a track is told (``initialization_delay``).
        patience: the counter's ceiling (``hit_counter_max``): how many misses a track survives.
        noise: ``R`` of its Kalman filter, in its units of one frame.
        process: ``Q`` likewise.
        confidence: detections below are left out.
        told: misses after which a living track is no longer told.
    """

    def __init__(
        self,
        distance: float = 1.5,
        delay: int = 4,
        patience: int = 14,
        noise: float = 4.0,
        process: float = 0.1,
        confidence: float = 0.2,
        told: int = 3,
    ) -> None:
        self.tracker = Norfair(
            distance_function="euclidean",
            distance_threshold=distance,
            initialization_delay=delay,
            hit_counter_max=patience,
            pointwise_hit_counter_max=told + 1,
            filter_factory=OptimizedKalmanFilterFactory(R=noise, Q=process),
        )
        self.confidence = confidence

    def prepare(self, frames: Sequence[DetectionFrame]) -> list[list[Any]]:
        """Return the detections of each frame in norfair's own type."""
        return [
            [
                NorfairDetection(points=place[None], scores=np.array([confidence]))
                for place, confidence in zip(positions(frame), frame.confidence, strict=True)
                if confidence >= self.confidence
            ]
            for frame in frames
        ]

    def track(self, prepared: list[list[Any]]) -> Tracks:
        """Return the tracks of each frame."""
        found: Tracks = []
        for detections in prepared:
            alive = [one for one in self.tracker.update(detections=detections) if one.live_points.any()]
            places = [one.estimate[0].tolist() for one in alive]
            found.append(([one.id or 0 for one in alive], [(x, y) for x, y in places]))
        return found


class StoneSoupPeer:
    """Stone Soup's multi-target tracker: constant velocity, global nearest neighbour, confirmation by several hits.

    Args:
        acceleration: spectral density of its white acceleration, m²/s³.
        gate: standard deviations (its ``missed_distance``).
        hits: updates before a track is told (``min_points``).
        patience: frames without update after which a track is deleted.
        confidence: detections below are left out.
        told: misses after which a living track is no longer told.
        sigma: metres, the same for all detections; None takes each one's own covariance.
        frames_per_s: of the clip.
    """

    def __init__(
        self,
        acceleration: float = 0.2,
        gate: float = 3.0,
        hits: int = 4,
        patience: int = 14,
        confidence: float = 0.2,
        told: int = 3,
        sigma: float | None = None,
        frames_per_s: float = 7.0,
    ) -> None:
        self.confidence, self.told, self.sigma = confidence, told, sigma
        self.interval = timedelta(seconds=1.0 / frames_per_s)
        motion = CombinedLinearGaussianTransitionModel([ConstantVelocity(acceleration), ConstantVelocity(acceleration)])
        self._updater = KalmanUpdater(None)
        hypothesiser = DistanceHypothesiser(KalmanPredictor(motion), self._updater, Mahalanobis(), missed_distance=gate)
        self._associator = GNNWith2DAssignment(hypothesiser)
        self._deleter = UpdateTimeStepsDeleter(patience)
        self._initiator = MultiMeasurementInitiator(
            prior_state=GaussianState([[0], [0], [0], [0]], np.diag([0.0, 1.0, 0.0, 1.0])),
            measurement_model=None,
            deleter=UpdateTimeStepsDeleter(2),
            data_associator=self._associator,
            updater=self._updater,
            min_points=hits,
        )

    def prepare(self, frames: Sequence[DetectionFrame]) -> list[tuple[datetime, set[Any]]]:
        """Return time and detections of each frame in Stone Soup's own types."""
        return [
            (
                START + number * self.interval,
                {
                    StoneSoupDetection(place[:, None], START + number * self.interval, measurement_model=self._model(r))
                    for place, r, confidence in zip(positions(frame), covariances(frame), frame.confidence, strict=True)
                    if confidence >= self.confidence
                },
            )
            for number, frame in enumerate(frames)
        ]

    def track(self, prepared: list[tuple[datetime, set[Any]]]) -> Tracks:
        """Return the tracks of each frame."""
        tracker = MultiTargetTracker(self._initiator, self._deleter, prepared, self._associator, self._updater)
        numbers: dict[str, int] = {}
        found: Tracks = []
        for _, tracks in tracker:
            told = [one for one in tracks if any(isinstance(state, Update) for state in one.states[-1 - self.told :])]
            ids = [numbers.setdefault(one.id, len(numbers)) for one in told]
            found.append((ids, [(float(t.state_vector[0, 0]), float(t.state_vector[2, 0])) for t in told]))
        return found

    def _model(self, covariance: NDArray[np.float64]) -> LinearGaussian:
        noise = covariance if self.sigma is None else self.sigma**2 * np.eye(2)
        return LinearGaussian(ndim_state=4, mapping=(0, 2), noise_covar=noise)


def as_track_frames(frames: Sequence[DetectionFrame], tracks: Tracks) -> list[TrackFrame]:
    """Return a peer's tracks as the metrics take them."""
    made = []
    for frame, (ids, places) in zip(frames, tracks, strict=True):
        n = len(ids)
        made.append(
            TrackFrame(
                t=frame.t, area="", chunk=frame.seq, tracker="peer", track=ids, floor=[frame.floor] * n,
                x=[x for x, _ in places], y=[y for _, y in places], covariance=[(1.0, 0.0, 1.0)] * n,
                vx=[0.0] * n, vy=[0.0] * n, state=["confirmed"] * n, device=[None] * n, probability=[0.0] * n,
                runner_up=[None] * n, runner_up_probability=[0.0] * n, former=[[]] * n, sources=[[]] * n,
                quality=[1.0] * n,
            )
        )  # fmt: skip
    return made
