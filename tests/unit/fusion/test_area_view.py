"""What cameras see of the floor, and how far inside the view a place lies."""

from pathlib import Path

import numpy as np
import pytest
from fusion_world import make_site

from services.fusion.area_view import AreaView
from shared.site import load_site


def test_depth_is_the_distance_to_the_border_of_the_view(tmp_path: Path) -> None:
    site = make_site(tmp_path)
    view = AreaView.of(site, "hall")
    geometry = site.camera("west").geometry.build()
    rng = np.random.default_rng(0)
    places = rng.uniform([0.5, 0.5], [23.5, 13.5], (400, 2))
    pixels = geometry.to_image(np.column_stack([places, np.zeros(400)]))
    seen = ((pixels >= 0) & (pixels <= [960, 720])).all(axis=1)
    depth = view.views["west"].depth_at(places)
    sure = np.abs(depth) > 0.4  # nearer to the border the raster may err by a cell
    assert ((depth > 0) == seen)[sure].all()
    assert sure.mean() > 0.7


def test_the_union_of_views_is_as_deep_as_the_deepest(tmp_path: Path) -> None:
    view = AreaView.of(make_site(tmp_path), "hall")
    places = np.random.default_rng(1).uniform([0, 0], [24, 14], (200, 2))
    each = np.stack([one.depth_at(places) for one in view.views.values()])
    assert (view.everywhere.depth_at(places) >= each.max(axis=0) - 1e-9).all()


def test_places_far_outside_are_clamped_and_not_seen(tmp_path: Path) -> None:
    view = AreaView.of(make_site(tmp_path), "hall")
    assert (view.everywhere.depth_at(np.array([[1e6, 1e6], [-1e6, 0.0]])) < 0.0).all()


def test_an_area_without_cameras_sees_nothing_and_keeps_its_own_access_points(tmp_path: Path) -> None:
    view = AreaView.of(make_site(tmp_path), "gallery")
    assert view.views == {}
    assert view.radio.names == ("upstairs",)
    assert (view.everywhere.depth < 0.0).all()


@pytest.mark.parametrize("name", ["hall", "pets09"])
def test_the_shipped_sites_are_seen(project: Path, data_folder: Path, name: str) -> None:
    """Also through a lens with distortion, an area of interest and a picture that shows the sky."""
    site = load_site(project / "deploy" / "sites" / name / "site.yaml")
    view = AreaView.of(site, site.areas[0].id)
    share = float((view.everywhere.depth > 0.0).mean())
    assert 0.2 < share < 0.95
