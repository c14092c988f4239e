"""Two distributions that both own ``cv2`` overwrite each other's files; OpenCV 5 lacks the detectors we may want."""

import importlib.metadata

import cv2


def test_exactly_one_installed_distribution_owns_cv2() -> None:
    owners = set(importlib.metadata.packages_distributions()["cv2"])
    assert owners == {"opencv-python-headless"}
    files = importlib.metadata.files("opencv-python-headless") or []
    assert any(str(file) == "cv2/__init__.py" for file in files)


def test_cv2_is_version_4_with_the_hog_people_detector() -> None:
    assert importlib.metadata.version("opencv-python-headless").split(".")[0] == "4"
    assert cv2.__version__.split(".")[0] == "4"
    assert cv2.HOGDescriptor().getDescriptorSize() > 0
