"""A learned radio model survives its file, and a file of another site is refused in words."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from shared.radio import PathLoss, RadioModel, RadioModelError, ShadowingMap, read_radio_model, write_radio_model

NAMES = ("a", "b")


@pytest.fixture
def model() -> RadioModel:
    rng = np.random.default_rng(1)
    path_loss = PathLoss(NAMES, rng.uniform(0, 9, (2, 3)), np.array([-41.0, -43.5]), np.array([2.1, 2.4]))
    return RadioModel(
        "hall",
        path_loss,
        ShadowingMap(NAMES, np.array([0.5, 1.5]), 1.0, rng.normal(0, 3, (2, 4, 5)), rng.uniform(1, 9, (2, 4, 5))),
    )


def test_a_model_survives_its_file_in_any_order_of_access_points(model: RadioModel, tmp_path: Path) -> None:
    file = tmp_path / "radio.json"
    write_radio_model(model, file)
    again = read_radio_model(file, "hall", ("b", "a"))
    places = np.array([[2.0, 2.0], [4.4, 3.1]])
    np.testing.assert_allclose(again.path_loss.rssi(places)[:, ::-1], model.path_loss.rssi(places))
    for found, written in zip(again.shadowing.at(places), model.shadowing.at(places), strict=True):
        np.testing.assert_allclose(found[:, ::-1], written, atol=1e-3)
    assert again.site == "hall"


def test_where_nobody_knows_it_stays_unknown_and_the_site_file_has_the_word_on_what_was_not_located(
    model: RadioModel, tmp_path: Path
) -> None:
    file, places = tmp_path / "radio.json", np.array([[2.0, 2.0], [4.4, 3.1]])
    nowhere = dataclasses.replace(
        model.path_loss, positions=np.where([[True], [False]], np.nan, model.path_loss.positions)
    )
    write_radio_model(dataclasses.replace(model, path_loss=nowhere), file)
    again = read_radio_model(file, "hall", NAMES)
    assert again.path_loss.placed.tolist() == [False, True]
    assert np.ptp(again.path_loss.rssi(places)[:, 0]) == 0.0
    assert again.over(model.path_loss).path_loss.placed.all()
    assert model.over(nowhere).path_loss.placed.tolist() == [False, True]
    assert dataclasses.replace(model, located=("a",)).over(nowhere).path_loss.placed.all()
    write_radio_model(dataclasses.replace(model, path_loss=nowhere, located=("a",)), file)
    with pytest.raises(RadioModelError, match="positions: found null for 'a'"):
        read_radio_model(file, "hall", NAMES)


def test_a_file_of_another_site_or_of_other_access_points_is_refused(model: RadioModel, tmp_path: Path) -> None:
    file = tmp_path / "radio.json"
    write_radio_model(model, file)
    with pytest.raises(RadioModelError, match=r"learned at site 'hall', expected 'museum'"):
        read_radio_model(file, "museum", NAMES)
    with pytest.raises(RadioModelError, match=r"lacks c; has b"):
        read_radio_model(file, "hall", ("a", "c"))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        (b"{", "not a radio model"),
        (b'{"format": "atrium-radio-model/2"}', "not a radio model"),
    ],
)
def test_what_is_no_model_is_refused(content: bytes | None, words: str, tmp_path: Path) -> None:
    file = tmp_path / "radio.json"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(RadioModelError, match=words):
        read_radio_model(file, "hall", NAMES)


def test_maps_of_another_shape_than_the_columns_are_refused(model: RadioModel, tmp_path: Path) -> None:
    file = tmp_path / "radio.json"
    write_radio_model(model, file)
    text = file.read_text()
    file.write_text(text.replace('"power_1m":[-41.0,-43.5]', '"power_1m":[-41.0]'))
    with pytest.raises(RadioModelError, match="not of one shape"):
        read_radio_model(file, "hall", NAMES)
