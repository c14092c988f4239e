"""``python -m services.simulator``."""

from services.simulator.service import Simulator
from shared.runner import main

main(Simulator)
