"""``python -m services.api``."""

from services.api.service import ApiService
from shared.runner import main

main(ApiService)
