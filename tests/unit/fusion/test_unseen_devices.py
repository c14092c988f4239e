"""Which devices are told while no camera sees them, against a device at a time, and under which ids."""

import itertools
from collections.abc import Callable

import msgspec
import numpy as np
import pytest
from fusion_world import make_view

from services.fusion.area_view import AreaView
from services.fusion.evidence.identity import IdentityLayer
from services.fusion.evidence.unseen import NEAR, UnseenRows, with_rows
from shared.messages import TrackFrame

NOW = 100.0
INSIDE = np.array([12.0, 7.0])


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> AreaView:
    return make_view(tmp_path_factory.mktemp("site"))


def layer_of(view: AreaView, devices: int) -> IdentityLayer:
    """Devices that are known well and on no track; tracks 1 to 3 are seen."""
    layer = IdentityLayer(view)
    spots = np.array([[3.0, 3.0], [6.0, 6.0], [9.0, 9.0]])
    layer.columns.follow(NOW, np.array([1, 2, 3]), spots, np.zeros(3, np.bool_))
    layer._resize(8 * (1 + devices // 8), len(layer.columns.tracks))
    for number in range(devices):
        row = layer.row(f"phone-{number}")
        layer.told[row], layer.scans[row] = NOW - 0.5, 20
        layer.estimates[row] = (INSIDE, 0.5 * np.eye(2), 0.9)
    return layer


def fresh_ids() -> Callable[[], int]:
    return itertools.count(1000).__next__


def told(layer: IdentityLayer) -> list[str]:
    return [row.device for row in UnseenRows().rows(layer, {1, 2, 3}, fresh_ids())]


def test_the_batch_agrees_with_a_device_at_a_time(view: AreaView) -> None:
    layer, rng, s = layer_of(view, 60), np.random.default_rng(5), IdentityLayer(view).settings
    expected = []
    for row in layer.rows.tolist():
        root = rng.normal(0.0, 1.6, (2, 2))
        place = rng.uniform([-8.0, -8.0], [32.0, 22.0])
        probability = float(rng.uniform(0.3, 1.0))
        layer.estimates[row] = (place, root @ root.T, probability)
        near = view.everywhere.depth_at(place[None])[0] > -NEAR
        if near and np.linalg.norm(root, 2) <= s.largest_sigma and probability >= 0.5:
            expected.append(f"phone-{row}")
    assert 10 < len(expected) < 40
    assert told(layer) == expected


def test_who_is_on_a_track_silent_new_or_not_rated_yet_is_not_told(view: AreaView) -> None:
    layer = layer_of(view, 5)
    layer.given[0] = 1
    layer.told[1] = NOW - layer.settings.told - 0.1
    layer.scans[2] = layer.settings.claim_scans - 1
    del layer.estimates[3]
    assert told(layer) == ["phone-4"]


def test_a_fresh_id_stays_until_a_camera_sees_the_device_and_outlives_a_restart(view: AreaView) -> None:
    layer, rows, new = layer_of(view, 2), UnseenRows(), fresh_ids()
    ids = [row.track for row in rows.rows(layer, {1, 2, 3}, new)]
    assert ids == [1000, 1001]
    rows = UnseenRows.restored(msgspec.json.decode(msgspec.json.encode(rows.state())))
    assert [row.track for row in rows.rows(layer, {1, 2, 3}, new)] == ids
    layer.given[0] = 0
    assert [row.track for row in rows.rows(layer, {1, 2, 3}, new)] == ids[1:]
    layer.given[0] = -1
    rows.erase("phone-1")
    assert [row.track for row in rows.rows(layer, {1, 2, 3}, new)] == [1002, 1003]


def test_a_lost_tracks_id_is_gone_on_with(view: AreaView) -> None:
    layer = layer_of(view, 1)
    layer.chains[0] = [40, 41]
    (row,) = UnseenRows().rows(layer, {1, 2, 3}, fresh_ids())
    assert (row.track, row.former) == (41, [40])


def test_every_column_of_the_frame_grows_alike(view: AreaView) -> None:
    layer = layer_of(view, 2)
    frame = TrackFrame(t=NOW, area="hall", chunk=1, tracker="evidence")
    rows = UnseenRows().rows(layer, set(), fresh_ids())
    grown = with_rows(frame, rows, "ground")
    assert {len(getattr(grown, column)) for column in TrackFrame.columns()} == {2}
    assert grown.state == ["unseen", "unseen"]
    assert (grown.x[0], grown.y[0], grown.covariance[0]) == (12.0, 7.0, (0.5, 0.0, 0.5))
    assert with_rows(frame, [], "ground") is frame
