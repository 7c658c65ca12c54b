"""The still of a shot: its balls along their ways, what happened when, in one picture."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

from models.core.errors import ClipError
from models.core.fit_result import Fit
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import Rect, covered_share, place_label
from video.drawing.palette import FLASH, INK, WHITE
from video.io.clip import Clip, read_frames
from video.io.options import RenderOptions
from video.matting.background_plate import Plate
from video.matting.ball_matting import Sprite, peel
from video.matting.ball_timeline import Sightings
from video.matting.compositing import Layer, paste
from video.overlay.annotation import EIGHTFOLD, MOST_WORDS, Annotation, annotate
from video.overlay.frame_overlay import Balls, Label, draw_disc, draw_ring, draw_trail, uncovered
from video.synthesis.frame_synthesis import Scenery

APART_RADII = 5.0
"""Way between two flashes of the stroboscope, in ball radii."""
GHOST = 0.5
"""Opacity of the balls along the way."""
MOST_COVERED = 0.25
"""Share of a label over other things from which it is left out."""
MOST_TIMES = 8
"""Contacts whose time is written: more would hide the table."""


@dataclass(slots=True)
class Poster:
    """The last picture of a shot with every ball along its way, as a stroboscope sees it, and its contacts.

    It is shown the pictures in order, by whoever reads them anyway: `rows` of them are enough.
    """

    sightings: Sightings
    plate: Plate
    flashes: list[tuple[int, int]]
    """Row and ball of every ghost."""
    rows: frozenset[int]
    ghosts: list[tuple[Sprite, FloatArray]] = field(default_factory=list)
    first: ImageArray | None = None
    last: ImageArray | None = None

    @classmethod
    def of(cls, scenery: Scenery) -> Poster:
        """A poster that has seen nothing yet."""
        sightings, flashes = scenery.sightings, _flashes(scenery.sightings)
        rows = frozenset({0, len(sightings.t) - 1, *(row for row, _ in flashes)})
        return cls(sightings, scenery.plate, flashes, rows)

    def see(self, row: int, picture: ImageArray) -> None:
        """Take from the picture (H, W, 3) of a row what belongs on the poster; it is not written into."""
        if row not in self.rows:
            return
        self.first, self.last = picture if self.first is None else self.first, picture
        balls = [ball for k, ball in self.flashes if k == row]
        self.ghosts += _cut(self.sightings, self.plate, row, picture, balls)

    def write(self, tracks: Tracks, fit: Fit, path: Path, options: RenderOptions = EIGHTFOLD) -> None:
        """Write it as a PNG; ValueError before any picture was seen."""
        if self.first is None or self.last is None:
            raise ValueError("a poster is made of pictures; it was shown none")
        still = self.last.copy()
        annotation = annotate(self.sightings, tracks, fit, self.first, options.slow)
        _draw(still, self.sightings, annotation, self.ghosts, fit)
        encoded, data = cv2.imencode(".png", cv2.cvtColor(still, cv2.COLOR_RGB2BGR))
        if not encoded:
            height, width = still.shape[:2]
            raise ClipError(f"the poster {path.name} was to be a PNG of {width} x {height} px; it failed")
        path.write_bytes(data.tobytes())


def render_poster(
    clip: Clip, scenery: Scenery, tracks: Tracks, fit: Fit, path: Path, options: RenderOptions = EIGHTFOLD
) -> None:
    """Write the poster of a clip that nobody reads besides."""
    poster = Poster.of(scenery)
    rows = sorted(poster.rows)
    for row, (_, picture) in zip(rows, read_frames(clip, indices=scenery.sightings.frame[rows]), strict=True):
        poster.see(row, picture)
    poster.write(tracks, fit, path, options)


def _flashes(sightings: Sightings) -> list[tuple[int, int]]:
    """Row and ball of every ghost: where a ball has gone on far enough since the last."""
    flashes = []
    for ball in np.flatnonzero(sightings.moves.any(axis=0)):
        rows = np.flatnonzero(sightings.moves[:, ball])
        last = sightings.centre[-1, ball]
        placed = [last] if np.isfinite(last).all() else []
        for row in rows:
            place, radius = sightings.centre[row, ball], float(sightings.radius[row, ball])
            if not sightings.observed[row, ball] or not np.isfinite(radius):
                continue
            if all(np.linalg.norm(place - other) > APART_RADII * radius for other in placed):
                placed.append(place)
                flashes.append((int(row), int(ball)))
    return flashes


def _cut(
    sightings: Sightings, plate: Plate, row: int, picture: ImageArray, balls: Sequence[int]
) -> list[tuple[Sprite, FloatArray]]:
    """Sprites of some balls of a picture, and where they were, in pixels of the last picture."""
    others = [int(b) for b in np.flatnonzero(np.isfinite(sightings.centre[row, :, 0])) if b not in balls]
    outlines, stay = ([sightings.outline(row, ball) for ball in group] for group in (balls, others))
    peeled = peel(picture, outlines, stay, plate, sightings.motion(float(sightings.t[row])))
    end = float(sightings.t[-1])
    xy = sightings.scene.camera.to_table(
        sightings.centre[row], sightings.scene.table.ball_radius,
        None if sightings.scene.camera.motion is None else int(sightings.frame[row]),
    )  # fmt: skip
    places = sightings.project(xy, end)
    return [(sprite, places[ball]) for sprite, ball in zip(peeled.sprites, balls, strict=True) if sprite is not None]


def _draw(
    still: ImageArray,
    sightings: Sightings,
    annotation: Annotation,
    ghosts: Sequence[tuple[Sprite, FloatArray]],
    fit: Fit,
) -> None:
    """Lay ghosts, ways, contacts, names and the plan over the last picture."""
    end = float(sightings.t[-1])
    for sprite, place in ghosts:
        paste(still, [[Layer(sprite, place[None], GHOST)]])
    count = len(annotation.paths)
    centre = sightings.centre[-1]
    none = np.zeros(count, dtype=bool)
    balls = Balls(centre, sightings.radius[-1], np.zeros(count), np.zeros((count, 2)), none, none, ~none)
    free = uncovered(still.shape, balls)
    for ball, path in enumerate(annotation.paths):
        if len(path.t):
            way = sightings.project(path.xy, end)
            width = float(np.clip(0.3 * path.radius, 2.0, 6 * annotation.scale))
            draw_trail(still, way, np.full(len(way), 0.9), annotation.halos[ball], width, free)
    left, top = (round(v) for v in annotation.inset_place[:2])
    paths = [path.xy for path in annotation.paths]
    annotation.inset.draw(still, left, top, fit.trajectory.at(end).xy, paths, annotation.colours)
    _write(still, sightings, annotation, balls)


def _ways(sightings: Sightings, annotation: Annotation, t: float) -> list[Rect]:
    """Small squares along the ways: labels had better not cover them."""
    half = 4 * annotation.scale
    places = sightings.project(np.concatenate([path.xy[::8] for path in annotation.paths]), t)
    return [(float(x) - half, float(y) - half, 2 * half, 2 * half) for x, y in places]


def _write(still: ImageArray, sightings: Sightings, annotation: Annotation, balls: Balls) -> None:
    """Contacts with their times, and names where the balls started."""
    end, scale = float(sightings.t[-1]), annotation.scale
    bounds = (still.shape[1], still.shape[0])
    taken: list[Rect] = [annotation.inset_place, *balls.boxes(0.3), *_ways(sightings, annotation, end)]
    order = sorted(annotation.marks, key=lambda mark: (-mark.strength, mark.t))[:MOST_TIMES]
    times = [(mark.label, sightings.project(mark.xy, end)) for mark in order]
    names = []
    for mark in annotation.marks:
        spot = sightings.project(mark.xy, end)
        draw_disc(still, spot, 3.4 * scale, INK, 0.8)
        draw_disc(still, spot, 2.3 * scale, FLASH)
    for ball, path in enumerate(annotation.paths):
        if len(path.t):
            start = sightings.project(path.xy[0], end)
            draw_ring(still, start, path.radius + 2.5 * scale, 1.6 * scale, WHITE, 0.8)
            names.append((Label(annotation.names[ball], "", annotation.colours[ball]), start))
    things = len(taken)
    for label, spot in [*names, *times]:
        size = label.size(scale)
        corner = spot + place_label(size, spot, 12 * scale, np.zeros(2), taken, bounds, None).corner(size, 12 * scale)
        rect = (float(corner[0]), float(corner[1]), float(size[0]), float(size[1]))
        if covered_share(rect, taken) < MOST_COVERED and covered_share(rect, taken[things:]) < MOST_WORDS:
            label.draw(still, corner, scale)
            taken.append(rect)
