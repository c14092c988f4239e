"""``python -m services.gateway``."""

from services.gateway.service import GatewayService
from shared.runner import main

main(GatewayService)
