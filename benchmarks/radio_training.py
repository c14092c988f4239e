"""What would a site's own running teach it about its radio? A model learned from published tracks, without truth.

Every scan of a device whose track bore its name when fusion had thought it over is a reading at a known place. What all
readings of one visit to a spot have in common (how the carrier faces, a wrong name) is not averaged away by more of
them; how large it is, visits to one spot that disagree show. The tracker runs over the same time again with what was
learned, names a few more tracks right, and teaches again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from benchmarks.fusion_run import FusionRun, run_fusion
from benchmarks.revised import UNSEEN, said_later
from benchmarks.world_record import WorldRecord
from services.fusion.area_view import AreaView
from services.fusion.registry import DEFAULT_TRACKER
from shared.messages import RadioScan
from shared.radio import RadioLearner, RadioModel, RadioPrior, fit_radio, gather_visits, novelty

__all__ = ["PRIOR", "learn_from_run", "train_radio", "warmed_up"]

Array = NDArray[np.float64]

PRIOR = RadioPrior()
ROUNDS = 3
LAG = 5.0
"""Seconds for which a name may still be revised before it teaches."""
SURE = 0.5
"""Probability from which a name teaches, and by as much as it is: on a site as found few are surer, and rightly so."""
FEWEST = 4
"""Scans along one track; fewer teach nothing, because too often the name was a guess."""


def warmed_up(view: AreaView, model: RadioModel) -> AreaView:
    """Return the view with what was learned of its radio."""
    return dataclasses.replace(view, radio=model.path_loss, shadowing=model.shadowing)


def train_radio(record: WorldRecord, tracker: str = DEFAULT_TRACKER, rounds: int = ROUNDS) -> RadioModel:
    """Return the model that a tracker's own tracks teach, after running over the same record ``rounds`` times."""
    view = fresh = AreaView.of(record.site, record.area)
    model = RadioLearner.over(fresh.radio, fresh.lower, fresh.upper, prior=PRIOR).solve(record.site.site)
    for _ in range(rounds):
        model = learn_from_run(run_fusion(record, tracker, view=view), record.scans, fresh, record.site.site)
        view = warmed_up(fresh, model)
    return model


def learn_from_run(
    run: FusionRun, scans: Mapping[str, Sequence[RadioScan]], view: AreaView, site: str, prior: RadioPrior = PRIOR
) -> RadioModel:
    """Return the model learned from one run's published tracks and what phones heard meanwhile.

    Args:
        run: what a tracker published, and revised within ``LAG`` seconds.
        scans: by device, in order of measurement.
        view: gives the floor and the first guess of the path loss.
        site: the site's id.
        prior: what is believed beforehand.
    """
    column = {name: number for number, name in enumerate(view.radio.names)}
    table: list[Array] = []
    for number, device in enumerate(sorted(scans)):
        table += _readings(run, device, scans[device], column, number)
    rows = np.array(table).reshape(-1, 9)
    who, point, track = (rows[:, place].astype(np.int64) for place in (0, 1, 8))
    weight = rows[:, 7] / prior.noise(rows[:, 6])
    visits = gather_visits(rows[:, 3], who, track, point, rows[:, 4:6], rows[:, 2], weight)
    return fit_radio(view.radio, view.lower, view.upper, visits, prior=prior, site=site).model


def _readings(
    run: FusionRun, device: str, scans: Sequence[RadioScan], column: Mapping[str, int], number: int
) -> list[Array]:
    """Return rows (device, access point, level, t, x, y, spread, share, track) of readings on sure tracks."""
    if not scans:
        return []
    t = np.array([scan.t for scan in scans])
    said = said_later(t, [device], run.frames, run.revisions, LAG)
    track, probability = said.track[:, 0], said.probability[:, 0]
    sure = np.flatnonzero((track > UNSEEN) & (probability >= SURE))
    ids, counts = np.unique(track[sure], return_counts=True)
    sure = sure[np.isin(track[sure], ids[counts >= FEWEST])]
    places, sigma = said.position[sure, 0], said.sigma[sure, 0]
    share = novelty(places) * probability[sure]
    rows = []
    for index, row in enumerate(sure.tolist()):
        scan = scans[row]
        for name, level in zip(scan.access_point, scan.rssi, strict=True):
            if name in column:
                told = (scan.t, *places[index], sigma[index], share[index], track[row])
                rows.append(np.array([number, column[name], level, *told]))
    return rows
