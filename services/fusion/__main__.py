"""Run fusion: ``python -m services.fusion``."""

from services.fusion.service import FusionService
from shared.runner import main

if __name__ == "__main__":
    main(FusionService)
