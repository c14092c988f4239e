"""Run one camera: ``python -m services.camera --site-file SITE --camera ID``."""

import sys

from services.camera.service import CameraService
from shared.runner import run

sys.exit(run(CameraService))
