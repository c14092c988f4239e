"""Models, learners and an area that tests of learning share."""

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from services.learning.area_tracks import AreaTracks, Judge
from services.learning.lesson import Lesson
from services.learning.proposal import Proposal
from services.learning.tracks.assembler import StretchAssembler
from services.learning.tracks.stretch import Stretch
from services.learning.tracks.verdict import Verdict
from shared.learning_report import ModelKind
from shared.messages import Message, RadioModelFile, RadioModelUpdate, StrideModel, TrackFrame

POINTS = ["ap-1", "ap-2"]


def radio(area: str = "hall", power: float = -40.0, site: str = "museum", points: Sequence[str] = POINTS) -> Message:
    count = len(points)
    grid = np.zeros((count, 2, 3))
    file = RadioModelFile(
        format="atrium-radio-model/1",
        site=site,
        access_points=list(points),
        positions=[(1.0, 2.0, 3.0)] * count,
        power_1m=[power] * count,
        exponent=[2.0] * count,
        origin=(0.0, 0.0),
        cell=1.0,
        mean=grid.tolist(),
        variance=(grid + 4.0).tolist(),
    )
    return RadioModelUpdate(t=0.0, area=area, version=0, model=file)


def stride(device: str = "d-1", slope: float = 0.3) -> StrideModel:
    return StrideModel(t=0.0, device=device, version=0, slope=slope, offset=0.1, scale_variance=0.001)


def power_of(model: Message) -> float | None:
    assert isinstance(model, RadioModelUpdate)
    return None if model.model is None else model.model.power_1m[0]


class TestLearner:
    """Proposes what it is told to."""

    __test__ = False
    kind: ModelKind = "radio"

    def __init__(self, kind: ModelKind = "radio") -> None:
        self.kind = kind
        self.learned: list[Stretch] = []
        self.live: list[Message] = []
        self.forgotten: list[str] = []
        self.proposals: list[Proposal] = []
        self.urgent: list[Proposal] = []
        self.regretted: tuple[float, float] | None = None
        self.known: dict[str, Any] = {}

    def learn(self, stretch: Stretch) -> None:
        self.learned.append(stretch)
        self.known[stretch.device] = self.known.get(stretch.device, 0) + 1

    def forget(self, device: str) -> None:
        self.forgotten.append(device)
        self.known.pop(device, None)

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        return [one for one in self.proposals if one.trained_until <= until]

    def alarms(self, now: float) -> Sequence[Proposal]:
        told, self.urgent = self.urgent, []
        return told

    def regret(self, former: Message, since: float) -> tuple[float, float] | None:
        return self.regretted

    def activated(self, model: Message) -> None:
        self.live.append(model)

    def state(self) -> dict[str, Any]:
        return dict(self.known)

    def restore(self, state: Mapping[str, Any]) -> None:
        if "broken" in state:
            raise ValueError("no such state")
        self.known = dict(state)


def area(name: str = "hall", good: bool = True) -> AreaTracks:
    verdict = Verdict(1.0, 0.1, good, "" if good else "not sure")
    return area_judged_by(lambda stretch: verdict, name)


def area_judged_by(
    judge: Judge, name: str = "hall", points: Sequence[str] = POINTS, cameras: Sequence[str] = ("door",)
) -> AreaTracks:
    """Return an area that keeps its judge when it is made anew."""
    anew = partial(area_judged_by, judge, name, points, cameras)
    return AreaTracks(name, cameras, StretchAssembler(points), judge, None, anew)


def lesson(learner: TestLearner, *areas: str) -> Lesson:
    """Return a learner in its place; made anew it is another one."""
    return Lesson(f"test-{learner.kind}", learner, frozenset(areas or ("hall",)), lambda: type(learner)(learner.kind))


def walk(seconds: float, begin: float = 0.0, device: str = "d-1", place: str = "hall") -> list[TrackFrame]:
    """Frames of somebody who walks with a phone."""
    frames = []
    for number in range(int(seconds * 2)):
        t = begin + number / 2
        columns: dict[str, Any] = {
            "track": [7],
            "floor": ["ground"],
            "x": [0.2 * (t - begin)],
            "y": [1.0],
            "covariance": [(0.01, 0.0, 0.01)],
            "vx": [1.0],
            "vy": [0.0],
            "state": ["confirmed"],
            "device": [device],
            "probability": [0.95],
            "runner_up": [None],
            "runner_up_probability": [0.0],
            "former": [[]],
            "sources": [["door"]],
            "quality": [0.9],
        }
        frames.append(TrackFrame(t=t, area=place, chunk=number, tracker="evidence", **columns))
    return frames
