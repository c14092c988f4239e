"""Nothing still under way brings a withdrawn device back."""

import msgspec

from shared.erased import Erased
from shared.messages import Alert, Revision, TrackFrame


def frame() -> TrackFrame:
    return TrackFrame(
        t=1.0,
        area="hall",
        chunk=1,
        tracker="x",
        track=[1, 2],
        floor=["f", "f"],
        x=[0.0, 1.0],
        y=[0.0, 1.0],
        covariance=[(0.1, 0.0, 0.1)] * 2,
        vx=[0.0, 0.0],
        vy=[0.0, 0.0],
        state=["confirmed", "confirmed"],
        device=["gone", "here"],
        probability=[0.9, 0.8],
        runner_up=[None, "gone"],
        runner_up_probability=[0.0, 0.1],
        former=[[], []],
        sources=[["cam", "gone"], ["cam", "here"]],
        quality=[1.0, 1.0],
    )


def test_frames_and_alerts_lose_the_erased_device_and_nothing_else() -> None:
    erased = Erased()
    assert erased.from_tracks(frame()) is not None
    erased.add("gone")
    shown = erased.from_tracks(frame())
    assert shown.device == [None, "here"]
    assert shown.probability == [0.0, 0.8]
    assert shown.runner_up == [None, None]
    assert shown.sources == [["cam"], ["cam", "here"]]
    assert shown.x == frame().x
    alert = Alert(t=1.0, id="a", zone="z", kind="enter", area="hall", track=1, floor="f", x=0.0, y=0.0, device="gone")
    assert erased.from_alert(alert).device is None
    near = Alert(t=1.0, id="b", zone="z", kind="proximity", area="hall", track=1, floor="f", x=0.0, y=0.0,
                 device="here", other_track=2, other_device="gone")  # fmt: skip
    assert (erased.from_alert(near).device, erased.from_alert(near).other_device) == ("here", None)
    assert "gone" in erased
    assert "here" not in erased


def test_frames_without_erased_devices_are_passed_on_as_they_are() -> None:
    erased = Erased()
    erased.add("somebody else")
    told = frame()
    assert erased.from_tracks(told) is told


def test_who_is_followed_by_an_erased_device_alone_is_gone_with_it() -> None:
    erased = Erased()
    erased.add("gone")
    shown = erased.from_tracks(msgspec.structs.replace(frame(), state=["unseen", "confirmed"]))
    assert shown.track == [2]
    assert shown.device == ["here"]


def test_a_revision_says_nothing_of_an_erased_device() -> None:
    erased = Erased()
    said = Revision(
        t=9.0,
        area="hall",
        chunk=1,
        tracker="x",
        device=["gone", "here"],
        since=[4.0, 5.0],
        of=[0, 1, 1],
        at=[4.0, 5.0, 6.0],
        track=[1, 2, 2],
        x=[0.0, 1.0, 2.0],
        y=[0.0, 1.0, 2.0],
        covariance=[(0.1, 0.0, 0.1)] * 3,
        probability=[0.7, 0.8, 0.9],
    )
    assert erased.from_revision(said) is said
    erased.add("gone")
    left = erased.from_revision(said)
    assert (left.device, left.since, left.of, left.at) == (["here"], [5.0], [0, 0], [5.0, 6.0])


def test_an_erased_device_that_only_fed_a_track_is_gone_from_it() -> None:
    erased = Erased()
    erased.add("gone")
    fed = msgspec.structs.replace(frame(), device=[None, "here"], probability=[0.0, 0.8], runner_up=[None, None])
    assert erased.from_tracks(fed).sources == [["cam"], ["cam", "here"]]
