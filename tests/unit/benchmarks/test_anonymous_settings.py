"""The experiment on the anonymous tracker's defaults tries all of them, and large errors are not taken for none."""

from dataclasses import fields

import numpy as np
import pytest
from msgspec.structs import replace
from track_frames import frame

from benchmarks.anonymous_settings import ALTERNATIVES, honest
from benchmarks.world_record import Truth
from services.fusion.positions.settings import AnonymousSettings
from shared.messages import TrackFrame

T = 1000.0 + np.arange(4.0)


def told(places: dict[int, tuple[float, float]]) -> list[TrackFrame]:
    """Return frames whose rows claim 0.2 m along each axis."""
    return [replace(frame(t, places), covariance=[(0.04, 0.0, 0.04)] * len(places)) for t in T.tolist()]


def people(*x: float) -> Truth:
    position = np.broadcast_to(np.array([[place, 0.0] for place in x]), (len(T), len(x), 2)).copy()
    return Truth(T, [f"p{n}" for n in range(len(x))], [None] * len(x), position, np.ones((len(T), len(x)), np.bool_))


def test_every_setting_is_tried() -> None:
    assert set(ALTERNATIVES) == {setting.name for setting in fields(AnonymousSettings)}
    default = AnonymousSettings()
    assert not [name for name, values in ALTERNATIVES.items() if getattr(default, name) in values]


@pytest.mark.parametrize(("x", "within", "nobody"), [(0.3, 1.0, 0.0), (2.0, 0.5, 0.0), (9.0, 1.0, 0.5)])
def test_a_track_far_off_its_person_is_outside_and_farther_off_of_nobody(
    x: float, within: float, nobody: float
) -> None:
    assert honest(people(0.0, 20.0), told({1: (x, 0.0), 2: (20.1, 0.0)})) == (within, nobody)


def test_two_tracks_do_not_share_a_person() -> None:
    # The second track is nearest to the first one's person; its own stands two metres away.
    assert honest(people(0.0, 2.5), told({1: (0.0, 0.0), 2: (0.5, 0.0)})) == (0.5, 0.0)
