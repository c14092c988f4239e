"""What is set up in the browser, as the API reads and changes it: the file beside the site file is the truth."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from pathlib import Path

from services.api.problems import Problem, ProblemError
from shared.part_file import PartFileError
from shared.site import Site
from shared.site.setup_change import SetupRefusedError, SetupUnwritableError, change_setup
from shared.site.setup_file import CameraSetup, PointPlace, SetUp, read_setup
from shared.site.site_file import PointsGeometry

__all__ = ["SetupDesk"]

Ring = list[tuple[float, float]]


class SetupDesk:
    """Reads and changes the set-up of one site.

    Args:
        site_file: beside it the set-up lies.
        site: whose it is.
        told: called after something was saved.
        now: wall clock, seconds since the epoch.
    """

    def __init__(
        self, site_file: Path, site: Site, told: Callable[[], None], now: Callable[[], float] = time.time
    ) -> None:
        self._told = told
        self._file = site_file
        self._site = site
        self._now = now

    def read(self) -> SetUp:
        """Return what is set up.

        Raises:
            ProblemError: the file is damaged.
        """
        try:
            return read_setup(self._file) or SetUp(site=self._site.site)
        except PartFileError as error:
            raise _problem(409, "Set-up is damaged", str(error)) from error

    def save_camera(self, camera: str, geometry: PointsGeometry, interest: Ring | None, by: str) -> int:
        """Store a calibration with its area of interest and return the set-up's version.

        Raises:
            ProblemError: it does not fit the site, or cannot be written; nothing is stored.
        """

        def change(setup: SetUp) -> SetUp:
            before = setup.cameras.get(camera, CameraSetup())
            changes = {
                "geometry": geometry,
                "area_of_interest": interest,
                "whole_picture": interest is None,
                "saved": self._now(),
                "by": by,
            }
            return setup.model_copy(update={"cameras": {**setup.cameras, camera: before.model_copy(update=changes)}})

        return self._change(change)

    def place(self, positions: Mapping[str, tuple[float, float, float] | None], by: str) -> int:
        """Store where access points hang, None: as the site file says; return the set-up's version.

        Raises:
            ProblemError: as for ``save_camera``.
        """

        def change(setup: SetUp) -> SetUp:
            places = dict(setup.access_points)
            for point, position in positions.items():
                if position is None:
                    places.pop(point, None)
                else:
                    places[point] = PointPlace(position=position, saved=self._now(), by=by)
            return setup.model_copy(update={"access_points": places})

        return self._change(change)

    def _change(self, change: Callable[[SetUp], SetUp]) -> int:
        try:
            version = change_setup(self._file, change).version
        except SetupRefusedError as error:
            raise _problem(422, "Does not fit the site", str(error)) from error
        except SetupUnwritableError as error:
            raise _problem(503, "Cannot be written", str(error)) from error
        self._told()
        return version


def _problem(status: int, title: str, words: str) -> ProblemError:
    return ProblemError(
        Problem(type="urn:atrium:" + title.lower().replace(" ", "-"), title=title, status=status, detail=words)
    )
