"""What would a detector publish? Detections of cameras that have no pictures."""
