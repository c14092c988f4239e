"""Apps and receivers people already have: one file turns the payload of each into ours."""
