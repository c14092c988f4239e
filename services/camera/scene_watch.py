"""Does the camera still look where it looked? Its edges now against those of the scene it came to know.

Edges, not brightness: light comes and goes, and so do people, whom the median of half a minute leaves out. A picture
without edges is covered, out of focus or dark; edges that lie elsewhere by the same way everywhere are a camera that
was knocked; edges that fit nowhere are another place. What was known is in memory only: a camera moved while its
process is down is noticed by its positions, not here.
"""

from __future__ import annotations

from collections import deque
from typing import cast

import cv2
import numpy as np
from numpy.typing import NDArray

from services.camera.detector import Image

__all__ = ["SceneWatch", "same_place"]

Edges = NDArray[np.complex64]
"""Gradients (h, w), grey levels per pixel."""

WIDTH = 160
"""Pixels across that are compared."""
EVERY = 2.0
"""Seconds between two looks."""
LOOKS = 15
"""Looks whose median is the present scene: half a minute."""
COMPARED = 5
"""Looks from one comparison to the next."""
SURE = 3
"""Comparisons in a row that must say the same before it is told: half a minute more."""
BLIND = 0.3
"""Share of the known scene's edges (their mean strength) below which there are none."""
BLANK = 0.2
"""Mean strength, grey levels per pixel, below which a picture shows nothing from the start; a bare hall has 1."""
NOTHING = "the camera sees next to nothing: it is covered or out of focus, looks at a wall, or it is dark"
STRONG = 75
"""Percentile of strength from which on the known scene's pixels count as edges."""
FAINT = 2.0
"""Grey levels per pixel: the direction of a fainter edge is half noise."""
ALIKE = 0.4
"""Mean cosine between known and present edges' directions from which on it is the known scene,"""
OTHER = 0.2
"""and below which it is another."""
CLEARER = 0.15
"""By how much the cosine must grow when the picture is shifted back."""
SHIFT = 1.5
"""Of the small picture's pixels: a smaller shift is not told."""
ADOPT = 0.02
"""Share of the known scene that is renewed by a comparison that fits: furniture moves, shadows wander."""


class SceneWatch:
    """Watches one camera's view; feed it every picture."""

    def __init__(self) -> None:
        self._looks: deque[Image] = deque(maxlen=LOOKS)
        self._number = 0
        self._last = -np.inf
        self._known: Edges | None = None
        self._strength = 0.0
        self._size = (0, 0)
        self._row: deque[str] = deque(maxlen=SURE)
        self.verdict = ""
        """What is wrong with the view, in plain words; empty while it is the known one."""

    def take(self, image: Image, t: float) -> None:
        """Look at a picture (h, w, 3) taken at ``t``, if a look is due."""
        if abs(t - self._last) < EVERY:
            return
        self._last = t
        size = (image.shape[1], image.shape[0])
        if size != self._size:
            self.forget()
            self._size = size
        self._looks.append(_grey(image))
        self._number += 1
        if len(self._looks) == LOOKS and not self._number % COMPARED:
            self._compare(_edges(np.median(np.stack(self._looks), axis=0).astype(np.float32)))

    def forget(self) -> None:
        """Get to know the view anew: it is the right one from now on."""
        self._looks.clear()
        self._row.clear()
        self._number = 0
        self._known = None
        self.verdict = ""

    def _compare(self, edges: Edges) -> None:
        strength = float(np.abs(edges).mean())
        if self._known is None:
            self.verdict = NOTHING if strength < BLANK else ""
            if self.verdict:
                return
            self._known, self._strength = edges, strength
            return
        kind, words = self._judged(edges, strength)
        self._row.append(kind)
        if len(self._row) == SURE and len(set(self._row)) == 1:
            self.verdict = words
        if not kind and not self.verdict:
            self._known += np.float32(ADOPT) * (edges - self._known)
            self._strength += ADOPT * (strength - self._strength)

    def _judged(self, edges: Edges, strength: float) -> tuple[str, str]:
        """Return what is wrong, as one word and in a sentence; both are empty where nothing is."""
        if strength < BLIND * self._strength:
            return "blind", NOTHING
        there, shifted, way = agreement(cast(Edges, self._known), edges)
        if way >= SHIFT and shifted >= max(ALIKE, there + CLEARER):
            pixels = round(way * self._size[0] / WIDTH)
            return "shifted", f"the picture has shifted by {pixels} pixels: was the camera knocked? Calibrate it again"
        if there < OTHER:
            return (
                "other",
                "the camera shows another place than before: was it turned? Turn it back or calibrate it again",
            )
        return "", ""


def agreement(known: Edges, edges: Edges) -> tuple[float, float, float]:
    """Return how well edges' directions agree at the known edges: as they are, shifted to fit best, and by how far.

    Directions (complex gradients, (h, w)) and not strengths, at the known edges and not everywhere: who stands in the
    picture hides some edges and brings strong ones of their own, which then count for nothing.
    """
    strength = np.abs(known)
    wanted = np.where(
        strength >= max(float(np.percentile(strength, STRONG)), 1e-6), known / np.maximum(strength, 1e-6), 0
    )
    found = edges / (np.abs(edges) + FAINT)
    match = np.fft.ifft2(np.conj(np.fft.fft2(wanted)) * np.fft.fft2(found)).real / max(float(np.abs(wanted).sum()), 1.0)
    row, column = np.unravel_index(int(np.argmax(match)), match.shape)
    rows, columns = match.shape
    down = (int(row) + rows // 2) % rows - rows // 2
    right = (int(column) + columns // 2) % columns - columns // 2
    return float(match[0, 0]), float(match[row, column]), float(np.hypot(down, right))


def same_place(a: Image, b: Image) -> bool:
    """Whether two pictures (h, w, 3), of whatever sizes and light, show one place from one place."""
    first, second = _grey(a).astype(np.float32), _grey(b).astype(np.float32)
    return first.shape == second.shape and agreement(_edges(first), _edges(second))[0] >= ALIKE


def _grey(image: Image) -> Image:
    size = (WIDTH, max(round(WIDTH * image.shape[0] / image.shape[1]), 1))
    return cast(Image, cv2.cvtColor(cv2.resize(image, size, interpolation=cv2.INTER_AREA), cv2.COLOR_BGR2GRAY))


def _edges(grey: NDArray[np.float32]) -> Edges:
    blurred = cv2.GaussianBlur(grey, (0, 0), 1.0)
    across, down = cv2.Sobel(blurred, cv2.CV_32F, 1, 0, scale=0.125), cv2.Sobel(blurred, cv2.CV_32F, 0, 1, scale=0.125)
    return np.asarray(across + 1j * down, np.complex64)
