"""What is kept of a calibration, how it is told, and whether the camera uses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from services.api.calibration_replies import (
    CalibrationSave,
    CalibrationSaved,
    CalibrationTry,
    CalibrationView,
    Pair,
)
from services.api.calibration_trial import all_pairs, try_pairs
from services.api.live_state import LiveState
from services.api.problems import Problem, ProblemError
from services.api.request_body import invalid
from services.api.setup_desk import SetupDesk
from shared.site import Camera, Site
from shared.site.camera_geometry import GeometryError, LensModel
from shared.site.geometry_digest import geometry_digest
from shared.site.setup_file import CameraSetup
from shared.site.site_file import Lens, PointsGeometry, TsaiGeometry

__all__ = ["calibration_view", "check_inside", "lens_of", "save_calibration", "unfit"]


def save_calibration(
    site: Site, desk: SetupDesk, live: LiveState, camera: Camera, order: CalibrationSave, by: str
) -> CalibrationSaved:
    """Try the pairs once more, so that nothing is stored that the next start would refuse, and store the used ones."""
    attempt = CalibrationTry(image_size=order.image_size, pairs=order.pairs)
    lens = _known_lens(desk, camera) if order.use_lens else None
    floor = site.floor(site.area(camera.area).floor)
    try:
        image, plan = all_pairs(attempt)
        check_inside(image, order.image_size)
        model = None if lens is None else _fitting(lens, order.image_size)
        trial = try_pairs(camera.id, floor, order.image_size, image, plan, model)
        used = np.array([pair.used for pair in trial.pairs])
        geometry = PointsGeometry.model_validate(
            {
                "kind": "points",
                "image_size": order.image_size,
                "image": image[used].tolist(),
                "plan": plan[used].tolist(),
                "lens": lens,
            }
        )
        interest = CameraSetup.model_validate({"area_of_interest": order.area_of_interest}).area_of_interest
    except ValidationError as error:
        first = error.errors()[0]
        field = ".".join(str(step) for step in first["loc"])
        raise invalid(field, str(first["msg"]), "a polygon in the picture that does not cross itself") from error
    except (GeometryError, ValueError) as error:
        raise unfit(str(error)) from error
    version = desk.save_camera(camera.id, geometry, interest, by)
    words = [_taken_up(live, camera), "A correction learned for the calibration before is taken back."]
    return CalibrationSaved(words=" ".join(words), version=version)


def _taken_up(live: LiveState, camera: Camera) -> str:
    """Tell when the camera uses it."""
    known = live.calibration(camera.id)
    if known is None:
        return f"Saved. No process of camera {camera.id} is heard: it takes it up when it runs."
    if not known:
        return f"Saved. What camera {camera.id} detects is made by a scenario, and stays as its site file says."
    taken = f"camera {camera.id}, fusion of {camera.area} and learning take it up within seconds"
    return f"Saved: {taken}, and nothing need be started again."


def calibration_view(site: Site, desk: SetupDesk, live: LiveState, camera: Camera) -> CalibrationView:
    """Return how a camera is calibrated: as saved, or else as the site file says."""
    kept = desk.read().cameras.get(camera.id, CameraSetup())
    geometry = kept.geometry or camera.geometry
    pairs = []
    if isinstance(geometry, PointsGeometry):
        pairs = [Pair(pixel=pixel, place=place) for pixel, place in zip(geometry.image, geometry.plan, strict=True)]
    size = geometry.build().image_size if isinstance(geometry, TsaiGeometry) else geometry.image_size
    told = kept.area_of_interest is not None or kept.whole_picture
    return CalibrationView(
        camera=camera.id,
        floor=site.area(camera.area).floor,
        kind=geometry.kind,
        image_size=size,
        pairs=pairs,
        area_of_interest=kept.area_of_interest if told else camera.area_of_interest,
        lens=_known_lens(desk, camera) is not None,
        saved=kept.saved if kept.geometry is not None else None,
        by=kept.by,
        pending=kept.geometry is not None and live.calibration(camera.id) not in ("", geometry_digest(geometry)),
    )


def lens_of(desk: SetupDesk, camera: Camera, image_size: tuple[int, int]) -> LensModel | None:
    """Return a camera's lens for pictures of this size, None where it was never calibrated.

    Raises:
        ProblemError: it is of pictures of other proportions.
    """
    lens = _known_lens(desk, camera)
    return None if lens is None else _fitting(lens, image_size)


def _known_lens(desk: SetupDesk, camera: Camera) -> Lens | None:
    """The newest: of a clip, else of what was saved, else of the site file."""
    kept = desk.read().cameras.get(camera.id, CameraSetup())
    geometry = kept.geometry or camera.geometry
    return kept.lens or (geometry.lens if isinstance(geometry, PointsGeometry) else None)


def _fitting(lens: Lens, image_size: tuple[int, int]) -> LensModel:
    if abs(lens.image_size[0] * image_size[1] / (lens.image_size[1] * image_size[0]) - 1.0) > 0.02:
        raise unfit(
            f"the lens was calibrated with pictures of {lens.image_size[0]} x {lens.image_size[1]}, these are "
            f"{image_size[0]} x {image_size[1]}: the proportions differ; calibrate it anew, or do without it (use_lens)"
        )
    return lens.model(image_size)


def check_inside(image: NDArray[np.float64], image_size: tuple[int, int]) -> None:
    """Refuse pixels outside of the picture."""
    outside = np.flatnonzero(~((image >= -0.5) & (image <= np.array(image_size) - 0.5)).all(axis=1))
    if len(outside):
        u, v = image[outside[0]]
        raise ValueError(
            f"pair {outside[0] + 1}: ({u:g}, {v:g}) lies outside the {image_size[0]} x {image_size[1]} picture"
        )


def unfit(words: str) -> ProblemError:
    """Return the 422 for pairs of which no camera comes."""
    return ProblemError(
        Problem(type="urn:atrium:no-calibration", title="No calibration", status=422, detail=words, field="pairs")
    )
