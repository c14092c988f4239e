"""A phone sees its own position and no other."""

import pytest

from services.gateway.devices.own_position import OwnPositions
from shared.messages import TrackFrame
from shared.site import Zone
from shared.zones import ZoneDefinition


def frame(t: float, devices: list[str | None]) -> TrackFrame:
    count = len(devices)
    return TrackFrame(
        t=t,
        area="hall",
        chunk=1,
        tracker="test",
        track=list(range(count)),
        floor=["ground"] * count,
        x=[float(i) for i in range(count)],
        y=[2.0] * count,
        covariance=[(0.1, 0.0, 0.2)] * count,
        vx=[0.0] * count,
        vy=[0.0] * count,
        state=["confirmed"] * count,
        device=devices,
        probability=[0.9] * count,
        runner_up=[None] * count,
        runner_up_probability=[0.0] * count,
        former=[[]] * count,
        sources=[[]] * count,
        quality=[1.0] * count,
    )


def test_the_newest_track_that_carries_the_device_counts() -> None:
    positions = OwnPositions([], kept=60.0)
    positions.take(frame(100.0, [None, "d-1", "d-2"]), 0.0)
    positions.take(frame(101.0, ["d-2", None, None]), 1.0)
    first, second = positions.of("d-1", 103.0), positions.of("d-2", 103.0)
    assert first is not None
    assert (first.x, first.t, first.age) == (1.0, 100.0, pytest.approx(3.0))
    assert second is not None
    assert (second.x, second.floor, second.covariance, second.probability) == (0.0, "ground", (0.1, 0.0, 0.2), 0.9)


def test_nobody_is_found_who_was_not_seen_was_long_ago_or_has_left() -> None:
    positions = OwnPositions([], kept=60.0)
    assert positions.of("d-1", 0.0) is None
    positions.take(frame(100.0, ["d-1", "d-2"]), 0.0)
    positions.forget("d-2")
    assert positions.of("d-2", 100.0) is None
    positions.forget_old(61.0)
    assert positions.of("d-1", 100.0) is None


def test_a_position_names_the_zones_of_its_floor_that_hold_it() -> None:
    square = [(0.0, 0.0), (1.0, 0.0), (1.0, 4.0), (0.0, 4.0)]
    zones = [
        Zone(id="left", name="On the left", floor="ground", polygon=square),
        Zone(id="upstairs", floor="first", polygon=square),
        Zone(id="all", floor="ground", polygon=[(-9.0, -9.0), (9.0, -9.0), (9.0, 9.0), (-9.0, 9.0)]),
    ]
    positions = OwnPositions(zones, kept=60.0)
    positions.take(frame(100.0, ["d-0", "d-1", "d-2"]), 0.0)

    def names(device: str) -> list[tuple[str, str]]:
        position = positions.of(device, 100.0)
        assert position is not None
        return [(zone.id, zone.name) for zone in position.zones]

    assert names("d-0") == [("left", "On the left"), ("all", "all")]
    assert names("d-1") == [("left", "On the left"), ("all", "all")]  # the border belongs to it
    assert names("d-2") == [("all", "all")]
    line = ZoneDefinition(id="door", floor="ground", shape="line", points=[(0.0, 0.0), (0.0, 4.0)])
    positions.draw([ZoneDefinition(id="drawn", name="As drawn", floor="ground", points=square), line])
    assert names("d-0") == [("drawn", "As drawn")], "staff drew others in place of the site file's"
    assert names("d-2") == []
