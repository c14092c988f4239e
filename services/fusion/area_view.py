"""What fusion knows of its area before it starts: the floor, what each camera sees of it, the access points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from shared.radio import PathLoss, ShadowingMap
from shared.site import FloorPlan, Site, ViewMap, camera_views

__all__ = ["AreaView"]

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AreaView:
    """One area as its tracker sees it.

    Attributes:
        area: its id.
        floor: the floor it lies on.
        lower: (2,) and ``upper``: (2,), corners of the floor with a margin, metres; beyond it nothing is believed.
        views: by camera id.
        everywhere: the union of all views.
        radio: path loss of the floor's access points: as the site file says, until something was learned. Those it does
            not place are heard and passed over.
        plan: the floor's outline, walls and obstacles.
        site: id of the site.
        filed: path loss as the site file says, whatever was learned.
        shadowing: what was learned of the radio beyond path loss, its access points in the order of ``radio``; None
            where nothing was.
    """

    area: str
    floor: str
    lower: Array
    upper: Array
    views: dict[str, ViewMap]
    everywhere: ViewMap
    radio: PathLoss
    plan: FloorPlan
    site: str
    filed: PathLoss
    shadowing: ShadowingMap | None = None

    @classmethod
    def of(cls, site: Site, area_id: str) -> AreaView:
        """Return the view of one area of a site.

        Raises:
            KeyError: the site has no such area.
        """
        area = site.area(area_id)
        plan = site.floor(area.floor).plan()
        seen = camera_views(site, area_id, plan)
        radio = PathLoss.of([point for point in site.access_points if point.floor == area.floor])
        return cls(
            area=area_id,
            floor=area.floor,
            lower=seen.lower,
            upper=seen.upper,
            views=seen.each,
            everywhere=seen.everywhere,
            radio=radio,
            plan=plan,
            site=site.site,
            filed=radio,
        )
