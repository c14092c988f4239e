"""A way and what a phone said meanwhile make a stretch; of others the nearest are told, and when they were about."""

import numpy as np

from services.learning.tracks.along import along
from services.learning.tracks.crowd import Crowd, others_of
from services.learning.tracks.phones import PhoneRows


def test_only_what_was_said_on_the_way_is_taken_and_placed() -> None:
    phone = PhoneRows(
        readings=[(t, 1, -60.0 - t) for t in (0.0, 1.0, 2.0, 3.0, 4.0)],
        steps=[(1.5, 0.7, 0.01, 0.1, 0.02, 3, 48.0), (9.0, 0.7, 0.01, 0.1, 0.02, 4, 48.0)],
        still=[(2.0, 3.0), (7.0, 8.0)],
    )
    t = np.array([1.0, 2.0, 3.0])
    place = np.column_stack([t, 2.0 * t])
    found = along("d", phone, 7, t, place, np.tile(0.04 * np.eye(2), (3, 1, 1)), np.full(3, 0.9))
    np.testing.assert_array_equal(found.scan_t, t)
    np.testing.assert_array_equal(found.scan_place, place)
    np.testing.assert_allclose(found.scan_spread, 0.2)
    assert found.level.tolist() == [-61.0, -62.0, -63.0]
    assert found.walk.tolist() == [3]
    assert found.magnetic.tolist() == [48.0]
    assert found.still.tolist() == [[2.0, 3.0]]
    assert found.seen.all()
    silent = along("d", PhoneRows(), 7, t, place, np.zeros((3, 2, 2)), np.zeros(3))
    assert silent.scan_place.shape == (0, 2)
    assert silent.still.shape == (0, 2)


def test_of_the_others_the_nearest_are_told_once_a_second_and_where_they_were_about() -> None:
    ids, line = np.arange(100), np.repeat(np.arange(100.0)[:, None], 2, axis=1)
    about = [slice(99 if half > 4 else 100) for half in range(21)]
    crowds = [Crowd(0.5 * half, ids[who], line[who] + half) for half, who in enumerate(about)]
    t = np.arange(1.0, 5.0, 0.5)
    others, times, places = others_of(crowds, 99, t, np.full((len(t), 2), 99.0))
    assert others.tolist() == list(range(35, 99))  # itself left out
    assert times.tolist() == [1.0, 2.0, 3.0, 4.0]
    np.testing.assert_array_equal(places[-1, :, 0], 98.0 + 2.0 * times)
    near, _, gone = others_of(crowds, 98, t, np.full((len(t), 2), 98.0))
    assert near[-1] == 99
    assert np.isfinite(gone[-1, :, 0]).tolist() == [True, True, False, False]
    assert [len(column) for column in others_of(crowds, 98, t + 100.0, np.zeros((len(t), 2)))] == [0, 0, 0]
    assert crowds[-1].row_of(98) == 98
    assert crowds[-1].row_of(99) is None
