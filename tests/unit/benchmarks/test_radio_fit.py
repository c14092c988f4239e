"""What the radio fit finds is what is there, in worlds whose truth is known."""

import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from benchmarks.radio_counterpart import counterpart
from benchmarks.radio_fit import OVERHEAD, look_at_walks
from benchmarks.radio_recordings import Readings, ble_walks, heading_of
from benchmarks.radio_residuals import (
    PathLossFit,
    body_effect,
    correlation,
    exponential,
    fit_path_loss,
    means,
    missed_at_rest,
    missed_between,
    moments,
    rest,
    wall_effect,
)
from benchmarks.spreadsheet import read_sheets
from services.simulator.radio.radio_world import RadioParameters

Array = NDArray[np.float64]

PLACES = np.array([[2.0, 2.0, 1.0], [18.0, 3.0, 1.0], [10.0, 13.0, 1.0], [1.0, 12.0, 1.0]])
CALM: dict[str, Any] = {
    "shadowing_sigma": 0.0,
    "body_loss": 0.0,
    "facing_sigma": 0.0,
    "drift_sigma": 0.0,
    "rice_factor": 1000.0,
    "flicker_sigma": 0.0,
    "noise_sigma": 0.5,
    "always_missed": 0.0,
    "sensitivity": -120.0,
}


def walks(count: int = 12, scans: int = 250, known: bool = True) -> Readings:
    """Somebody walks zigzag through a hall; nothing heard yet but in the first scans, one of each transmitter."""
    rng = np.random.default_rng(0)
    position, heading, t = [], [], []
    for walk in range(count):
        corners = rng.uniform([0.5, 0.5], [19.5, 14.5], (16, 2))
        along = np.linspace(0, 15, scans)
        track = np.column_stack([np.interp(along, np.arange(16), corners[:, axis]) for axis in (0, 1)])
        when = 1000.0 * walk + np.arange(scans, dtype=float)
        position.append(track)
        t.append(when)
        heading.append(heading_of(when, track, 1.0))
    scan_walk = np.repeat(np.arange(count), scans)
    scan = np.repeat(scans * np.arange(count), len(PLACES))
    where = np.concatenate(position)
    return Readings(
        transmitter=np.tile(np.arange(len(PLACES)), count),
        walk=scan_walk[scan],
        scan=scan,
        t=np.concatenate(t)[scan],
        position=where[scan],
        heading=np.concatenate(heading)[scan],
        rssi=np.full(len(scan), -60.0),
        scan_walk=scan_walk,
        scan_t=np.concatenate(t),
        scan_position=where,
        scan_heading=np.concatenate(heading),
        place=PLACES if known else None,
    )


def lines(exponent: float = 2.0) -> PathLossFit:
    return PathLossFit(PLACES, np.full(len(PLACES), -40.0), np.full(len(PLACES), exponent), np.zeros(0))


def heard(readings: Readings, walls: list[Array] | None = None, seed: int = 1, **more: Any) -> Readings:
    # The lines of the counterpart are fitted to what was heard, so a recording of these lines comes first.
    flat = np.maximum(np.hypot(*(readings.position - PLACES[readings.transmitter, :2]).T), 0.5)
    told = -40.0 - 20.0 * np.log10(np.hypot(flat, PLACES[readings.transmitter, 2]))
    first = Readings(**{name: getattr(readings, name) for name in Readings.__dataclass_fields__} | {"rssi": told})
    return counterpart(first, lines(), "wifi", seed, RadioParameters(**{**CALM, **more}), walls or [])


def test_nothing_is_left_where_path_loss_is_all_there_is() -> None:
    fit = fit_path_loss(heard(walks()))
    assert moments(fit.residual)[0] == pytest.approx(np.hypot(0.5, 0.29), abs=0.15)
    np.testing.assert_allclose(fit.exponent, 2.0, atol=0.15)


def test_unknown_places_of_transmitters_are_found() -> None:
    fit = fit_path_loss(heard(walks(known=False)))
    np.testing.assert_allclose(fit.place[:, :2], PLACES[:, :2], atol=0.7)


def test_shadowing_is_found_with_its_strength_and_length() -> None:
    shares, lengths, sigmas = [], [], []
    for seed in range(4):
        readings = heard(walks(), seed=seed, shadowing_sigma=4.0, shadowing_length=1.5, noise_sigma=3.0)
        fit = fit_path_loss(readings)
        walk = readings.walk
        share, length = exponential(correlation(readings, fit.residual, lambda i, j: walk[i] != walk[j]))  # noqa: B023
        shares.append(share)
        lengths.append(length)
        sigmas.append(moments(fit.residual)[0])
    assert np.mean(sigmas) == pytest.approx(5.0, abs=0.35)
    assert np.mean(shares) == pytest.approx(16.0 / 25.0, abs=0.1)
    assert np.mean(lengths) == pytest.approx(1.5, abs=0.4)


def test_a_body_is_found_where_there_is_one_only() -> None:
    for loss in (0.0, 6.0):
        readings = heard(walks(), body_loss=loss)
        assert body_effect(readings, fit_path_loss(readings))[0] == pytest.approx(loss, abs=0.6)


def test_walls_are_found_where_they_stand() -> None:
    walls = [np.array([[6.0, 0.0], [6.0, 9.0]]), np.array([[9.0, 5.0], [16.0, 11.0]])]
    readings = heard(walks(), walls, wall_loss=5.0)
    assert wall_effect(readings, fit_path_loss(readings), walls) == pytest.approx(5.0, abs=0.8)
    elsewhere = [np.array([[12.0, 0.0], [13.0, 2.5]])]
    assert abs(wall_effect(readings, fit_path_loss(readings), elsewhere)) < 4.0


def test_misses_are_counted_where_neighbours_heard() -> None:
    curve = missed_between(heard(walks(), always_missed=0.2))
    known = np.isfinite(curve.y)
    assert np.average(curve.y[known], weights=curve.count[known]) == pytest.approx(0.2, abs=0.03)


def test_wavering_at_rest_and_misses_at_rest_are_those_of_the_world() -> None:
    still = walks(6, 300)
    place = still.scan_position[::300].repeat(300, axis=0)
    still = Readings(
        **{name: getattr(still, name) for name in Readings.__dataclass_fields__}
        | {"scan_position": place, "position": place[still.scan], "scan_heading": np.full(len(place), np.nan)}
    )
    readings = heard(still, noise_sigma=2.0, always_missed=0.1)
    assert np.sqrt(np.mean(rest(readings) ** 2)) == pytest.approx(np.hypot(2.0, 0.29), abs=0.1)
    missed = missed_at_rest(readings)
    known = np.isfinite(missed.y)
    assert missed.y[known] == pytest.approx(0.1, abs=0.05)
    assert len(means(readings).rssi) == 6 * len(PLACES)


def test_a_workbook_is_read_with_its_holes(tmp_path: Path) -> None:
    main = 'xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main"'
    relation = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"
    path = tmp_path / "book.xlsx"
    with zipfile.ZipFile(path, "w") as book:
        book.writestr(
            "xl/sharedStrings.xml", f"<sst {main}><si><t>x</t></si><si><r><t>RS</t></r><r><t>SI</t></r></si></sst>"
        )
        book.writestr(
            "xl/workbook.xml",
            f'<workbook {main} xmlns:r="{relation}"><sheets><sheet name="WiFi" r:id="rId7"/></sheets></workbook>',
        )
        book.writestr(
            "xl/_rels/workbook.xml.rels",
            '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">'
            '<Relationship Id="rId7" Target="worksheets/sheet3.xml"/></Relationships>',
        )
        book.writestr(
            "xl/worksheets/sheet3.xml",
            f'<worksheet {main}><sheetData><row><c r="B1" t="s"><v>0</v></c><c r="C1" t="s"><v>1</v></c></row>'
            '<row><c r="AB2"><v>-0.5</v></c></row></sheetData></worksheet>',
        )
    rows = read_sheets(path)["WiFi"]
    assert rows[0] == [None, "x", "RSSI"]
    assert len(rows[1]) == 28
    assert rows[1][27] == -0.5


def test_the_twins_defaults_agree_with_the_hall(data_folder: Path) -> None:
    readings = ble_walks(data_folder)
    assert (len(readings.rssi), readings.transmitters, int(readings.walk.max())) == (7818, 12, 4)
    real = look_at_walks(readings).figures
    assert real["sigma"] == pytest.approx(5.3, abs=0.1)
    chosen = RadioParameters().model_copy(update=OVERHEAD)
    fit = fit_path_loss(readings)
    twins = [look_at_walks(counterpart(readings, fit, "ble", seed, chosen)).figures for seed in range(2)]
    assert np.mean([twin["sigma"] for twin in twins]) == pytest.approx(real["sigma"], rel=0.1)
    near = np.mean([twin["correlation_same_walk"] for twin in twins])
    assert near == pytest.approx(real["correlation_same_walk"], abs=0.08)
    assert np.mean([twin["missed_strong"] for twin in twins]) == pytest.approx(real["missed_strong"], abs=0.03)
