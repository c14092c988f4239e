"""An area with its trained radio model, where there is one."""

from __future__ import annotations

import dataclasses
from pathlib import Path

from services.fusion.area_view import AreaView
from shared.radio import read_radio_model
from shared.site import Site

__all__ = ["trained_view"]


def trained_view(site: Site, area: str, radio_model: Path | None) -> AreaView:
    """Return the view of one area, its radio as a file of ``shared.radio.radio_model`` says (None: as the site file).

    Raises:
        KeyError: the site has no such area.
        RadioModelError: the file is no radio model of this floor's access points.
    """
    view = AreaView.of(site, area)
    if radio_model is None:
        return view
    model = read_radio_model(radio_model, site.site, view.radio.names)
    # Where the access points stand is for the site file to say.
    radio = dataclasses.replace(model.path_loss, positions=view.radio.positions)
    return dataclasses.replace(view, radio=radio, shadowing=model.shadowing)
