"""One package per process; run one with ``python -m services.NAME``."""
