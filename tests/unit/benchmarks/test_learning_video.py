"""Drawn video of the twin's people through the camera's own detector: as simulated detections, but from pictures."""

import numpy as np

from benchmarks.learning_video import rendered_again
from benchmarks.world_run import EPOCH, load


def test_people_are_found_in_drawn_pictures_and_other_options_find_others() -> None:
    scenario, site = load("construction-2")
    area = site.areas[0].id
    [usual, deaf] = rendered_again(
        scenario, site, 41, area, [{}, {"sensitivity": 200.0, "learning_rate": 3.0}], seconds=5.0, rate=2.0
    )
    assert set(usual) == {camera.id for camera in site.cameras_of(area)}
    for seen in (usual, deaf):
        for frames in seen.values():
            times = np.array([frame.t for _, frame in frames])
            assert times[0] == EPOCH
            assert np.allclose(np.diff(times), 0.5)
            assert all(arrival > frame.t for arrival, frame in frames)
    found, fewer = (sum(len(frame.x) for frames in seen.values() for _, frame in frames) for seen in (usual, deaf))
    assert found > 15
    assert fewer < 0.8 * found
