"""Stands in for the learning service: answers its two queries with what a hall after a week might tell."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import msgspec
import numpy as np
import shapely

from services.learning.maps import AreaMaps
from shared.bus import Bus, Question
from shared.keys import Keys
from shared.learning_command import LearningAnswer, LearningCommand
from shared.learning_report import (
    AccessPointFit,
    AccuracyReport,
    Activation,
    AreaLessons,
    CameraLessons,
    DeviceLessons,
    LearningReport,
    TrackLessons,
)
from shared.radio.path_loss import PathLoss
from shared.radio.radio_learning import RadioLearner
from shared.radio.radio_model import RadioModel
from shared.site import Site

AREA = "hall"


@dataclass
class Double:
    """What it was told, and what it tells."""

    site: Site
    report: LearningReport
    maps: AreaMaps
    model: RadioModel | None
    commands: list[LearningCommand] = field(default_factory=list)
    asked: int = 0
    refusal: LearningAnswer | None = None

    def tell(self) -> bytes:
        self.asked += 1
        return msgspec.json.encode(self.report)

    def obey(self, question: Question) -> None:
        command = msgspec.json.decode(question.payload, type=LearningCommand)
        self.commands.append(command)
        question.answer(msgspec.json.encode(self.refusal or self._answer(command)))

    def _answer(self, command: LearningCommand) -> LearningAnswer:
        if command.do == "map":
            assert command.map is not None
            grid = self.maps.grid(command.map, self.model, command.access_point)
            return LearningAnswer(done=True, map=grid, words="" if grid else "Nobody with a phone has walked yet.")
        if command.do in ("freeze", "unfreeze"):
            self.report = msgspec.structs.replace(self.report, frozen=command.do == "freeze")
            return LearningAnswer(done=True, words=f"activation is {'frozen' if self.report.frozen else 'on again'}")
        if command.do == "rollback":
            if command.subject != AREA:
                words = f"there is no {command.kind} model of {command.subject!r}"
                return LearningAnswer(done=False, words=words, field="subject", unknown=True)
            return LearningAnswer(done=True, words="area hall is back at radio model 2, as version 4", version=4)
        if command.do == "history":
            rows = [row for row in self.report.history if command.kind in (None, row.kind)]
            rows = [row for row in rows if command.subject in (None, row.subject)]
            rows = [row for row in rows if command.before is None or row.t < command.before]
            page = [row for row in rows if row.t >= rows[: command.most][-1].t]
            return LearningAnswer(done=True, history=page, older=len(page) < len(rows))
        if command.do == "export":
            return LearningAnswer(done=True, bundle=msgspec.Raw(b'{"format":"atrium-models/1","models":[]}'))
        if b"other-site" in bytes(command.bundle):
            return LearningAnswer(done=False, field="bundle", words="learned at site 'other-site', expected 'hall'")
        return LearningAnswer(done=True, words="0 models brought in")


@contextmanager
def learning(bus: Bus, site: Site, double: Double | None = None) -> Iterator[Double]:
    """Answer the two queries for as long as the bus is open."""
    double = double or busy(site)
    keys = Keys(site.site)
    bus.answer(keys.learning_report(), double.tell)
    bus.answer_questions(keys.learning_command(), double.obey)
    yield double


def fresh(site: Site) -> Double:
    """Return a learning service that has just started."""
    words = "Nobody with a phone has walked yet."
    areas = [AreaLessons(area=area.id, words=words) for area in site.areas]
    cameras = [CameraLessons(camera=camera.id, area=camera.area) for camera in site.cameras]
    report = LearningReport(t=time.time(), areas=areas, cameras=cameras)
    return Double(site, report, AreaMaps.of_site(site, AREA), None)


def busy(site: Site) -> Double:
    """Return one that has learned for a week."""
    rng = np.random.default_rng(7)
    now = time.time()
    maps, model = _walked(site, rng)
    points = [point for point in site.access_points if point.floor == site.area(AREA).floor]
    fits = [_fit(n, point.id, rng) for n, point in enumerate(points)]
    hour = now - 6 * 3600.0 + 300.0 * np.arange(72)
    score = 1.1 + 0.5 * (1.0 - np.exp(-np.arange(72) / 20.0)) + rng.normal(0.0, 0.05, 72)
    cameras = [
        CameraLessons(
            camera=camera.id,
            area=camera.area,
            version=2,
            options={"learning_rate": 0.02, "threshold": 14.0},
            score_t=hour.tolist(),
            score=(score - 0.2 * n).tolist(),
            alignment=("fine", "knocked")[n % 2],  # type: ignore[arg-type]
            offset=0.05 + 0.4 * (n % 2),
            clock=0.04,
            clock_error=0.02,
            words=("", "it looks elsewhere since 13:20: was it knocked?")[n % 2],
        )
        for n, camera in enumerate(site.cameras)
    ]
    devices = [
        DeviceLessons(
            device=f"d-{rng.integers(16**11):011x}",
            slope=0.28 + 0.03 * n,
            offset=0.16 - 0.03 * n,
            r2=0.81 - 0.12 * n,
            steps=900 - 200 * n,
            used=n < 3,
            heading_bias=(-0.1, 0.02, 0.2, None)[n],
            heading_error=(0.03, 0.04, 0.05, None)[n],
            radio_offset=(-2.1, 0.4, 1.5, None)[n],
        )
        for n in range(4)
    ]
    area = AreaLessons(
        area=AREA,
        version=3,
        access_points=fits,
        tracks=TrackLessons(
            good=212,
            refused={"radio does not agree": 19, "too short": 41, "nobody walked": 57},
            threshold=0.4,
            quality=1.9,
        ),
        accuracy=AccuracyReport(rms=0.81, p50=0.44, p90=1.35, named=0.93, right=0.96, seconds=5400.0),
        words="Radio model 3 is active since 14:05, 12 % better on held-out walks; ap-3 has changed.",
    )
    others = [
        AreaLessons(area=one.id, words="Nobody with a phone has walked yet.") for one in site.areas if one.id != AREA
    ]
    report = LearningReport(
        t=now, areas=[area, *others], cameras=cameras, devices=devices, history=_history(now, devices[0].device)
    )
    return Double(site, report, maps, model)


def _fit(n: int, name: str, rng: np.random.Generator) -> AccessPointFit:
    changed = n == 2
    return AccessPointFit(
        access_point=name,
        power_1m=-40.0 + float(rng.normal(0, 2)),
        path_loss_exponent=2.2 + float(rng.normal(0, 0.2)),
        sigma=None if n == 3 else 3.0 + 2.5 * changed + float(rng.normal(0, 0.2)),
        bias=None if n == 3 else -6.2 if changed else float(rng.normal(0, 0.4)),
        readings=0 if n == 3 else 400 + 30 * n,
        state="changed" if changed else "silent" if n == 3 else "fine",
        position=(7.2, 3.1, 2.5) if changed else None,
        position_error=0.8 if changed else None,
        words=(
            "heard 6 dB weaker than ten minutes ago, everywhere: was something put in front of it?"
            if changed
            else "not heard for two hours: is it switched off?"
            if n == 3
            else ""
        ),
    )


def _history(now: float, device: str) -> list[Activation]:
    evidence = {"readings": 1830.0, "rms before": 5.1, "rms after": 3.9}
    rows = [
        ("radio", AREA, 3, "activated", "explains withheld readings better", 0.21, "learning"),
        ("detector", "hall-east", 2, "activated", "tracks score higher", 0.11, "learning"),
        ("stride", device, 1, "activated", "R² is 0.81 over 900 steps", 0.08, "learning"),
        ("radio", AREA, 3, "refused", "gains less than it must", 0.02, "learning"),
        ("alignment", "hall-east", 1, "rolled back", "by office: it was fine before", None, "operator"),
        ("radio", AREA, 2, "activated", "explains withheld readings better", 0.55, "learning"),
    ]
    return [
        Activation(
            t=now - 600.0 * (n + 1),
            kind=kind,  # type: ignore[arg-type]
            subject=subject,
            version=version,
            decision=decision,  # type: ignore[arg-type]
            reason=reason,
            gain=gain,
            margin=None if gain is None else 0.05,
            evidence=evidence if kind == "radio" else {},
            by=by,  # type: ignore[arg-type]
        )
        for n, (kind, subject, version, decision, reason, gain, by) in enumerate(rows)
    ]


def _walked(site: Site, rng: np.random.Generator) -> tuple[AreaMaps, RadioModel]:
    """Maps and radio model of people who walk about the hall, round what stands in it."""
    floor = site.floor(site.area(AREA).floor)
    plan = floor.plan()
    points = [point for point in site.access_points if point.floor == floor.id]
    maps, radio = AreaMaps.of_site(site, AREA), PathLoss.of(points)
    x0, y0, x1, y1 = plan.outline.bounds
    learner = RadioLearner.over(radio, np.array([x0, y0]), np.array([x1, y1]), 1.0)
    solid = shapely.union_all([plan.obstacles, shapely.box(8.5, 7.0, 11.0, 8.5)])
    for number in range(300):
        ways = [np.linspace(*rng.uniform((x0, y0), (x1, y1), (2, 2)), 26) for _ in range(4)]
        for step in range(0, 26, 2):
            places = np.array([way[step] for way in ways])
            maps.look(5.2 * number + 0.4 * step / 2, places[~shapely.contains_xy(solid, places[:, 0], places[:, 1])])
        walk = ways[0]
        maps.learn(walk, 48.0 + 15.0 * np.exp(-walk[:, 1]) + 4.0 * np.sin(walk[:, 0]) + rng.normal(0.0, 1.5, 26))
        for point in range(len(points)):
            shadow = 5.0 * np.sin(0.4 * walk[:, 0] + point) * np.cos(0.3 * walk[:, 1])
            everything = np.full(26, point)
            learner.learn(walk, np.full(26, 0.2), everything, shadow + rng.normal(0.0, 2.5, 26), np.full(26, 0.2))
    return maps, learner.solve(site.site)
