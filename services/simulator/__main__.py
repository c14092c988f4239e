"""``python -m services.simulator``."""

import sys

from services.simulator.service import Simulator
from shared.runner import run

sys.exit(run(Simulator))
