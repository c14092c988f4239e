"""Nothing still under way brings a withdrawn device back."""

from shared.erased import Erased
from shared.messages import Alert, TrackFrame


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
    assert "gone" in erased
    assert "here" not in erased


def test_frames_without_erased_devices_are_passed_on_as_they_are() -> None:
    erased = Erased()
    erased.add("somebody else")
    told = frame()
    assert erased.from_tracks(told) is told
