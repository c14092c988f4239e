"""What the identity layer believes of radios and people before it has seen any."""

from __future__ import annotations

from dataclasses import dataclass

from shared.radio import RadioNoise

__all__ = ["IdentitySettings"]

NOISE = RadioNoise(white=2.5, shadowing=4.0, shadowing_range=3.0, access_point=4.0, device=3.0)


@dataclass(frozen=True)
class IdentitySettings:
    """What is believed of radios and people before any is seen."""

    noise: RadioNoise = NOISE
    """``access_point`` covers an exponent that is off as well as a power that is off."""
    elsewhere_speed: float = 0.7
    """Speed of a person out of view, m/s: how fast a stranger's readings lose their memory."""
    elsewhere_range: float = 5.0
    """Metres over which what a stranger hears stays alike."""
    far_prior: float = -3.0
    """Log-odds that a phone on no track is not carried about here but rests somewhere or is far away: all it hears may
    be off by ``far_level`` dB, each access point by ``far_constant`` dB, and it moves but slowly."""
    far_level: float = 15.0
    far_constant: float = 6.0
    far_speed: float = 0.1
    trust: float = 1.0
    """Share of the radio evidence that is believed …"""
    trust_motion: float = 1.0
    """… and of what phones tell of their walks."""
    prior: float = 2.0
    """Log-odds that a device is on a given new track, each track by itself. Above zero, because a stranger's readings
    are explained a little too well: they are fitted by a Gaussian that knows no path."""
    cap: float = 12.0
    """Largest log-odds either way: no past is so sure that it could not be overruled."""
    fade_distance: float = 40.0
    """Metres of path after which evidence counts 1/e."""
    swap_rate: float = 0.1
    """Probability per second that two tracks at the same place exchange persons, and its range in metres."""
    swap_range: float = 0.6
    lost: float = 8.0
    """Seconds for which a track that ended may be continued by a new one."""
    continued: float = 0.5
    """Probability that a track born right where another was lost continues it."""
    claim: float = 0.6
    """Probability from which a device gets a track, and down to which it keeps it."""
    keep: float = 0.3
    claim_scans: int = 4
    """Scans a device must have told before it gets a track at all …"""
    claim_fresh: float = 2.5
    """… and seconds since it last told anything, after which it gets no other track."""
    certain: float = 0.9
    """Probability from which a pair teaches the access points' constants, put to use every so many seconds."""
    calibrate_every: float = 2.0
    residual_constant: float = 1.0
    """dB; what a learned constant may still be off for one phone."""
    cycle: float = 0.25
    """Seconds between decisions while scans come in."""
    forget: float = 60.0
    """Seconds without a scan after which a device is forgotten."""
    longest_chain: int = 16
    """Former tracks remembered of one person."""
    waiting: int = 5_000
    """Scans held until the cameras have reached their time."""
