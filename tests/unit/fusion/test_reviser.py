"""What was said of a device's last seconds, told anew where its present explanation says otherwise."""

import msgspec
import numpy as np
import pytest
from fusion_world import make_view
from numpy.typing import NDArray

from services.fusion.area_view import AreaView
from services.fusion.evidence.belief import SLOTS, UNSEEN
from services.fusion.evidence.identity import SLOT, IdentityLayer
from services.fusion.evidence.revision import SEEN_VARIANCE, Reviser
from shared.messages import TrackFrame

FIRST, LAST = 500, 520
"""Slots told of; the present is in the last one."""
WRONG, RIGHT, BEFORE = 5, 6, 4
"""Tracks; the device was said to be on the first of them, and ``BEFORE`` is one that ended."""


@pytest.fixture(scope="module")
def view(tmp_path_factory: pytest.TempPathFactory) -> AreaView:
    return make_view(tmp_path_factory.mktemp("site"))


def place(track: int, slot: float) -> NDArray[np.float64]:
    """Each track walks east along a line of its own."""
    return np.array([2.0 + 0.3 * (slot - FIRST), float(track)])


def frame(slot: int, track: int | None) -> TrackFrame:
    """The phone is on a track; on none for None."""
    rows = [] if track is None else [track]
    count = len(rows)
    return TrackFrame(
        t=(slot + 0.5) * SLOT,
        area="hall",
        chunk=slot,
        tracker="evidence",
        track=rows,
        floor=["ground"] * count,
        x=[float(place(one, slot)[0]) for one in rows],
        y=[float(one) for one in rows],
        covariance=[(0.3, 0.0, 0.3)] * count,
        vx=[0.0] * count,
        vy=[0.0] * count,
        state=["confirmed"] * count,
        device=["phone"] * count,
        probability=[0.8] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[]] * count,
        sources=[[]] * count,
        quality=[1.0] * count,
    )


def layer_with(view: AreaView, lineage: dict[int, int]) -> IdentityLayer:
    """The phone is on ``RIGHT``, by slot it was on what ``lineage`` says."""
    layer = IdentityLayer(view)
    for slot in range(FIRST - 1, LAST + 1):
        ids = [WRONG, RIGHT] if slot > FIRST + 10 else [BEFORE, WRONG, RIGHT]
        places = np.array([place(one, slot + 0.5) for one in ids])
        layer._follow((slot + 0.5) * SLOT, np.array(ids), places, np.zeros(len(ids), np.bool_))
    row, column = layer.row("phone"), layer.columns.find(RIGHT)
    layer.given[row] = column
    layer.probability[row, column] = 0.9
    layer.beliefs.slot = LAST
    for slot, track in lineage.items():
        layer.beliefs.lineage[row, column, slot % SLOTS] = track
    return layer


def after(view: AreaView, said: dict[int, int | None]) -> Reviser:
    """What remembers what was said slot by slot, while nothing was known of the phone."""
    reviser, nobody = Reviser(), IdentityLayer(view)
    for slot in range(FIRST, LAST):
        t = (slot + 0.5) * SLOT
        nobody.columns.follow(t, np.zeros(0, np.int64), np.zeros((0, 2)), np.zeros(0, np.bool_))
        assert reviser.revise(slot, "evidence", frame(slot, said[slot]), nobody) is None
    return reviser


ALWAYS_RIGHT = dict.fromkeys(range(FIRST, LAST + 1), RIGHT)
NOW = frame(LAST, RIGHT)


def test_what_was_said_rightly_stands(view: AreaView) -> None:
    said: dict[int, int | None] = dict.fromkeys(range(FIRST, LAST), RIGHT)
    assert after(view, said).revise(LAST, "evidence", NOW, layer_with(view, ALWAYS_RIGHT)) is None


def test_a_wrong_track_is_replaced_from_where_it_was_wrong(view: AreaView) -> None:
    said: dict[int, int | None] = {slot: RIGHT if slot < FIRST + 12 else WRONG for slot in range(FIRST, LAST)}
    reviser, layer = after(view, said), layer_with(view, ALWAYS_RIGHT)
    revision = reviser.revise(LAST, "evidence", NOW, layer)
    assert revision is not None
    assert revision.device == ["phone"]
    assert revision.since == [pytest.approx((FIRST + 12) * SLOT)]
    assert revision.at == pytest.approx([slot * SLOT for slot in range(FIRST + 12, LAST)])
    assert set(revision.track) == {RIGHT}
    expected = np.array([place(RIGHT, slot) for slot in range(FIRST + 12, LAST)])
    assert np.column_stack([revision.x, revision.y]) == pytest.approx(expected, abs=1e-6)
    assert set(revision.covariance) == {(SEEN_VARIANCE, 0.0, SEEN_VARIANCE)}
    assert set(revision.probability) == {0.9}
    # Told once: it is what was said now.
    assert reviser.revise(LAST, "evidence", NOW, layer) is None


def test_a_gap_between_two_tracks_is_bridged_with_doubt_that_grows_inwards(view: AreaView) -> None:
    first, last = FIRST + 8, FIRST + 13
    lineage = {slot: BEFORE if slot < first else UNSEEN if slot <= last else RIGHT for slot in range(FIRST, LAST + 1)}
    said: dict[int, int | None] = dict.fromkeys(range(FIRST, LAST))
    revision = after(view, said).revise(LAST, "evidence", NOW, layer_with(view, lineage))
    assert revision is not None
    by_slot = {round(at / SLOT): index for index, at in enumerate(revision.at)}
    assert [revision.track[by_slot[slot]] for slot in range(FIRST, LAST)] == [
        lineage[slot] for slot in range(FIRST, LAST)
    ]
    start, end = place(BEFORE, first - 1), place(RIGHT, last + 1)
    for slot in range(first, last + 1):
        share = (slot - first + 1) / (last - first + 2)
        index = by_slot[slot]
        assert (revision.x[index], revision.y[index]) == pytest.approx(tuple(start + share * (end - start)), abs=1e-6)
    doubt = [revision.covariance[by_slot[slot]][0] for slot in range(first - 1, last + 2)]
    assert doubt == pytest.approx(doubt[::-1])
    assert max(doubt) == doubt[3] > doubt[1] > doubt[0] == SEEN_VARIANCE


def test_who_was_nowhere_after_all_is_told_without_points(view: AreaView) -> None:
    """Said to be on a track, but unseen as it turns out: nothing is known of those moments."""
    lineage = {slot: UNSEEN if slot < LAST else RIGHT for slot in range(FIRST, LAST + 1)}
    said: dict[int, int | None] = {slot: WRONG if slot >= LAST - 4 else None for slot in range(FIRST, LAST)}
    revision = after(view, said).revise(LAST, "evidence", NOW, layer_with(view, lineage))
    assert revision is not None
    assert revision.since == [pytest.approx((LAST - 4) * SLOT)]
    assert revision.of == []


def test_a_restart_changes_nothing_and_who_withdrew_is_forgotten(view: AreaView) -> None:
    said: dict[int, int | None] = dict.fromkeys(range(FIRST, LAST), WRONG)
    reviser, layer = after(view, said), layer_with(view, ALWAYS_RIGHT)
    again = Reviser.restored(msgspec.json.decode(msgspec.json.encode(reviser.state())))
    erased = Reviser.restored(msgspec.json.decode(msgspec.json.encode(reviser.state())))
    erased.erase("phone")
    assert b"phone" not in msgspec.json.encode(erased.state())
    revision = reviser.revise(LAST, "evidence", NOW, layer)
    assert revision is not None
    assert again.revise(LAST, "evidence", NOW, layer) == revision
    assert again.state() == reviser.state()
