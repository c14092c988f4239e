"""What tracks teach cameras: how their detectors should be set."""
