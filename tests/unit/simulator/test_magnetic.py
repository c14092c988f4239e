"""The field that bends compasses: by place, alike for everybody, as strong and as wide as it says."""

import math

import numpy as np
import pytest

from services.simulator.phones.magnetic import MagneticField, MagneticParameters
from shared.site import Site


def hall(size: float = 40.0, north: float = 90.0) -> Site:
    outline = [(0.0, 0.0), (size, 0.0), (size, size), (0.0, size)]
    return Site.model_validate(
        {
            "format": "atrium-site/1",
            "site": "hall",
            "north": north,
            "floors": [{"id": "ground", "outline": outline}, {"id": "first", "level": 1, "outline": outline}],
            "areas": [{"id": "all", "floor": "ground"}],
        }
    )


class Disturbance:
    """What bends, without what is bent."""

    def __init__(self, seed: int = 1, **parameters: float) -> None:
        chosen = MagneticParameters(building_sigma=0.0, **parameters)
        self._field = MagneticField(hall(), chosen, seed)

    def at(self, points: np.ndarray) -> np.ndarray:
        return self._field.at(points, "ground") - self._field.earth


def grid(low: float, high: float, spacing: float) -> np.ndarray:
    x, y = np.meshgrid(np.arange(low, high, spacing), np.arange(low, high, spacing))
    return np.column_stack([x.ravel(), y.ravel()])


@pytest.mark.parametrize("north", [90.0, 0.0, 37.0])
def test_without_disturbance_the_needle_points_north_and_down(north: float) -> None:
    still = MagneticParameters(building_sigma=0, open_sigma=0, wall_sigma=0, strength=50.0, dip=60.0)
    x, y, up = MagneticField(hall(north=north), still, 1).at(np.array([[5.0, 5.0]]), "ground")[0]
    assert math.degrees(math.atan2(y, x)) == pytest.approx(north)
    assert (math.hypot(x, y), up) == (pytest.approx(25.0), pytest.approx(-50.0 * math.sin(math.radians(60))))


def test_iron_bends_the_field_at_walls_more_than_in_the_open() -> None:
    along_wall = np.column_stack([np.full(200, 0.1), np.linspace(1, 39, 200)])
    middle = grid(10, 30, 0.5)
    fields = [Disturbance(seed) for seed in range(12)]
    stds = [(field.at(along_wall).std(), field.at(middle).std()) for field in fields]
    at_wall, inside = np.sqrt((np.array(stds) ** 2).mean(axis=0))
    chosen = MagneticParameters()
    wall = math.hypot(chosen.open_sigma, chosen.wall_sigma * math.exp(-0.1 / chosen.wall_reach))
    assert at_wall == pytest.approx(wall, rel=0.15)
    assert inside == pytest.approx(chosen.open_sigma, rel=0.15)


def test_headings_err_by_ten_to_thirty_degrees_in_places() -> None:
    field = MagneticField(hall(), MagneticParameters(), 3)
    north = math.pi / 2
    values = field.at(grid(0.2, 39.8, 0.2), "ground")
    error = np.degrees(np.abs(np.angle(np.exp(1j * (np.arctan2(values[:, 1], values[:, 0]) - north)))))
    near = error.reshape(198, 198)[:3].ravel()
    assert 10 < np.percentile(near, 75) < 40
    assert np.median(error) < 10


@pytest.mark.parametrize("length", [1.0, 2.0, 4.0])
def test_the_correlation_falls_as_it_says(length: float) -> None:
    """Gaussian: exp(-1/2) at one length, exp(-2) at two."""
    sums = np.zeros(3)
    points = grid(1, 31, 0.5)
    for seed in range(int(4 * length)):
        field = Disturbance(seed, length=length, wall_sigma=0.0)
        here = field.at(points)
        for place, lag in enumerate((0.0, length, 2.0 * length)):
            sums[place] += (here * field.at(points + np.array([lag, 0.0]))).mean()
    assert sums[1] / sums[0] == pytest.approx(math.exp(-0.5), abs=0.08)
    assert sums[2] / sums[0] == pytest.approx(math.exp(-2.0), abs=0.08)


def test_the_same_place_bends_everybody_alike_and_floors_and_seeds_differ() -> None:
    points = grid(1, 39, 3.0)
    first, again, other = (MagneticField(hall(), MagneticParameters(), seed) for seed in (1, 1, 2))
    assert first.at(points, "ground").tobytes() == again.at(points, "ground").tobytes()
    assert np.abs(first.at(points, "ground") - other.at(points, "ground")).max() > 1.0
    assert np.abs(first.at(points, "ground") - first.at(points, "first")).max() > 1.0


def test_the_field_has_no_edge_a_step_could_fall_over() -> None:
    path = np.column_stack([np.linspace(-6.0, 46.0, 5201), np.full(5201, 7.03)])
    steps = np.linalg.norm(np.diff(Disturbance().at(path), axis=0), axis=1)  # 1 cm apart
    assert steps.max() < 0.8
    assert np.isfinite(steps).all()


def test_a_floor_that_does_not_exist_is_named() -> None:
    with pytest.raises(KeyError, match="cellar"):
        MagneticField(hall(), MagneticParameters(), 1).at(np.zeros((1, 2)), "cellar")
