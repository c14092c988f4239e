"""What a scenario can say about how cameras see: every figure with its unit and what is allowed."""

from __future__ import annotations

from pydantic import Field

from shared.site.site_file import Number, Part

__all__ = ["DetectionParameters"]


class DetectionParameters(Part):
    """How well one camera sees. The defaults do as the camera service's foreground detector does on a real clip
    (``atrium bench detector-twin``: PETS 2009, 15 to 45 m away, outdoors)."""

    detection_probability: Number = Field(
        0.96, gt=0, lt=1, description="of somebody near, moving and in full view, in one frame"
    )
    half_distance: Number = Field(60.0, gt=0, le=1000, description="metres at which this has fallen to the half")
    distance_width: Number = Field(8.0, gt=0, le=200, description="metres over which it falls (scale of a logistic)")
    least_visible: Number = Field(
        0.35, ge=0, lt=1, description="visible share of a body that is found every other time"
    )
    miss_time: Number = Field(2.0, ge=0, le=60, description="seconds that misses last: time constant")
    miss_lasting: Number = Field(
        0.95, ge=0, le=1, description="share of the misses' variance that lasts; the rest is white"
    )
    learning_rate: Number = Field(
        0.01,
        ge=0,
        le=10,
        description="share of the background renewed per second: still people fade, ghosts remain; 0: neither",
    )
    obstacle_height: Number = Field(1.2, ge=0, le=10, description="metres, of all obstacles of the site file")
    wall_height: Number = Field(3.0, ge=0, le=30, description="metres")
    merge_distance: Number = Field(
        0.5, ge=0, le=3, description="how near, in widths and heights of their boxes, two bodies become one detection"
    )
    merge_spread: Number = Field(0.15, ge=0, le=1, description="how far that distance wanders (standard deviation)")
    merge_time: Number = Field(1.5, ge=0, le=60, description="seconds: time constant of that wandering")
    split_rate: Number = Field(1.5, ge=0, le=60, description="how often a person falls into two detections, per minute")
    split_time: Number = Field(0.5, gt=0, le=60, description="seconds this lasts, mean")
    clutter: Number = Field(0.04, ge=0, le=20, description="false detections anywhere that last one frame, per frame")
    clutter_places: int = Field(4, ge=0, le=100, description="places where reflections or shadows come back")
    clutter_episodes: Number = Field(4.0, ge=0, le=600, description="how often one of them does, per minute")
    clutter_time: Number = Field(1.5, gt=0, le=600, description="seconds it lasts, mean")
    foot_noise: Number = Field(
        0.033,
        ge=0,
        le=1,
        description="standard deviation of the foot, share of the apparent height; grows with distance",
    )
    floor_noise: Number = Field(0.06, ge=0, le=2, description="standard deviation of the foot on the floor, metres")
    noise_time: Number = Field(1.0, ge=0, le=60, description="seconds that errors of position last: time constant")
    noise_lasting: Number = Field(0.85, ge=0, le=1, description="share of their variance that lasts; the rest is white")
    foot_bias: Number = Field(0.08, ge=-1, le=1, description="metres by which feet are seen too near to the camera")
