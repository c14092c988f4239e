"""The learner of detector options: one camera of an area at a time, now and then, when people have walked well.

A sweep asks the camera and fusion a dozen times and takes minutes of their spare time; it runs beside the learner,
which proposes once it is over.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future
from typing import Any

import msgspec

from services.learning.cameras.detector_choice import SWEEPS, DetectorChoice, choose_detector
from services.learning.cameras.size_words import differ, size_words
from services.learning.proposal import Proposal
from services.learning.report_draft import ReportDraft
from services.learning.tracks.stretch import Stretch
from shared.learning_report import ModelKind
from shared.messages import CameraStatus, DetectorSettings, Message

__all__ = ["NO_PICTURES", "DetectorLessons"]

EVERY = 3600.0
"""Seconds between two sweeps of one area's cameras."""
FEWEST = 5
"""Good stretches since the last sweep without which there is nobody to tell options apart by."""
TRIES = 20
"""Times a busy camera or fusion is asked again, each after ``PAUSE`` seconds."""
PAUSE = 5.0
NO_PICTURES = "no pictures:"
"""How the answer begins where there are none to try options on: nothing to be waited for."""
RARELY = 6.0 * 3600.0
"""Seconds after which a camera without pictures is asked again."""

Redetect = Callable[[str, Mapping[str, float]], Mapping[str, Any]]
Rescore = Callable[[str, bytes], Mapping[str, Any]]


class DetectorLessons:
    """Learns the detector options of one area's cameras.

    Args:
        area: its id.
        cameras: their ids, those that have pictures.
        redetect: camera, options → the camera's answer (``Keys.redetect``).
        rescore: area, question → fusion's answer (``Keys.rescore``).
        executor: where sweeps run.
        wait: waits some seconds; what it returns is left out.
    """

    kind: ModelKind = "detector"

    def __init__(
        self,
        area: str,
        cameras: Sequence[str],
        redetect: Redetect,
        rescore: Rescore,
        executor: Executor,
        wait: Callable[[float], object],
    ) -> None:
        self.area = area
        self._cameras = tuple(cameras)
        self._redetect, self._rescore = redetect, rescore
        self._executor, self._wait = executor, wait
        self._active: dict[str, DetectorSettings] = {}
        self._swept: dict[str, float] = {}
        self._pictureless: dict[str, float] = {}
        """When a camera last said that it has no pictures."""
        self._doubts: dict[str, str] = {}
        """Why a camera's pictures cannot teach now, as it says itself."""
        self._now = 0.0
        self._stretches = 0
        self._running: tuple[str, Future[tuple[DetectorChoice, float]]] | None = None
        self._void = False
        """Whether what the sweep under way finds no longer counts."""
        self.words: dict[str, str] = {}
        """By camera what its last sweep found, for people."""

    def learn(self, stretch: Stretch) -> None:
        """Note that somebody walked well; what is learned comes from the cameras' pictures."""
        self._stretches += 1

    def watch(self, message: Message) -> None:
        """Leave a camera alone while it says that something is wrong with it: covered, turned, knocked, silent."""
        if isinstance(message, CameraStatus) and message.camera in self._cameras:
            if message.state != "degraded":
                self._doubts.pop(message.camera, None)
                return
            self._doubts[message.camera] = message.reason
            self._drop(message.camera)

    def forget(self, device: str) -> None:
        """Nothing here is of any device."""

    def propose(self, now: float, until: float) -> Sequence[Proposal]:
        """Begin a sweep when one is due, propose what the last one found; see ``Learner``."""
        if self._running is not None:
            camera, future = self._running
            if not future.done():
                return ()
            self._running = None
            if not self._void:
                return self._found(camera, future)
        if max([*self._swept.values(), *self._pictureless.values()], default=now) > now:  # a clock was set back
            self._swept.clear()
            self._pictureless.clear()
        self._now = now
        last = max(self._swept.values(), default=-EVERY)
        if now - last >= EVERY and self._stretches >= FEWEST and (able := self._with_pictures()):
            camera = min(able, key=lambda name: self._swept.get(name, -EVERY))
            self._swept[camera] = now
            self._stretches = 0
            self._void = False
            self._running = camera, self._executor.submit(self._sweep, camera, self._options(camera))
        return ()

    def activated(self, model: Message) -> None:
        """Other options are in use from now on; a sweep under way was held against the ones before, and is dropped."""
        if isinstance(model, DetectorSettings) and model.camera in self._cameras:
            self._active[model.camera] = model
            self._drop(model.camera)

    def tell(self, draft: ReportDraft) -> None:
        """Add the options in use, and what the last sweep of each camera found."""
        for camera in self._cameras:
            active = self._active.get(camera)
            version = 0 if active is None else active.version
            draft.camera(camera, self.area, version=version, options=self._options(camera))
            draft.camera_words(camera, self.area, self._words_of(camera))

    def _words_of(self, camera: str) -> str:
        """Return what is done or waited for, or what was found last."""
        if self._running is not None and self._running[0] == camera and not self._void:
            return "other detector options are being tried on its last minutes"
        if camera in self._doubts:
            return f"its detector learns nothing while it is degraded: {self._doubts[camera]}"
        if camera in self.words:
            return self.words[camera]
        if self._stretches < FEWEST:
            return (
                f"its detector's options are tried once people with phones have walked well in view: "
                f"{self._stretches} of {FEWEST} walks so far"
            )
        return "its detector's options are tried soon"

    def state(self) -> dict[str, Any]:
        """Return when each camera was swept last; what is active is told anew after a restart."""
        return {"swept": dict(self._swept), "pictureless": dict(self._pictureless)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from ``state()``; see ``Learner``."""
        try:
            swept = msgspec.convert(state["swept"], dict[str, float])
            pictureless = msgspec.convert(state.get("pictureless", {}), dict[str, float])
        except (KeyError, msgspec.ValidationError) as error:
            raise ValueError(f"detector lessons: swept or pictureless: {error}") from error
        self._swept, self._pictureless = swept, pictureless

    def _drop(self, camera: str) -> None:
        """Let a camera's sweep count for nothing; the next begins once it has ended, on the same people's walks."""
        if self._running is not None and self._running[0] == camera and not self._void:
            self._void = True
            self._swept.pop(camera, None)
            self._stretches += FEWEST

    def _with_pictures(self) -> list[str]:
        """Return the cameras that may have pictures to learn from: all but those that said that they have none."""
        lately = {name for name, t in self._pictureless.items() if self._now - t < RARELY}
        return [name for name in self._cameras if name not in lately and name not in self._doubts]

    def _options(self, camera: str) -> dict[str, float]:
        active = self._active.get(camera)
        return {} if active is None else dict(active.options)

    def _found(self, camera: str, future: Future[tuple[DetectorChoice, float]]) -> Sequence[Proposal]:
        error = future.exception()
        if error is not None:
            self.words[camera] = f"its options could not be tried: {error}"
            return ()
        choice, newest = future.result()
        if choice.refused.startswith(NO_PICTURES):
            self._swept.pop(camera, None)  # the next one need not wait
            self._pictureless[camera] = self._now
        proposal = choice.proposal(camera, self.area, newest, self._options(camera))
        self.words[camera] = choice.refused or (
            "its detector is set as well as can be told" if proposal is None else proposal.reason
        )
        if choice.sizes and not choice.sizes.keys() <= choice.options.keys():
            self.words[camera] += f"; {size_words(choice.sizes)}, but would be followed no better if that were used"
        return () if proposal is None else (proposal,)

    def _sweep(self, camera: str, active: Mapping[str, float]) -> tuple[DetectorChoice, float]:
        """Return what a sweep finds, and the time of the newest picture; runs in a thread of its own."""
        begin = self._asked(lambda: _checked(camera, self._redetect(camera, active)))
        if "error" in begin:
            return DetectorChoice(refused=str(begin["error"])), 0.0
        in_use = {sweep.option: begin["options"].get(sweep.option, 0.0) for sweep in SWEEPS}
        anybody = _shows_anybody(begin)
        sweeps = [sweep for sweep in SWEEPS if in_use[sweep.option] > 0.0]  # a detector of one's own has others

        def redetect(options: Mapping[str, float]) -> Mapping[str, Any] | None:
            if all(begin["options"][name] == value for name, value in options.items()):
                return begin
            told = self._asked(lambda: _checked(camera, self._redetect(camera, {**active, **options})))
            # Other pictures, or people put elsewhere on the plan, cannot be compared.
            same = "error" not in told and all(told[name] == begin[name] for name in ("since", "until", "alignment"))
            nonlocal anybody
            anybody = anybody or (same and _shows_anybody(told))
            return told if same else None

        def score(told: Mapping[str, Any], best: Mapping[str, Any]) -> Mapping[str, float] | None:
            frames = {"frames": {camera: told["frames"]}, "active": {camera: best["frames"]}}
            question = msgspec.json.encode({"kind": "detections", **frames})
            sight = self._asked(lambda: self._rescore(self.area, question)).get("sight")
            if not sight or sight.get("candidate") is None:
                return None
            return {"cqs": sight["candidate"], "error": sight.get("gain_error") or 0.0}

        sizes = dict(begin.get("sizes", {}))
        known = all(name in begin["options"] for name in sizes)
        tried = sizes if known and differ(sizes, begin["options"]) else None
        choice = choose_detector(in_use, redetect, score, sweeps, tried)
        if not anybody:
            words = (
                f"camera {camera} sees nobody in its last pictures, whatever its options: does it look into the room?"
            )
            choice = DetectorChoice(refused=words)
        return choice, float(begin["until"])

    def _asked(self, ask: Callable[[], Mapping[str, Any]]) -> Mapping[str, Any]:
        """Return an answer; who is busy is asked again."""
        told = ask()
        for _ in range(TRIES):
            if not str(told.get("error", "")).startswith("busy"):
                break
            self._wait(PAUSE)
            told = ask()
        return told


class _Redetected(msgspec.Struct, frozen=True):
    """What is read of a camera's answer."""

    frames: list[dict[str, Any]]
    since: float
    until: float
    options: dict[str, float]
    alignment: int = 0
    sizes: dict[str, float] = {}


def _shows_anybody(told: Mapping[str, Any]) -> bool:
    return any(frame.get("x") for frame in told["frames"])


def _checked(camera: str, told: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return a camera's answer, or an ``error`` in its place where it is none."""
    if "error" in told:
        return told
    try:
        msgspec.convert(told, _Redetected)
    except msgspec.ValidationError as error:
        return {"error": f"what camera {camera} answers is not understood: {error}"}
    return told
