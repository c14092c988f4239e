"""Run fusion: ``python -m services.fusion``."""

import sys

from services.fusion.service import FusionService
from shared.runner import run

if __name__ == "__main__":
    sys.exit(run(FusionService))
