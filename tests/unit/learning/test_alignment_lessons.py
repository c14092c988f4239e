"""A knocked camera: which one, since when, put right within centimetres; no alarm where nothing happened."""

import math

import msgspec
import numpy as np
import pytest
from numpy.typing import NDArray

from services.learning.cameras.alignment import AlignmentLessons, AlignmentReading
from services.learning.cameras.blocked_places import Walkable
from services.learning.cameras.registration import Snapshot, explained, moved, register, turn_of
from services.learning.proposal import Proposal
from shared.messages import CameraAlignment, DetectionFrame

Array = NDArray[np.float64]
T0 = 1_700_000_000.0
VIEWS = {"east": (8.0, 24.0), "middle": (4.0, 18.0), "west": (0.0, 12.0)}


def everywhere(places: Array) -> NDArray[np.bool_]:
    return np.ones(len(places), np.bool_)


def turned(degrees: float, x: float, y: float, about: tuple[float, float] = (14.0, 5.0)) -> Array:
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    matrix = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    matrix[:2, 2] = np.add(about, [x, y]) - matrix[:2, :2] @ np.array(about)
    return matrix


class Hall:
    """People wander through a hall of 24 x 10 m that cameras look at; one of them is knocked after a while."""

    def __init__(
        self,
        cameras: tuple[str, ...],
        knocked: str,
        knock: Array,
        at: float = 60.0,
        seed: int = 1,
        walkable: Walkable = everywhere,
    ) -> None:
        self.rng = np.random.default_rng(seed)
        self.cameras, self.knocked, self.knock, self.at = cameras, knocked, knock, at
        self.place = self.rng.uniform([0.0, 0.0], [24.0, 10.0], (24, 2))
        self.pace = self.rng.normal(0.0, 0.7, self.place.shape)
        self.lessons = AlignmentLessons("hall", walkable)
        self.t = 0.0
        self.noticed: float | None = None

    def run(self, until: float, learn: bool = False) -> list[Proposal]:
        proposals: list[Proposal] = []
        while self.t < until:
            self.t += 1.0
            self.place += self.pace
            out = (self.place < 0.0) | (self.place > [24.0, 10.0])
            self.pace[out] *= -1.0
            self.place = np.clip(self.place, 0.0, [24.0, 10.0])
            for camera in self.cameras:
                low, high = VIEWS[camera]
                seen = (self.place[:, 0] > low) & (self.place[:, 0] < high) & (self.rng.random(len(self.place)) < 0.85)
                spots = self.place[seen] + self.rng.normal(0.0, 0.12, (int(seen.sum()), 2))
                if camera == self.knocked and self.t > self.at:
                    spots = moved(self.knock, spots)
                self.lessons.take_frame(_frame(T0 + self.t, camera, spots))
            if self.t % 10.0 == 0.0:
                if self.noticed is None and any(r.state in ("knocked", "doubtful") for r in self.readings().values()):
                    self.noticed = self.t
                if learn:
                    proposals += self.lessons.propose(T0 + self.t, T0 + self.t - 30.0)
        return proposals

    def readings(self) -> dict[str, AlignmentReading]:
        return {camera: self.lessons.reading(camera) for camera in self.cameras}


def _frame(t: float, camera: str, spots: Array) -> DetectionFrame:
    count = len(spots)
    return DetectionFrame(
        t=t,
        camera=camera,
        floor="ground",
        seq=0,
        x=spots[:, 0].tolist(),
        y=spots[:, 1].tolist(),
        covariance=[(0.04, 0.0, 0.04)] * count,
        confidence=[0.9] * count,
        box=[(0.0, 0.0, 1.0, 1.0)] * count,
    )


@pytest.mark.parametrize("knock", [turned(0, 1.2, 0.0), turned(8, 0.3, -0.4), turned(-6, -0.8, 0.6)])
def test_whoever_is_who_two_views_are_brought_onto_each_other(knock: Array) -> None:
    rng = np.random.default_rng(4)
    snapshots = []
    for second in range(40):
        people = rng.uniform([4.0, 0.0], [20.0, 10.0], (15, 2))
        theirs = people[rng.random(15) < 0.85] + rng.normal(0.0, 0.1, 2)
        ours = people[rng.random(15) < 0.85]
        snapshots.append(Snapshot(float(second), moved(knock, ours + rng.normal(0.0, 0.1, ours.shape)), theirs))
    found = register(snapshots)
    assert found is not None
    grid = np.stack(np.meshgrid(np.arange(5.0, 20.0), np.arange(1.0, 10.0)), axis=-1).reshape(-1, 2)
    assert np.linalg.norm(moved(found, moved(knock, grid)) - grid, axis=1).max() < 0.15
    assert explained(snapshots, found).mean() > explained(snapshots, np.eye(3)).mean() + 0.5


@pytest.mark.parametrize("rotation", [(0.0, 0.0, 0.1), (0.04, 0.0, 0.0), (-0.02, 0.03, 0.05)])
def test_a_camera_that_was_tilted_is_put_right_where_it_is_known_where_it_hangs(
    rotation: tuple[float, float, float],
) -> None:
    rng = np.random.default_rng(4)
    hangs = np.array([12.0, -1.0, 6.0])
    knock: Array = np.asarray(np.linalg.inv(turn_of(np.array(rotation), hangs)), np.float64)
    snapshots = []
    for second in range(40):
        people = rng.uniform([4.0, 2.0], [20.0, 12.0], (15, 2))
        theirs = people[rng.random(15) < 0.85]
        ours = people[rng.random(15) < 0.85]
        snapshots.append(Snapshot(float(second), moved(knock, ours + rng.normal(0.0, 0.1, ours.shape)), theirs))
    found = register(snapshots, hangs)
    assert found is not None
    grid = np.stack(np.meshgrid(np.arange(5.0, 20.0), np.arange(3.0, 12.0)), axis=-1).reshape(-1, 2)
    assert np.linalg.norm(moved(found, moved(knock, grid)) - grid, axis=1).max() < 0.15


def test_nobody_in_common_says_nothing() -> None:
    rng = np.random.default_rng(1)
    few = [Snapshot(0.0, rng.uniform(0, 3, (3, 2)), rng.uniform(0, 3, (3, 2))) for _ in range(3)]
    assert register(few) is None
    assert register([]) is None


def test_a_knocked_camera_is_noticed_named_and_put_right() -> None:
    hall = Hall(("east", "middle", "west"), "east", turned(5, 1.0, 0.3))
    proposals = hall.run(180.0, learn=True)
    assert hall.noticed is not None
    assert hall.noticed < 60.0 + 60.0
    readings = hall.readings()
    assert [readings[camera].state for camera in ("east", "middle", "west")] == ["knocked", "fine", "fine"]
    assert "east" in readings["east"].words
    assert "22:14 UTC" in readings["east"].words
    assert {proposal.subject for proposal in proposals} == {"east"}
    proposal = proposals[0]
    assert (proposal.gain or 0.0) > (proposal.margin or 1.0)
    assert isinstance(proposal.model, CameraAlignment)
    right = np.reshape(proposal.model.homography, (3, 3))
    grid = np.stack(np.meshgrid(np.arange(8.0, 24.0), np.arange(0.0, 10.0)), axis=-1).reshape(-1, 2)
    assert np.linalg.norm(moved(right @ hall.knock, grid) - grid, axis=1).max() < 0.3
    hall.lessons.activated(proposal.model)
    hall.knock = right @ hall.knock
    assert hall.run(260.0, learn=True) == []
    assert hall.readings()["east"].state == "corrected"


@pytest.mark.parametrize("seed", range(3))
def test_cameras_that_agree_are_left_alone(seed: int) -> None:
    hall = Hall(("east", "middle", "west"), "none", np.eye(3), seed=seed)
    assert hall.run(180.0, learn=True) == []
    assert hall.noticed is None
    assert {reading.state for reading in hall.readings().values()} == {"fine"}


def test_two_cameras_that_contradict_each_other_are_doubtful_and_neither_is_moved() -> None:
    hall = Hall(("east", "middle"), "east", turned(0, 1.2, 0.0))
    assert hall.run(150.0, learn=True) == []
    for reading in hall.readings().values():
        assert reading.state == "doubtful"
        assert "one of them" in reading.words
        assert reading.offset == pytest.approx(1.2, abs=0.3)


def test_the_plan_tells_which_of_two_cameras_is_wrong() -> None:
    def inside(places: Array) -> NDArray[np.bool_]:
        return (places[:, 0] > -0.5) & (places[:, 0] < 24.5)

    hall = Hall(("east", "middle"), "east", turned(0, 2.7, 0.0), at=200.0, walkable=inside)
    proposals = hall.run(400.0, learn=True)
    readings = hall.readings()
    assert (readings["east"].state, readings["middle"].state) == ("knocked", "fine")
    assert {proposal.subject for proposal in proposals} == {"east"}


def test_a_camera_alone_is_noticed_where_its_people_stand_where_nobody_can() -> None:
    def inside(places: Array) -> NDArray[np.bool_]:
        return places[:, 0] < 24.5

    hall = Hall(("east",), "east", turned(0, 2.7, 0.0), at=200.0, walkable=inside)
    assert hall.run(200.0) == []
    assert hall.readings()["east"].state == "unknown"
    hall.run(400.0)
    reading = hall.readings()["east"]
    assert reading.state == "knocked"
    assert "stand where nobody can" in reading.words
    wrong = Hall(("east",), "east", turned(0, 2.7, 0.0), at=0.0, walkable=inside)
    wrong.run(190.0)
    assert "calibration" in wrong.readings()["east"].words


def test_a_camera_turned_round_is_flagged_and_not_corrected() -> None:
    hall = Hall(("east", "middle", "west"), "east", turned(0, 3.3, 0.0))
    assert hall.run(150.0, learn=True) == []


def test_a_camera_alone_says_nothing_of_itself() -> None:
    hall = Hall(("east",), "east", turned(0, 1.2, 0.0))
    assert hall.run(100.0, learn=True) == []
    assert hall.readings()["east"] == AlignmentReading()


def test_corrections_in_use_survive_and_memory_is_bounded() -> None:
    lessons = AlignmentLessons("hall", everywhere)
    model = CameraAlignment(t=1.0, camera="east", version=3, homography=(1.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0))
    lessons.activated(model)
    other = AlignmentLessons("hall", everywhere)
    other.restore(msgspec.json.decode(msgspec.json.encode(lessons.state())))
    assert other.state() == lessons.state()
    for wrong in ({}, {"area": "elsewhere", "active": {}}):
        with pytest.raises(ValueError, match="alignment lessons"):
            other.restore(wrong)
    for second in range(1200):
        for camera in ("east", "middle"):
            other.take_frame(_frame(T0 + second, camera, np.array([[1.0, 1.0]])))
    assert len(other._pairs.of("east", "middle")) <= 901
