"""One seed, many independent streams: each named part of the world draws from a generator of its own.

So that adding a person, a phone or an access point changes nothing about the others.
"""

from __future__ import annotations

import zlib

import numpy as np

__all__ = ["generator"]


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return the generator of the part of world ``seed`` that is called ``names``; same arguments, same numbers."""
    return np.random.default_rng([seed, *(zlib.crc32(name.encode()) for name in names)])
