"""``python -m services.history``."""

import os

# Before NumPy is imported: the arrays are small, threads that wait for each other only cost.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

from services.history.service import HistoryService  # noqa: E402
from shared.runner import main  # noqa: E402

if __name__ == "__main__":
    main(HistoryService)
