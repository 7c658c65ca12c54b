"""Export of corrections as training data for a detector: images, their balls, and what is no ball."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
from PIL import Image

from models.core.corrections import BallPlace, Corrections
from pipeline.editing.run_view import ClipRun
from pipeline.engine.atomic_write import replace_file
from video.io.clip import read_frames

COLUMNS = ("image", "x_px", "y_px", "radius_px", "kind", "score", "sigma")
"""Columns as of `trueroll detect`."""
BALLS_FILE, FALSE_FILE = "balls.csv", "false_balls.csv"


def export_training_data(run: ClipRun, corrections: Corrections, folder: Path) -> str:
    """Export the frames with placed and false balls.

    Args:
        run: The corrected run.
        corrections: Its corrections, with frames of its clip.
        folder: Folder of the images and tables; created if it does not exist.

    Returns:
        A sentence on what was written.
    """
    frames = sorted({_find_frame(run, mark.ball) for mark in corrections.balls})
    if not frames:
        return "There is nothing to export: no ball was placed and none was marked as false."
    folder.mkdir(parents=True, exist_ok=True)
    for frame, rgb in read_frames(run.clip, indices=np.array(frames)):
        with replace_file(folder / _name_image(run, frame)) as part:
            Image.fromarray(rgb).save(part, format="PNG")
    balls = [row for frame in frames for row in _list_balls(run, frame)]
    false = [
        _make_row(run, _find_frame(run, mark.ball), mark.ball.x_px, mark.ball.y_px, _median_radius(run), "ball", 0.0)
        for mark in corrections.balls
        if mark.kind == "false"
    ]
    for name, rows in ((BALLS_FILE, balls), (FALSE_FILE, false)):
        with replace_file(folder / name) as part, part.open("w", newline="", encoding="utf-8") as file:
            table = csv.writer(file, lineterminator="\n")
            table.writerow(COLUMNS)
            table.writerows(rows)
    return f"{len(balls)} balls and {len(false)} false ones in {len(frames)} images were written to {folder}."


def _find_frame(run: ClipRun, place: BallPlace) -> int:
    """Return the distinct frame that shows a place."""
    distinct = run.clip.distinct_frames
    return int(distinct[max(int(np.searchsorted(distinct, place.frame, side="right")) - 1, 0)])


def _list_balls(run: ClipRun, frame: int) -> list[tuple[object, ...]]:
    """List the balls that were detected or placed in a frame."""
    tracks = run.tracks
    row = int(np.searchsorted(tracks.frame, frame))
    return [
        _make_row(
            run, frame, tracks.px[row, k, 0], tracks.px[row, k, 1], tracks.radius_px[row, k], tracks.kinds[k], 1.0
        )
        for k in np.flatnonzero(tracks.is_observed[row])
    ]


def _make_row(
    run: ClipRun, frame: int, x: float, y: float, radius: float, kind: str, score: float
) -> tuple[object, ...]:
    return (_name_image(run, frame), *(round(float(value), 3) for value in (x, y, radius)), kind, score, 1.0)


def _median_radius(run: ClipRun) -> float:
    return float(np.nanmedian(run.tracks.radius_px))


def _name_image(run: ClipRun, frame: int) -> str:
    """Name the image of a frame; frames of several clips can share a folder."""
    return f"{run.clip.digest[:8]}-{frame:06d}.png"
