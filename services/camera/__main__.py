"""Run one camera: ``python -m services.camera --site-file SITE --camera ID``."""

from services.camera.service import CameraService
from shared.runner import main

main(CameraService)
