"""Track frames by hand, for the tests of the metrics."""

from collections.abc import Mapping

from shared.messages import TrackFrame

__all__ = ["frame"]


def frame(t: float, places: Mapping[int, tuple[float, float]], names: Mapping[int, str] | None = None) -> TrackFrame:
    """Tracks by id with their positions; ``names`` gives some of them devices."""
    names = names or {}
    n = len(places)
    return TrackFrame(
        t=t, area="a", chunk=0, tracker="t", track=list(places), floor=["g"] * n,
        x=[x for x, _ in places.values()], y=[y for _, y in places.values()],
        covariance=[(1.0, 0.0, 1.0)] * n, vx=[0.0] * n, vy=[0.0] * n, state=["confirmed"] * n,
        device=[names.get(track) for track in places], probability=[1.0 / (1 + track) for track in places],
        runner_up=[None] * n, runner_up_probability=[0.0] * n, former=[[]] * n, sources=[[]] * n, quality=[1.0] * n,
    )  # fmt: skip
