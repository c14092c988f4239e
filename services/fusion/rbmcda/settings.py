"""What the identity filter believes of people, cameras, radios and phones before it has seen any."""

from __future__ import annotations

from dataclasses import dataclass

from shared.radio import RadioNoise

__all__ = ["RbmcdaSettings"]

NOISE = RadioNoise(white=3.6, shadowing=3.0, shadowing_range=3.0, access_point=4.5, device=3.0)


@dataclass(frozen=True)
class RbmcdaSettings:
    """N = 100 and the cycle are the original's, the rest it does not publish [ravel-thesis §15]."""

    particles: int = 100
    noise: RadioNoise = NOISE
    """``access_point``, ``shadowing`` and ``device`` are what each device's state carries as a bias of every access
    point; all three zero: the radio's constants are known, and there is no bias to learn."""
    resting: float = 5.0
    """Factor on the variance of what a resting phone hears: what bodies do to its radio, which is most of ``white``,
    lasts for seconds then, and half a metre in one who walks."""
    shadowing_memory: float = 60.0
    """Seconds after which what a place does to the radio has changed, even for who stands still."""
    radio_only: bool = True
    """Whether a scan corrects a device that no camera saw in the cycle; the original says no."""
    walking: float = 0.2
    """Metres along each axis in one second that steps leave open …"""
    standing: float = 0.06
    """… that a phone at rest leaves open …"""
    restless: float = 0.35
    """… that a phone handled without steps leaves open …"""
    unknown: float = 0.8
    """… and where nothing is known of the phone's motion."""
    guessed: float = 0.6
    """Metres per second by which a walk may differ from its last second while its steps are on their way."""
    detection: float = 0.9
    """Probability that somebody in view who moves is seen in a cycle …"""
    detection_still: float = 0.35
    """… down to which it falls for who stands still: detectors take the still for background …"""
    fading: float = 5.0
    """… with this time constant, seconds."""
    merged: float = 0.03
    """Probability that a sighting that is already somebody's is a second person's too (the fourth restriction,
    relaxed for merged boxes); 0 for the original's rule."""
    camera: float = 0.15
    """Metres added to what a camera says of its own noise: heads sway, feet are hidden."""
    gate: float = 4.0
    """Standard deviations beyond which a device and a sighting form no composite."""
    fresh: float = 0.35
    """Seconds before a camera's newest frame within which what it saw still counts."""
    same: float = 0.5
    """Metres within which two people have met, and are not linked to who they were before; for the vision-only
    filter."""
    switched: float = 0.005
    """Probability per cycle that who is followed is not the same person any more …"""
    met: float = 0.1
    """… and how much more of two who stand on one spot; ``met_range`` metres apart it is a third of that."""
    met_range: float = 0.6
    pickup: float = 0.2
    """Factor on the density at which a device that is on nobody is taken for somebody followed for longer than
    ``young`` seconds: whoever that is was there before."""
    young: float = 1.5
    trust_motion: float = 0.7
    """Share of the evidence of phones' walks that is believed."""
    jump: float = 0.002
    """Probability per cycle that nothing before counts and a device may be anywhere again: the way back from a
    stranger on whom all particles have settled; 0 for the original …"""
    jump_unseen: float = 0.02
    """… and of one that no camera saw in the last cycle: a single Gaussian of the unseen loses its way."""
    separate: bool = True
    """Whether every device weighs and draws its particles for itself, which a hundred particles need for more than two
    or three devices; the original weighs them together."""
    resample_below: float = 0.5
    """Share of particles that must count for something, or they are drawn anew."""
    lost: float = 4.0
    """Seconds without a camera after which a device is told as out of view."""
    forget: float = 60.0
    """Seconds without a word from a device after which it is forgotten."""
    set_back: float = 5.0
    """Seconds by which the cameras' clock must fall back, or ``forget`` by which it must leap, to start anew."""
    forces: bool = False
    """Whether people, walls and obstacles push predictions (eq. 4.12)."""
