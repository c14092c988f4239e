"""The learning page in words: what is odd is said first, and nothing from elsewhere is HTML."""

from html.parser import HTMLParser

import pytest

from services.dashboard import learning_words as words
from services.dashboard.learning_charts import path_loss_chart, score_chart, stride_chart
from shared.learning_report import (
    AccessPointFit,
    AccuracyReport,
    Activation,
    AreaLessons,
    CameraLessons,
    DeviceLessons,
    LearningReport,
    TrackLessons,
)

HOSTILE = "<img src=x onerror=alert(1)>\"'&"


def fit(name: str = "ap-1", **more: object) -> AccessPointFit:
    return AccessPointFit(access_point=name, power_1m=-40.0, path_loss_exponent=2.0, **more)  # type: ignore[arg-type]


def report(text: str) -> LearningReport:
    area = AreaLessons(
        area=text, version=2, words=text, access_points=[fit(text, state="changed", words=text)],
        accuracy=AccuracyReport(rms=1.0, p50=0.5, p90=2.0, named=0.9, right=0.8, seconds=90.0),
    )  # fmt: skip
    camera = CameraLessons(camera=text, area=text, options={text: 1.0}, alignment="knocked", words=text)
    decision = Activation(
        t=0.0, kind="radio", subject=text, version=1, decision="refused", reason=text, evidence={text: 1.0}
    )
    return LearningReport(
        t=0.0, areas=[area], cameras=[camera], devices=[DeviceLessons(device=text)], history=[decision]
    )


def everything(told: LearningReport) -> str:
    tables = [words.access_points_table(area) for area in told.areas]
    parts = [words.summary(told), words.accuracy_table(told.areas), words.cameras_table(told.cameras)]
    return "".join([*parts, *tables, words.devices_table(told.devices), words.history_table(told.history)])


def test_nothing_that_comes_from_elsewhere_becomes_part_of_the_page() -> None:
    tags = set()

    class Reader(HTMLParser):
        def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
            tags.add(tag)
            assert not [name for name, _ in attrs if name.startswith("on")]

    Reader().feed(everything(report(HOSTILE)))
    assert tags <= {
        "ul",
        "li",
        "strong",
        "span",
        "b",
        "em",
        "p",
        "br",
        "time",
        "table",
        "thead",
        "tbody",
        "tr",
        "th",
        "td",
    }


def test_it_tells_how_many_walks_teach_and_what_is_done_with_a_camera() -> None:
    tracks = TrackLessons(good=3, refused={"too short to judge": 4, "radio disagrees": 9})
    camera = CameraLessons(camera="door", area="hall", words="other detector options are being tried")
    area = AreaLessons(area="hall", words="learns", tracks=tracks)
    told = words.summary(LearningReport(t=0.0, areas=[area], cameras=[camera]))
    assert "3 of the last 16 walks teach; the others do not: radio disagrees (9), too short to judge (4)" in told
    assert "<strong>Camera door:</strong> other detector options are being tried" in told
    assert "unknown" not in told
    assert "walks" not in words.summary(LearningReport(t=0.0, areas=[AreaLessons(area="hall", words="waits")]))


def test_before_anything_is_learned_every_part_says_so() -> None:
    told = everything(LearningReport(t=0.0))
    assert "nobody with a phone has walked yet" in told
    assert "Nothing was decided yet" in told
    assert "Not known yet" in told
    assert "None" not in told
    assert "None" not in everything(report("hall"))
    fresh = LearningReport(t=0.0, areas=[AreaLessons(area="east", words="waiting for somebody to walk")])
    assert "waiting for somebody to walk" in words.summary(fresh)


def test_what_is_odd_is_said_first_and_frozen_above_all() -> None:
    area = AreaLessons(
        area="east",
        access_points=[fit("ap-1", state="fine"), fit("ap-2", state="silent", words="not heard for an hour")],
    )
    told = words.summary(LearningReport(t=0.0, frozen=True, areas=[area]))
    assert told.index("Frozen by hand") < told.index("Area east") < told.index("not heard for an hour")
    assert "ap-1" not in told


def test_an_access_point_nobody_has_placed_says_what_it_waits_for_and_is_no_line_of_the_chart() -> None:
    waiting = fit("ap-1", state="not placed", words="access point ap-1 is not placed yet: 12 readings of 40 needed")
    found = fit("ap-2", state="fine", words="found", position=(3.0, 4.0, 2.5), position_error=1.2)
    area = AreaLessons(area="east", access_points=[waiting, found])
    assert "12 readings of 40 needed" in words.summary(LearningReport(t=0.0, areas=[area]))
    table = words.access_points_table(area)
    assert "not placed" in table
    assert "Heard from (3.0, 4.0) to within 1.2 m." in table
    assert [line["name"] for line in path_loss_chart(area.access_points)["series"]] == ["ap-2"]


@pytest.mark.parametrize("bias", [None, -400.0, 0.0, 30.0])
def test_a_residual_is_drawn_within_its_bar(bias: float | None) -> None:
    told = words.access_points_table(AreaLessons(area="east", access_points=[fit(bias=bias, sigma=3.0)]))
    assert ("–" in told) if bias is None else ('class="residual"' in told and 'x="-' not in told)


def test_charts_hold_a_line_each_and_are_no_longer_than_a_screen_is_wide() -> None:
    camera = CameraLessons(camera="c", area="a", score_t=[60.0 * n for n in range(5000)], score=[1.0] * 5000)
    assert len(score_chart([camera])["series"][0]["data"]) <= 240
    lines = path_loss_chart([fit("ap-1"), fit("ap-2")])["series"]
    assert [(line["name"], line["data"][0]) for line in lines] == [("ap-1", [1.0, -40.0]), ("ap-2", [1.0, -40.0])]
    assert lines[0]["symbol"] != lines[1]["symbol"]
    devices = [DeviceLessons(device="d-0011223344", slope=0.3, offset=0.1, used=True), DeviceLessons(device="d-2")]
    assert [line["name"] for line in stride_chart(devices)["series"]] == ["usual", "Phone 3344"]
