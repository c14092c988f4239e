"""Phones that hear none of the site's access points are a problem of the site file, and one is told of it."""

from services.gateway.phones.heard_site import LEAST, WINDOW, HeardSite


def test_it_is_told_when_nearly_nobody_hears_the_site_and_over_when_they_do() -> None:
    heard = HeardSite()
    for second in range(LEAST):
        assert heard.problem(float(second)) is None
        heard.note(1, 0, 4, float(second))
    assert "unknown access points only" in str(heard.problem(20.0))
    for second in range(20, 30):
        heard.note(1, 3, 9, float(second))
    assert heard.problem(30.0) is None


def test_neighbours_networks_and_silence_are_no_problem() -> None:
    heard = HeardSite()
    for second in range(100):
        heard.note(1, 2, 30, float(second))
        heard.note(1, 0, 0, float(second))
    assert heard.problem(100.0) is None


def test_it_is_forgotten_after_a_minute() -> None:
    heard = HeardSite()
    heard.note(50, 0, 200, 0.0)
    assert heard.problem(1.0) is not None
    assert heard.problem(WINDOW + 1.0) is None
