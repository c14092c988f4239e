"""``python -m services.learning``."""

import os

# Before NumPy is imported: learning's matrices are small, and threads of linear algebra that wait for each other cost
# it five times the processor.
for library in ("OMP", "OPENBLAS"):
    os.environ.setdefault(f"{library}_NUM_THREADS", "1")

from services.learning.service import LearningService  # noqa: E402
from shared.runner import main  # noqa: E402

if __name__ == "__main__":
    main(LearningService)
