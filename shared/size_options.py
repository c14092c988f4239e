"""Which of a detector's options say how tall and wide people look: measured by cameras, tried and told by learning."""

from __future__ import annotations

__all__ = ["SIZE_OPTIONS"]

SIZE_OPTIONS = ("height_scale", "height_scale_right", "height_scale_down", "width_scale")
"""Held against what was configured: the first and last are factors, the others logarithms by which the first grows
towards the right and the lower edge of the picture."""
