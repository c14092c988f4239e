"""How well do the plain methods alone do on one area of one world? What a scenario's difficulty is anchored by."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from benchmarks.baselines import constant_velocity, ev_loc, horus, vision_rbmcda
from benchmarks.baselines.anonymous_tracks import AnonymousTracks
from benchmarks.baselines.survey import Survey, surveyed_path_loss
from benchmarks.position_error import centre_of, field_of_view_errors, percentiles, window_rmse
from benchmarks.track_reading import matched_positions
from benchmarks.world_record import Truth, WorldRecord

__all__ = ["baseline_figures", "baseline_window_errors"]

Array = NDArray[np.float64]


def baseline_window_errors(record: WorldRecord, survey: Survey | None, window: float = 60.0) -> dict[str, Array]:
    """Return the error of each carrier in each window, (w, k) metres by method; NaN where there is nothing to score.

    ``radio`` (Horus, every access point), ``vision`` (RBMCDA) and ``cv`` (global nearest neighbour): RMSE, anonymous
    tracks matched to people per window. ``evloc``: mean error while both truth and estimate are in view
    [ravel-thesis §11.1]. Every method has its default parameters.

    Args:
        record: of one area; methods whose sensor it lacks are left out.
        survey: of its radio; None leaves out what needs one.
        window: seconds.
    """
    truth, times = record.truth, record.truth.t
    centre = centre_of(record.view)
    errors: dict[str, Array] = {}
    if survey is not None and record.scans:
        by_radio = _of_carriers(truth, horus.locate(record, survey, times))
        errors["radio"] = window_rmse(truth, by_radio, centre, window).rmse
    if record.frames:
        by_sight = vision_rbmcda.track(record, times)
        errors["vision"] = window_rmse(truth, _matched(record, by_sight, window), centre, window).rmse
        nearest = constant_velocity.track(record, times)
        errors["cv"] = window_rmse(truth, _matched(record, nearest, window), centre, window).rmse
        if survey is not None and record.scans:
            model = surveyed_path_loss(record.site, survey, record.site.area(record.area).floor)
            paired = ev_loc.locate_on_tracks(record, model, nearest)
            errors["evloc"] = field_of_view_errors(truth, _of_carriers(truth, paired), window).offline
    return errors


def baseline_figures(record: WorldRecord, survey: Survey | None, window: float = 60.0) -> dict[str, float | None]:
    """Return ``p50_METHOD``, ``p70_METHOD`` and ``p90_METHOD`` in metres of ``baseline_window_errors``.

    None where there was nothing to score.
    """
    figures: dict[str, float | None] = {}
    for method, errors in baseline_window_errors(record, survey, window).items():
        names = (f"{share}_{method}" for share in ("p50", "p70", "p90"))
        figures.update(zip(names, percentiles(errors), strict=True))
    return figures


def _of_carriers(truth: Truth, by_device: Mapping[str, Array]) -> Array:
    """Return (n, k, 2) in the order of the carriers; NaN for a device that is not in ``by_device``."""
    unknown = np.full((len(truth.t), 2), np.nan)
    devices = [truth.device[place] or "" for place in truth.carriers()]
    return np.stack([by_device.get(device, unknown) for device in devices], axis=1)


def _matched(record: WorldRecord, tracks: AnonymousTracks, window: float) -> Array:
    return matched_positions(record.truth, tracks.frames(record.area, record.site.area(record.area).floor), window)
