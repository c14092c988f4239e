"""What does it look like? One frame of the clip with every track, its name, and whether the name is right.

The frame is of the clip, which is not shipped: such a picture stays where it was asked for.
"""

from __future__ import annotations

from pathlib import Path

import cv2
import matplotlib as mpl
import numpy as np

from benchmarks.fusion_run import FusionRun
from benchmarks.phone_scores import followed
from benchmarks.track_reading import newest_frames
from benchmarks.world_record import WorldRecord
from shared.messages import TrackFrame, positions
from shared.site import Camera

__all__ = ["draw_overlays", "picture_of"]

COLORS = {"right": "lime", "wrong": "tomato", "not sure": "0.9", "unseen": "deepskyblue"}


def picture_of(camera: Camera, number: int) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    """Return frame ``number`` of a camera's file, (rows, columns, 3), red first.

    OSError: the file has no such frame.
    """
    video = cv2.VideoCapture(str(camera.source.file))
    try:
        video.set(cv2.CAP_PROP_POS_FRAMES, number)
        read, picture = video.read()
    finally:
        video.release()
    if not read:
        raise OSError(f"{camera.source.file}: no frame {number}")
    return np.asarray(cv2.cvtColor(picture, cv2.COLOR_BGR2RGB), np.uint8)


def draw_overlays(record: WorldRecord, run: FusionRun, rows: list[int], title: str, path: Path) -> None:
    """Write as PNG what was published at some of the truth's times, drawn into the frames of the first camera."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    camera, truth = record.site.cameras_of(record.area)[0], record.truth
    whom = followed(truth, run.frames)
    newest = newest_frames(truth.t, run.frames)
    figure, axes = plt.subplots(1, len(rows), figsize=(6.4 * len(rows), 5.2), squeeze=False)
    for row, plot in zip(rows, axes[0], strict=True):
        picture = picture_of(camera, row)
        geometry = camera.geometry.build().scaled_to(picture.shape[1], picture.shape[0])
        plot.imshow(picture)
        frame: TrackFrame = run.frames[newest[row]]
        feet = geometry.to_image(np.column_stack([positions(frame), np.zeros(len(frame.track))]))
        for index, (x, y) in enumerate(feet.tolist()):
            person = whom.whom(frame.track[index], row)
            device = frame.device[index]
            carried = truth.device[person] if person >= 0 else None
            verdict = "not sure" if device is None else "right" if device == carried else "wrong"
            if frame.state[index] == "unseen":
                verdict = "unseen"
            name = "?" if device is None else device.removeprefix("phone-")
            told = (
                name
                if verdict in ("right", "unseen") or carried is None
                else f"{name} ({carried.removeprefix('phone-')})"
            )
            plot.plot(x, y, "o", color=COLORS[verdict], markersize=6, markeredgecolor="black")
            shade = {"facecolor": "black", "alpha": 0.55, "pad": 1.0, "linewidth": 0.0}
            plot.text(
                x + 6, y + 10, told, color=COLORS[verdict], fontsize=11, fontweight="bold", bbox=shade, clip_on=True
            )
        plot.set(xlim=(0, picture.shape[1]), ylim=(picture.shape[0], 0), xticks=[], yticks=[])
        plot.set_title(f"{truth.t[row] - truth.t[0]:.1f} s")
    figure.suptitle(f"{title}: name said (person really there where it differs); blue: from steps and radio alone")
    figure.tight_layout()
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, dpi=80)
    plt.close(figure)
