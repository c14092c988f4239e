"""How a generator of random numbers travels in a state: its integers are longer than JSON's, so they go as text."""

from __future__ import annotations

from typing import Any

import numpy as np

__all__ = ["generator_of", "generator_state"]


def generator_state(generator: np.random.Generator) -> dict[str, Any]:
    """Return where a PCG64 generator stands, as plain values."""
    state = generator.bit_generator.state
    numbers = {key: str(value) for key, value in state["state"].items()}
    return {**numbers, "has_uint32": state["has_uint32"], "uinteger": state["uinteger"]}


def generator_of(state: dict[str, Any]) -> np.random.Generator:
    """Return a generator that goes on from there."""
    generator = np.random.default_rng()
    generator.bit_generator.state = {
        "bit_generator": "PCG64",
        "state": {key: int(state[key]) for key in ("state", "inc")},
        "has_uint32": state["has_uint32"],
        "uinteger": state["uinteger"],
    }
    return generator
