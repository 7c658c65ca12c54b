"""Every contact once more, close up and slower still: what an umpire wants to see after the shot."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import MIST, WHITE
from video.io.clip import Clip, read_frames
from video.matting.ball_timeline import Sightings
from video.overlay.ball_outlines import balls_at
from video.overlay.frame_overlay import Balls, Label, draw_ring, unit
from video.overlay.motion_marks import Mark
from video.synthesis.frame_synthesis import Interval, Scenery, open_interval

SLOWER = 4.0
"""Times slower than the slow motion before."""
SECONDS = 2.5
"""s of the finished video for each contact, at the most."""
MOST = 8
"""Contacts that are shown again: the strongest."""
AROUND_RADII = 7.0
"""Ball radii from the middle to the upper border of the close-up."""


def chosen_marks(marks: tuple[Mark, ...]) -> list[Mark]:
    """The strongest marks, in order of time."""
    strongest = sorted(marks, key=lambda mark: (-mark.strength, mark.t))[:MOST]
    return sorted(strongest, key=lambda mark: mark.t)


def replay_times(sightings: Sightings, mark: Mark, rate: float, slow: float) -> FloatArray:
    """Times (K,) s around a contact, within the two pictures that enclose it: beyond them nothing new is seen."""
    row, _ = sightings.place(mark.t)
    first, last = float(sightings.t[row]), float(sightings.t[min(row + 1, len(sightings.t) - 1)])
    step = 1 / (rate * slow * SLOWER)
    half = SECONDS / 2 * rate * step
    return np.arange(max(first, mark.t - half), min(last, mark.t + half), step)


def replays(clip: Clip, scenery: Scenery, marks: list[Mark], rate: float, slow: float) -> Iterator[ImageArray]:
    """Close-ups (H, W, 3) of every mark, one after another; two pictures of the clip are held at a time."""
    sightings = scenery.sightings
    rows = [sightings.place(mark.t)[0] for mark in marks]
    wanted = sorted({row + side for row in rows for side in (0, 1)})
    before: tuple[int, ImageArray] | None = None
    pictures = read_frames(clip, indices=sightings.frame[wanted])
    for row, (_, picture) in zip(wanted, pictures, strict=True):
        if before is not None and before[0] == row - 1:
            here = [mark for mark, other in zip(marks, rows, strict=True) if other == row - 1]
            if here:
                interval = open_interval(sightings, scenery.plate, row - 1, before[1], picture, sharp=scenery.sharp)
                for mark in here:
                    yield from _replay(interval, mark, replay_times(sightings, mark, rate, slow), slow)
        before = (row, picture)


def _replay(interval: Interval, mark: Mark, times: FloatArray, slow: float) -> Iterator[ImageArray]:
    sightings = interval.sightings
    state, ways = sightings.state(times), sightings.ways(times, sightings.exposure)
    for t, balls, way in zip(times.tolist(), balls_at(sightings, state, times), ways, strict=True):
        picture = interval.at(t, balls.centre, way)
        yield _close(picture, sightings, mark, t, balls, slow)


def _close(picture: ImageArray, sightings: Sightings, mark: Mark, t: float, balls: Balls, slow: float) -> ImageArray:
    """The place of the contact magnified to the whole picture, with the fitted outlines and the time to the contact."""
    height, width = picture.shape[:2]
    scale = height / (2 * AROUND_RADII * balls.radius_of(mark.ball))
    middle = sightings.project(mark.xy, t)
    corner = middle - np.array([width, height]) / (2 * scale)
    view = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    way = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    close = cv2.warpAffine(picture, view, (width, height), flags=way, borderMode=cv2.BORDER_REPLICATE)
    made: ImageArray = np.ascontiguousarray(close, dtype=np.uint8)
    stroke = unit(height)
    for ball in balls.present:
        centre, radius = scale * (balls.centre[ball] - corner), scale * balls.radius_of(int(ball))
        draw_ring(made, centre, radius, 1.4 * stroke, WHITE, 0.7)
    margin = 14 * stroke
    value = f"{1e3 * (t - mark.t):+.1f} ms   {slow * SLOWER:g}× slower"
    Label(mark.label.name or "contact", value, MIST).draw(made, np.array([margin, margin]), 1.25 * stroke)
    return made
