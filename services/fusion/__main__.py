"""Run fusion: ``python -m services.fusion``."""

import gc
import sys

from services.fusion.service import FusionService
from shared.runner import run

if __name__ == "__main__":
    # What was imported lives as long as the process: to look through it for garbage every few seconds would hold up
    # everything, the bus's own threads included, for longer than a frame.
    gc.collect()
    gc.freeze()
    sys.exit(run(FusionService))
