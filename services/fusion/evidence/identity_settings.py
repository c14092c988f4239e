"""What the identity layer believes of radios and people before it has seen any."""

from __future__ import annotations

from dataclasses import dataclass, field

from services.fusion.evidence.belief import Flow
from shared.radio import RadioNoise

__all__ = ["NOISE", "IdentitySettings"]

NOISE = RadioNoise(white=2.5, shadowing=4.0, shadowing_range=3.0, access_point=4.0, device=3.0)
"""What readings are like before any is heard; ``access_point`` covers an exponent that is off as well."""


@dataclass(frozen=True)
class IdentitySettings:
    """What is believed of radios and people before any is seen."""

    flow: Flow = field(default_factory=Flow)
    shadowing: float = 4.0
    """dB; what a place, the carrier's body and slow fading add to path loss."""
    shadowing_known: float = 3.0
    """The same without the place's part, where a shadowing map tells that."""
    white: float = 2.0
    """dB, of one reading by itself; readings gathered in one scan share it out."""
    device: float = 3.0
    """dB; how differently phones read, and how differently they send where receivers of the site hear them."""
    device_sent: float = 6.0
    common: float = 2.0
    """dB; what all access points' readings differ by from scan to scan: how the phone is held and turned."""
    memory: float = 8.0
    """Seconds after which a still phone's readings are 1/e alike, and by how much longer for each second it has stood:
    what the place adds stays."""
    habit: float = 1.0
    reach: float = 1.5
    """Metres after which a walking phone's readings are 1/e alike."""
    gather: float = 0.9
    """Seconds for which scans are gathered into one."""
    trust_motion: float = 0.7
    """Share of the evidence of phones' walks that is believed."""
    strange: float = 15.0
    """By how much worse than expected a scan must fit everywhere before its device is thought far away; in units of its
    misfit."""
    unknown_speed: float = 0.7
    """m/s; how fast a device that tells nothing of its walk may drift about unseen."""
    vague_novelty: float = 0.1
    """m/s; how fast one that says it neither stands nor walks comes to places that sound new, and may drift about."""
    vague_speed: float = 0.3
    still_speed: float = 0.03
    """m/s; the same of one that says it stands."""
    step_error: float = 0.3
    """Share of a second's walk by which dead reckoning is off besides what its heading does."""
    claim: float = 0.5
    """Probability, of the joint marginals, from which a device gets a track, and down to which it keeps it: a name less
    likely right than wrong is not told. Assignments solved again with perturbed odds tell no better whom to doubt."""
    keep: float = 0.5
    claim_unwalked: float = 0.75
    """The same for a device that has told nothing of its walk for ``claim_walked`` seconds: by radio alone a phone that
    is elsewhere is easily taken for somebody here."""
    claim_walked: float = 10.0
    claim_scans: int = 3
    """Scans a device must have told before it gets a track at all …"""
    claim_fresh: float = 2.5
    """… and seconds since it last told anything, after which it gets no other track."""
    told: float = 5.0
    """Seconds since it last told anything after which a device that no camera sees is not told any more."""
    largest_sigma: float = 4.0
    """Metres; a device known less well than that is nowhere."""
    unwalked_teaches: float = 0.2
    """How much a device that tells nothing of its walk teaches of the radio, against one that does."""
    calibrate_every: float = 2.0
    """Seconds after which what was learned of the access points is put to use."""
    cycle: float = 0.25
    """Seconds between decisions while phones tell something."""
    forget: float = 60.0
    """Seconds without a scan after which a device is forgotten."""
    kept: float = 8.0
    """Seconds for which the path of a track that ended is remembered."""
    longest_chain: int = 16
    """Former tracks remembered of one person."""
    at_once: int = 64
    """Scans, and batches of motion, taken in one step; more wait for the next ones. On a real clip a wait of one to
    five steps changes next to nothing, one of eight costs names."""
    waiting: int = 5_000
    """Scans held until the cameras have reached their time, or until there is time for them."""
