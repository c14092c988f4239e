"""``python -m services.geofence``."""

import sys

from services.geofence.service import GeofenceService
from shared.runner import run

sys.exit(run(GeofenceService))
