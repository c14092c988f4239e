"""Which step detector the gateway uses can be set, by its name."""

from typing import get_args

from services.gateway.settings import GatewaySettings, StepDetectorName
from services.gateway.steps.detectors import DETECTORS


def test_every_detector_can_be_set_and_no_other() -> None:
    assert set(get_args(StepDetectorName)) == {"shipped", *DETECTORS}
    field = GatewaySettings.model_fields["step_detector"]
    assert field.default == "shipped"
    assert field.annotation == StepDetectorName
