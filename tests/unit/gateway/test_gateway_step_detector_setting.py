"""Which step detector the gateway uses can be set, by its name."""

from typing import get_args

import pytest
from pydantic import ValidationError

from services.gateway.settings import GatewaySettings, StepDetectorName
from services.gateway.steps.detectors import DETECTORS


def test_every_detector_can_be_set_and_no_other() -> None:
    assert set(get_args(StepDetectorName)) == {"shipped", *DETECTORS}
    assert GatewaySettings().step_detector == "shipped"
    assert GatewaySettings(step_detector="personal-thresholds").step_detector == "personal-thresholds"
    with pytest.raises(ValidationError):
        GatewaySettings(step_detector="ears")  # type: ignore[arg-type]
