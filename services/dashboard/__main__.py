"""``python -m services.dashboard``."""

from services.dashboard.service import DashboardService
from shared.runner import main

if __name__ == "__main__":
    main(DashboardService)
