"""When a step was taken: one protocol, the published detectors, and the one that ships."""
