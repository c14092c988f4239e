"""A port for a process that an experiment starts."""

from __future__ import annotations

import socket

__all__ = ["unused_port"]


def unused_port() -> int:
    """Return a port of this machine on which nobody listens now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
