"""A camera's pictures become positions on the floor: sources, detectors, projection, and the service."""
