"""A camera's pictures become positions on the floor: sources, detectors, projection, and the service."""

import os

# OpenCV and FFmpeg print addresses with their passwords when they do not answer; what matters is said by SourceError.
# They read these variables when they are loaded.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")
