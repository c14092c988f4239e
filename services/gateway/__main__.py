"""``python -m services.gateway``."""

import sys

from services.gateway.service import GatewayService
from shared.runner import run

sys.exit(run(GatewayService))
