"""``python -m services.geofence``."""

from services.geofence.service import GeofenceService
from shared.runner import main

main(GeofenceService)
