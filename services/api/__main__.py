"""``python -m services.api``."""

import sys

from services.api.service import ApiService
from shared.runner import run

sys.exit(run(ApiService))
