"""Takes questions about models from the bus: answers what is wrong with them at once, tries one at a time elsewhere."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading

import msgspec
import structlog

from services.fusion.area_view import AreaView
from services.fusion.rescore.candidate import CandidateError, apply, check_size, read_candidate
from services.fusion.rescore.recent import RecentChunks
from services.fusion.rescore.worker import Job, too_few
from shared.bus import Question

__all__ = ["RescoreDesk"]

READ_AT_ONCE = 2**20
"""Bytes; to read what is longer takes so long that fusion would feel it, so the trial's own process does."""

log = structlog.get_logger(__name__)


class RescoreDesk:
    """Answers one area's questions.

    ``view`` may be set anew when another radio model goes live.

    Args:
        view: the area under the active model.
        tracker: name of the tracker that runs.
        seed: of it.
        recent: what it consumed lately.
        patience: seconds a trial may take.
    """

    def __init__(self, view: AreaView, tracker: str, seed: int, recent: RecentChunks, patience: float) -> None:
        self.view = view
        self._tracker = tracker
        self._seed = seed
        self._recent = recent
        self._patience = patience
        self._free = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False
        self._erasures = 0

    def take(self, question: Question) -> None:
        """Answer a question, soon or when its trial is over; returns at once."""
        try:
            check_size(question.payload)
            if len(question.payload) <= READ_AT_ONCE:
                apply(read_candidate(question.payload), self.view)
        except CandidateError as error:
            question.answer(_refusal(str(error)))
            return
        erasures, chunks = self._erasures, self._recent.copy()
        if not chunks:
            question.answer(_refusal(too_few(0)))
            return
        if self._closed or not self._free.acquire(blocking=False):
            question.answer(_refusal("busy: another candidate is being tried; ask again later"))
            return
        job = Job(chunks, self._tracker, self._seed, self.view, question.payload)
        threading.Thread(target=self._try, args=(job, question, erasures), name="rescore", daemon=True).start()

    def close(self) -> None:
        """End what is being tried: the service stops."""
        self._closed = True
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def forget(self) -> None:
        """End what is being tried: somebody in it withdrew consent."""
        self._erasures += 1
        if self._process is not None and self._process.poll() is None:
            self._process.kill()

    def _try(self, job: Job, question: Question, erasures: int) -> None:
        try:
            told = self._run(job)
            withdrawn = erasures != self._erasures
            question.answer(_refusal("somebody withdrew consent meanwhile; ask again later") if withdrawn else told)
        finally:
            self._free.release()

    def _run(self, job: Job) -> bytes:
        environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        with subprocess.Popen(
            [sys.executable, "-m", "services.fusion.rescore.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env=environment,
        ) as self._process:
            if self._closed:
                self._process.kill()
            try:
                told, said = self._process.communicate(pickle.dumps(job), timeout=self._patience)
            except subprocess.TimeoutExpired:
                self._process.kill()
                words = f"the trial took more than {self._patience:g} s; keep fewer minutes (rescore_minutes)"
                return msgspec.json.encode({"error": words, "took": self._patience})
        if self._process.returncode != 0:
            log.warning("a trial failed", status=self._process.returncode, reason=said.decode(errors="replace")[-500:])
            return _refusal("the trial failed; the service's log says why")
        return told


def _refusal(words: str) -> bytes:
    return msgspec.json.encode({"error": words})
