"""``python -m services.learning``."""

import sys

from services.learning.service import LearningService
from shared.runner import run

sys.exit(run(LearningService))
