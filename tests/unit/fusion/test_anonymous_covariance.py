"""Is a track as far off as its covariance says? Against the truth of a world whose detectors err for seconds on end."""

import math
from pathlib import Path

import numpy as np
import pytest
from fusion_world import World, make_site
from msgspec.structs import replace
from scipy.stats import chi2

from services.fusion.area_view import AreaView
from services.fusion.positions.anonymous import AnonymousLayer


@pytest.mark.parametrize(
    ("cameras", "rate"), [(("west",), 2.0), (("west",), 7.0), (("west",), 30.0), (("west", "east"), 7.0)]
)
def test_normalised_estimation_error_lies_within_its_chi_square_bounds(
    tmp_path: Path, cameras: tuple[str, ...], rate: float
) -> None:
    """Errors as real detectors make them: three fifths of the variance lasts for a second. Runs are independent."""
    sigma, lasting, runs = 0.2, 0.6, 8
    site = make_site(tmp_path)
    errors = []
    for seed in range(runs):
        world = World(site, seed=seed, people=4, seconds=12.0, rate=rate, cameras=cameras)
        layer = AnonymousLayer(AreaView.of(site, "hall"))
        rng = np.random.default_rng(seed)
        keep = math.exp(-1.0 / rate)
        drift = {camera: rng.normal(0.0, 1.0, (world.people, 2)) for camera in cameras}
        for frame in world.frames():
            noise = rng.normal(0.0, 1.0, (2, world.people, 2))
            drift[frame.camera] = keep * drift[frame.camera] + math.sqrt(1.0 - keep**2) * noise[0]
            off = sigma * (math.sqrt(lasting) * drift[frame.camera] + math.sqrt(1.0 - lasting) * noise[1])
            places = world.places(frame.t) + off
            columns = {"x": places[:, 0].tolist(), "y": places[:, 1].tolist()}
            kept = {name: (getattr(frame, name) * world.people)[: world.people] for name in ("confidence", "box")}
            layer.observe(replace(frame, covariance=[(sigma**2, 0.0, sigma**2)] * world.people, **columns, **kept))
        apart = world.places(layer.t)[:, None] - layer.tracks.mean[None, :, :2]
        nearest = np.hypot(*np.moveaxis(apart, 2, 0)).argmin(axis=1)
        off = apart[np.arange(world.people), nearest]
        spread = layer.tracks.spread()[nearest]
        errors.append(np.einsum("ni,nij,nj->n", off, np.linalg.inv(spread), off))
    total, degrees = float(np.sum(errors)), 2 * np.size(errors)
    # A quarter is forgiven; half or twice the true variance would fall outside.
    assert chi2.ppf(0.001, degrees) < total * 1.25
    assert total / 1.25 < chi2.ppf(0.999, degrees)
