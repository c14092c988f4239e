"""Heat maps that tell nothing of the few, stays and ways against slow oracles, days that begin at local midnight."""

import datetime
from zoneinfo import ZoneInfo

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from services.history.analytics.heat_map import HeatMapSum, grid_of
from services.history.analytics.local_time import by_step, step_edges
from services.history.analytics.trajectory import one_way
from services.history.analytics.visits import Visits, VisitSum, dwell_of, flows_of, joined, lasting, told

SQUARES = [np.array([(x, 0.0), (x + 2.0, 0.0), (x + 2.0, 2.0), (x, 2.0)]) for x in (0.0, 4.0, 8.0)]
NOBODY = np.zeros(9, bool)
"""Carries a known phone."""
Moment = tuple[int, float, float]


def ints(values: list[int]) -> NDArray[np.int64]:
    return np.array(values, np.int64)


def test_a_cell_tells_nothing_unless_five_people_were_in_it() -> None:
    total = HeatMapSum((0.0, 0.0), 1.0, 2, 3)
    for person in range(5):
        total.add(ints([person] * 3), np.array([0.5, 0.6, 2.5]), np.array([0.5, 0.5, 1.5]), np.full(3, 2.0))
    total.add(ints([0, 0]), np.array([1.5, 9.0]), np.array([0.5, 9.0]), np.array([100.0, 1.0]))
    seconds, people = total.told(np.ones(5, bool), 5)
    assert people.tolist() == [[5, 0, 0], [0, 0, 5]]
    assert seconds.tolist() == [[20.0, 0, 0], [0, 0, 10.0]], "one person for long is still one person"
    _, people = total.told(np.zeros(5, bool), 5)
    assert not people.any(), "five tracks without a known phone may be one person"


def test_of_places_with_few_people_no_stay_is_told() -> None:
    place, person = ints([0] * 5 + [1] * 24 + [2] * 25), ints([*range(5), *range(24), *range(25)])
    known = np.arange(54) < 5
    stays = Visits(place, person, np.zeros(54), np.full(54, 9.0), known)
    assert set(told(stays, 3, 5).place.tolist()) == {0, 2}, "24 tracks may be four people"
    assert told(lasting(stays, 10.0), 3, 5).place.size == 0


def test_stays_of_several_days_are_of_other_people_and_short_ones_are_none() -> None:
    day = Visits(ints([0, 0, 1]), ints([0, 2, 2]), np.array([0.0, 0.0, 50.0]), np.array([20.0, 4.0, 90.0]), NOBODY[:3])
    both = joined([lasting(part, 5.0) for part in (day, stays([], 0.0, 1), day)])
    assert both.person.tolist() == [0, 2, 3, 5]
    assert both.place.tolist() == [0, 1, 0, 1]
    assert dwell_of(both, 0).people == 2
    assert joined([]).place.size == 0


def test_a_grid_covers_its_bounds() -> None:
    assert grid_of((1.0, 2.0, 4.1, 4.0), 1.0) == ((1.0, 2.0), 2, 4)


def stays(moments: list[Moment], away: float, parts: int) -> Visits:
    """Through ``VisitSum``, in so many parts of time."""
    total = VisitSum(SQUARES, away)
    moments = sorted(moments, key=lambda m: m[1])
    for part in np.array_split(np.arange(len(moments)), parts):
        chosen = [moments[place] for place in part]
        total.add(
            [0, 1, 2],
            ints([person for person, _, _ in chosen]),
            np.array([t for _, t, _ in chosen], float),
            np.array([x for _, _, x in chosen], float),
            np.ones(len(chosen)),
            np.ones(len(chosen)),
        )
    return total.visits(NOBODY)


def slow_stays(moments: list[Moment], away: float) -> list[tuple[int, int, float, float]]:
    found = []
    for place in range(3):
        for person in sorted({m[0] for m in moments}):
            inside = sorted(t for who, t, x in moments if who == person and 4 * place < x < 4 * place + 2)
            for t in inside:
                if found and found[-1][:2] == (place, person) and t - found[-1][3] <= away:
                    found[-1] = (*found[-1][:3], max(found[-1][3], t + 1.0))
                else:
                    found.append((place, person, t, t + 1.0))
    return found


moment = st.tuples(st.integers(0, 3), st.integers(0, 60).map(float), st.sampled_from([1.0, 3.0, 5.0, 9.0]))


@given(st.lists(moment, max_size=60, unique_by=lambda m: m[:2]), st.sampled_from([0.0, 3.0]), st.integers(1, 4))
def test_stays_are_those_of_a_slow_search_however_time_is_cut(moments: list[Moment], away: float, parts: int) -> None:
    found = stays(moments, away, parts)
    rows = list(zip(*(column.tolist() for column in (found.place, found.person, found.begin, found.end)), strict=True))
    assert rows == slow_stays(moments, away)


def test_dwell_counts_people_and_their_stays() -> None:
    visits = Visits(
        ints([0, 0, 0, 1]), ints([1, 1, 2, 1]), np.array([0.0, 100, 0, 50]), np.array([10.0, 130, 20, 60]), NOBODY[:4]
    )
    told = dwell_of(visits, 0)
    assert (told.people, told.visits, told.mean, told.median, told.p90) == (2, 3, 20.0, 20.0, 28.0)
    assert dwell_of(visits, 2).visits == 0


def test_flows_are_from_one_place_to_the_next_in_time() -> None:
    #        place, person, begin, end: person 1 goes 0, 1, 0 quickly; person 2 goes 0 and much later 1
    rows = [(0, 1, 0, 10), (1, 1, 20, 30), (0, 1, 40, 50), (0, 2, 0, 10), (1, 2, 5000, 5010)]
    place, person, begin, end = (np.array(column) for column in zip(*rows, strict=True))
    counts, people = flows_of(Visits(place, person, begin * 1.0, end * 1.0, np.ones(5, bool)), 3, 600.0)
    assert counts.tolist() == [[0, 1, 0], [1, 0, 0], [0, 0, 0]]
    assert people.tolist() == counts.tolist()
    assert not flows_of(Visits(place, person, begin * 1.0, end * 1.0, NOBODY[:5]), 3, 600.0)[1].any()
    assert flows_of(stays([], 0.0, 1), 2, 600.0)[0].tolist() == [[0, 0], [0, 0]]


@given(
    st.datetimes(datetime.datetime(2020, 1, 1), datetime.datetime(2030, 1, 1)),
    st.floats(60.0, 40 * 86400.0),
    st.sampled_from([300, 3600, 7200, 86400]),
    st.sampled_from(["UTC", "Europe/Rome", "America/St_Johns", "Australia/Lord_Howe"]),
)
def test_steps_cover_the_period_and_every_local_midnight_begins_one(
    begin: datetime.datetime, length: float, step: int, zone: str
) -> None:
    since = begin.replace(tzinfo=datetime.UTC).timestamp()
    edges = step_edges(since, since + length, step, zone)
    assert edges[0] <= since < edges[1]
    assert edges[-2] < since + length <= edges[-1]
    lasts = np.diff(edges)
    assert (lasts > 0).all()
    assert (lasts <= (90_000 if step == 86400 else step)).all()
    tz = ZoneInfo(zone)
    days = [datetime.datetime.fromtimestamp(t, tz) for t in edges[:-1]]
    assert all(t.hour == t.minute == 0 for t in days) if step == 86400 else True
    inner = [t for t in days[1:] if t.date() != (t - datetime.timedelta(seconds=1)).date()]
    assert all((t.hour, t.minute, t.second) == (0, 0, 0) for t in inner)


def test_the_days_on_which_clocks_change_are_one_step_each() -> None:
    rome = ZoneInfo("Europe/Rome")
    since = datetime.datetime(2026, 10, 24, tzinfo=rome).timestamp()
    edges = step_edges(since, since + 3 * 86400.0, 86400, "Europe/Rome")
    assert (np.diff(edges) / 3600.0).tolist() == [24.0, 25.0, 24.0]


def test_means_are_over_countings_and_what_was_not_counted_is_unknown() -> None:
    mean, most = by_step(
        np.array([0.0, 120.0, 240.0]), np.array([0.0, 60.0]), ints([1, 3]), ints([10, 6]), ints([10, 3])
    )
    assert mean[0] == 4.0
    assert np.isnan(mean[1])
    assert most.tolist() == [10, -1]


def test_where_two_areas_tell_of_a_moment_the_more_probable_counts() -> None:
    t, probability = np.array([2.0, 1.0, 2.0, 3.5]), np.array([0.4, 0.9, 0.8, 0.9])
    assert one_way(t, probability, 0.0).tolist() == [1, 2, 3]
    assert one_way(t, probability, 2.0).tolist() == [1, 2]


@pytest.mark.parametrize("corners", [[(0, 0), (2, 2), (2, 0), (0, 2)], [(0, 0), (1, 0), (2, 0)]])
def test_an_odd_polygon_breaks_nothing(corners: list[tuple[float, float]]) -> None:
    total = VisitSum([np.array(corners, float)], 0.0)
    total.add([0], ints([1]), np.zeros(1), np.array([1.9]), np.array([1.0]), np.ones(1))
    assert len(total.visits(NOBODY).place) <= 1
