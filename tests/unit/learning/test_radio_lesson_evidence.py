"""What is kept of visits is bounded, the newest of each spot stay, and nobody who is gone keeps a number."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_site
from radio_stretches import T0, hall_of

from services.learning.radio import evidence as module
from services.learning.radio.evidence import RadioEvidence
from shared.radio import RadioPrior


def test_weeks_of_visitors_stay_within_bounds_and_the_newest_visits_stay(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "MOST", 3000)
    hall, kept = hall_of(make_site(tmp_path)), RadioEvidence(6, RadioPrior())
    for minute in range(200):
        kept.take(hall.stretch(f"visitor-{minute // 3}", 60.0 * minute))
        assert len(kept) <= 3000
    visits, _, _ = kept.visits()
    assert visits.t.max() > T0 + 199 * 60.0
    assert len(kept.devices) == len(np.unique(visits.device)) < 67
    spots = np.column_stack([visits.point, np.floor(visits.place)])
    assert len(np.unique(spots, axis=0)) > 900, "old visits stay where nobody went since"


def test_a_night_ages_evidence_by_minutes_only(tmp_path: Path) -> None:
    hall, kept = hall_of(make_site(tmp_path)), RadioEvidence(6, RadioPrior())
    for start in (0.0, 60.0, 60_000.0):
        kept.take(hall.stretch("a", start))
    visits, age, _ = kept.visits()
    assert 600.0 <= age[visits.t < T0 + 60.0].max() < 900.0
    assert age.min() == 0.0


def test_a_stretch_of_few_scans_or_of_unknown_access_points_teaches_nothing(tmp_path: Path) -> None:
    hall, kept = hall_of(make_site(tmp_path)), RadioEvidence(6, RadioPrior())
    assert len(kept.take(hall.stretch("a", 0.0, seconds=3.0))) == 0
    assert len(RadioEvidence(0, RadioPrior()).take(hall.stretch("a", 0.0))) == 0
    assert kept.devices == []


def test_what_is_in_doubt_counts_for_less_and_can_be_left_out(tmp_path: Path) -> None:
    hall, kept = hall_of(make_site(tmp_path)), RadioEvidence(6, RadioPrior())
    sure = len(kept.take(hall.stretch("a", 0.0)))
    doubtful = len(kept.take(hall.stretch("b", 0.0), doubtful=True))
    visits, _, counts = kept.visits()
    assert min(sure, doubtful) > 0
    assert sorted(set(counts[visits.device == 0])) == [1.0]
    assert sorted(set(counts[visits.device == 1])) == [module.DOUBTFUL]
    assert len(kept.visits(sure=True)[0]) == sure
    kept.fade(0, T0 + 1e6, 0.5)
    assert len(kept.visits(sure=True)[0]) == sure, "what was sure stays so when its access point sends otherwise"
