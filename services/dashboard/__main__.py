"""``python -m services.dashboard``."""

import sys

from services.dashboard.service import DashboardService
from shared.runner import run

if __name__ == "__main__":
    sys.exit(run(DashboardService))
