"""Which step detectors are there, and which one for a phone in the hand, a pocket, a bag?"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from services.gateway.steps.adaptive_dft import AdaptiveDft
from services.gateway.steps.detector import StepDetector
from services.gateway.steps.gated_peaks import GatedPeaks
from services.gateway.steps.step_hmm import StepHmm
from services.gateway.steps.thresholds import PersonalThresholds

__all__ = ["DETECTORS", "SHIPPED"]

DETECTORS: Mapping[str, Callable[[], StepDetector]] = {
    "adaptive-dft": AdaptiveDft,
    "gated-peaks": GatedPeaks,
    "personal-thresholds": PersonalThresholds,
    "step-hmm": StepHmm,
}
"""Every implementation; the contract test runs on each."""

SHIPPED: Mapping[str, str] = {
    "hand": "gated-peaks",
    "pocket": "gated-peaks",
    "bag": "gated-peaks",
    "unknown": "gated-peaks",
}
"""By how a phone is carried, the detector that counts best there in ``benchmarks/step_table.py``.

Hand, front and back pocket, and purse were measured, and the same one of ``DETECTORS`` won in all; it also tells the
fewest steps while a phone is only handled.
"""
