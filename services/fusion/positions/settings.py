"""What the anonymous tracker assumes of people and cameras; every duration in seconds, whatever the frame rate."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["AnonymousSettings"]


@dataclass(frozen=True)
class AnonymousSettings:
    """How people move and how cameras err; the defaults suit walking people anywhere.

    They were chosen on training worlds of the twin and on the first 240 seconds of ``eth-walking``'s seq_eth with made
    detections (``atrium bench anonymous-settings``). The second half of that same recording, other people at the same
    place, is what ``eth-phones`` scores; the PETS clip, and the test worlds, had no part in the choice.
    """

    acceleration: float = 0.2
    """Spectral density of the white acceleration, m²/s³."""
    start_speed: float = 1.0
    """Standard deviation of a new person's velocity along each axis, m/s; also of one who rested and walks on."""
    gate: float = 3.0
    """Standard deviations, and ``gate_distance`` metres: farther detections never belong to a track."""
    gate_distance: float = 2.0
    rest_gate: float = 1.0
    """Metres: the same where the track rests."""
    dearest: float = 15.0
    """Mahalanobis² + log det (m²) from which on a track is rather taken for missed and the detection for another."""
    tentative_penalty: float = 6.0
    """Added to an unconfirmed track's cost: at equal distance the established track gets the detection."""
    birth_confidence: float = 0.3
    birth_exclusion: float = 0.8
    """Metres around an established track within which an unmatched detection is taken for its double."""
    confirm_confidence: float = 2.0
    """Sum of confidences, number of detections and age in seconds that confirm a track."""
    confirm_hits: int = 3
    confirm_age: float = 0.5
    tentative_patience: float = 0.25
    """Seconds of misses after which an unconfirmed track dies."""
    report: float = 0.5
    """Seconds of misses after which a confirmed track is less likely a person there than ``told``, and ``coast``
    seconds after which it dies: what is no longer told may still be found again."""
    coast: float = 2.0
    coast_leaving: float = 0.6
    """Seconds of misses after which it dies where it leaves the view."""
    rest_report: float = 5.0
    """``report`` and ``coast`` where the person stood still: detectors that learn their background lose who stands."""
    rest: float = 20.0
    told: float = 0.45
    """Probability of being there above which an unseen track is still told."""
    still_time: float = 1.5
    """Seconds over which a place is averaged; who is within ``still_radius`` metres of that average stands still."""
    still_radius: float = 0.35
    walked: float = 1.0
    """Metres from where it was seen first that make a track one of a person who may rest."""
    rose_distance: float = 1.5
    """Metres from a resting track within which somebody who appears and walks is the one who rested there."""
    rose_time: float = 2.0
    """Seconds for which the place left may still be taken for the person."""
    rest_diffusion: float = 0.003
    """By how much the variance of a resting person's place grows, m²/s along each axis."""
    lasting: float = 0.6
    """Share of a detection's variance that that camera's next ones have in common: they do not average it out."""
    leaving_depth: float = 0.3
    """Metres from the border of the view, ``look_ahead`` seconds from now, that count as leaving."""
    look_ahead: float = 0.3
    forget: float = 10.0
    """Seconds without any detection, cameras silent or not, after which a track that does not rest dies."""
    set_back: float = 1.0
    """Seconds by which a frame must be older than the newest to be no late frame but of a clock set back."""
    slow_down: float = 2.8
    """Time constant with which an unseen person's assumed velocity fades, seconds."""
    longest_interval: float = 1.0
    """Seconds: of a longer silence of a camera, this much counts as missed once it shows an empty place again."""
