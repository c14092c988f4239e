"""What was measured of people's sizes, as an operator reads it."""

import pytest

from services.learning.cameras.size_words import differ, size_words


@pytest.mark.parametrize(
    ("sizes", "words"),
    [
        ({"height_scale": 0.94}, "people look 6 % smaller than the camera is configured for"),
        (
            {"height_scale": 0.94, "height_scale_down": 0.05},
            "people look 6 % smaller than the camera is configured for, "
            "most so at the upper edge of its picture (11 % smaller)",
        ),
        (
            {"height_scale": 1.1, "height_scale_right": 0.1, "width_scale": 0.8},
            "people look 10 % taller than the camera is configured for, "
            "most so at the right edge of its picture (22 % taller), and 20 % narrower",
        ),
        ({}, "people look as tall as the camera is configured for"),
        ({"width_scale": 1.2}, "people look as tall as the camera is configured for, and 20 % wider"),
    ],
)
def test_sizes_are_told_in_plain_words(sizes: dict[str, float], words: str) -> None:
    assert size_words(sizes) == words


def test_a_percent_is_no_difference() -> None:
    active = {"height_scale": 0.95, "width_scale": 1.0}
    assert not differ({"height_scale": 0.955, "width_scale": 1.0}, active)
    assert differ({"height_scale": 0.955, "width_scale": 0.9}, active)
    assert not differ({}, active)
