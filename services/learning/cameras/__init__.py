"""What tracks teach cameras: how to detect, and where they look."""
