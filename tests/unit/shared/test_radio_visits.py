"""What all readings of a visit share is found where visits to one spot disagree, and no number of readings hides it."""

import numpy as np
import pytest
from numpy.typing import NDArray

from shared.radio import visit_variance

Array = NDArray[np.float64]
Index = NDArray[np.int64]
SPOTS, VISITS, READINGS = 40, 6, 25


def readings(common: float, seed: int = 1) -> tuple[Index, Index, Array, Array]:
    """Spot, visit, residual and weight of readings with 2.5 dB of their own and ``common`` dB shared by a visit."""
    rng = np.random.default_rng(seed)
    visit = np.repeat(np.arange(SPOTS * VISITS), READINGS)
    spot = visit // VISITS
    level = rng.normal(0.0, 6.0, SPOTS)[spot] + rng.normal(0.0, common, SPOTS * VISITS)[visit]
    return spot, visit, level + rng.normal(0.0, 2.5, len(visit)), np.full(len(visit), 2.5**-2)


@pytest.mark.parametrize("common", [0.0, 2.0, 4.0])
def test_how_much_visits_share_is_found_whatever_the_spots_are_like(common: float) -> None:
    assert visit_variance(*readings(common)) ** 0.5 == pytest.approx(common, abs=0.4)


def test_where_every_spot_was_visited_once_nothing_can_be_told() -> None:
    _, visit, residual, weight = readings(4.0)
    assert visit_variance(visit, visit, residual, weight) == 0.0
    nothing = np.zeros(0, np.int64)
    assert visit_variance(nothing, nothing, np.zeros(0), np.zeros(0)) == 0.0
