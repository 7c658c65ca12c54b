"""The table seen from above: a small plan with balls and paths."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Scene, Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import INK, WHITE, Colour, lab_to_rgb, mix
from video.drawing.text import rounded_mask
from video.io.pixel_kernels import lay_over

RAIL_SHARE = 0.055
"""Width of the rails of the plan, share of the table's length."""
SUPERSAMPLE = 2
"""The plan is drawn so many times larger and reduced: anti-aliasing that is even."""
BALL_GROWTH = 1.35
"""Balls of the plan are drawn larger than life, to be seen."""
WOOD: Colour = (58, 44, 36)
SHIFT = 4
"""Binary digits after the point of OpenCV's sub-pixel coordinates."""


@dataclass(frozen=True, slots=True)
class Inset:
    """A plan of the table that stands as the table stands in the picture."""

    ground: ImageArray
    """(h, w, 3), `SUPERSAMPLE` times the final size."""
    to_plan: FloatArray
    """(2, 3) affine: metres to px of `ground`."""
    ball_radius: float
    """px of `ground`"""

    @property
    def size(self) -> tuple[int, int]:
        """Final width and height, px."""
        return self.ground.shape[1] // SUPERSAMPLE, self.ground.shape[0] // SUPERSAMPLE

    def plan(self, xy: FloatArray) -> NDArray[np.int32]:
        """Points (..., 2) in m to fixed-point px of `ground`."""
        px = xy @ self.to_plan[:, :2].T + self.to_plan[:, 2]
        return np.asarray(np.rint(px * (1 << SHIFT)), dtype=np.int32)

    def draw(
        self,
        picture: ImageArray,
        x: int,
        y: int,
        xy: FloatArray,
        paths: Sequence[FloatArray],
        colours: Sequence[Colour],
    ) -> None:
        """Lay the plan over `picture` at (x, y): balls at `xy` (N, 2) m, NaN if absent, their paths (n, 2) m so far."""
        tile = self.ground.copy()
        for path, colour in zip(paths, colours, strict=True):
            self.add_path(tile, path, colour)
        self.lay(picture, x, y, tile, xy, colours)

    def add_path(self, tile: ImageArray, path: FloatArray, colour: Colour) -> None:
        """Draw a path (n, 2) m on a copy of `ground`, in place."""
        if len(path) > 1:
            line = self.plan(path).reshape(-1, 1, 2)
            cv2.polylines(tile, [line], False, mix(colour, WHITE, 0.35), SUPERSAMPLE + 1, cv2.LINE_AA, SHIFT)

    def lay(
        self, picture: ImageArray, x: int, y: int, tile: ImageArray, xy: FloatArray, colours: Sequence[Colour]
    ) -> None:
        """Lay a copy of `ground` with paths on it over `picture` at (x, y), with balls at `xy` (N, 2) m."""
        tile = tile.copy()
        radius, known = round(self.ball_radius * (1 << SHIFT)), np.atleast_1d(np.isfinite(xy).all(axis=1))
        centres = self.plan(np.where(known[:, None], xy, 0)).tolist()
        for centre, colour, there in zip(centres, colours, known, strict=True):
            if there:
                cv2.circle(tile, centre, radius + (1 << SHIFT), mix(INK, colour, 0.15), -1, cv2.LINE_AA, SHIFT)
                cv2.circle(tile, centre, radius, colour, -1, cv2.LINE_AA, SHIFT)
        width, height = self.size
        small = cv2.resize(tile, (width, height), interpolation=cv2.INTER_AREA)
        corner = max(3, height // 24)
        cover = rounded_mask(width, height, corner) * np.float32(1 / 255)
        picture[y + corner : y + height - corner, x : x + width] = small[corner:-corner]
        for rows in (slice(0, corner), slice(height - corner, height)):  # round corners alone let anything through
            lay_over(picture, small[rows], cover[rows], x, y + rows.start, 1.0)


def plan_of(scene: Scene, longest: int) -> Inset:
    """A plan whose longer side has `longest` px and stands as the table stands in the picture."""
    return furnished(scene.table, lab_to_rgb(scene.cloth_lab), _stands(scene), longest)


def furnished(table: Table, cloth: Colour, upright: bool, longest: int) -> Inset:
    """An empty table from above, its longer side `longest` px; `upright`: x runs down."""
    rail = RAIL_SHARE * table.length
    scale = longest * SUPERSAMPLE / (table.length + 2 * rail)
    sides = (table.length, table.width)
    long_px, short_px = (round((side + 2 * rail) * scale / SUPERSAMPLE) * SUPERSAMPLE for side in sides)
    if upright:
        to_plan = np.array([[0.0, -scale, (table.width + rail) * scale], [scale, 0.0, rail * scale]])
        shape = (long_px, short_px)
    else:
        to_plan = np.array([[scale, 0.0, rail * scale], [0.0, scale, rail * scale]])
        shape = (short_px, long_px)
    radius = max(BALL_GROWTH * table.ball_radius * scale, 2.2 * SUPERSAMPLE)
    inset = Inset(np.full((*shape, 3), WOOD, dtype=np.uint8), to_plan, radius)
    _furnish(inset, table, cloth, scale)
    return inset


def _stands(scene: Scene) -> bool:
    """True where the table's longer side stands nearer to vertical in the picture."""
    middle = np.array([[0.5, 0.5], [0.51, 0.5]]) * [scene.table.length, scene.table.width]
    step = np.diff(scene.camera.to_pixels(middle, 0.0), axis=0)[0]
    return bool(abs(step[1]) > abs(step[0]))


def _furnish(inset: Inset, table: Table, cloth: Colour, scale: float) -> None:
    """Draw cushions, cloth, diamonds and pockets."""
    rail = RAIL_SHARE * table.length
    nose = 0.35 * rail
    for grow, colour in ((nose, mix(cloth, INK, 0.35)), (0.0, mix(cloth, INK, 0.08))):
        corners = np.array([[-grow, -grow], [table.length + grow, table.width + grow]])
        low, high = (inset.plan(corner) for corner in corners)
        cv2.rectangle(inset.ground, low.tolist(), high.tolist(), colour, -1, cv2.LINE_AA, SHIFT)
    pockets = table.pocket_centres
    for diamond in _diamonds(table, 0.67 * rail):
        if not len(pockets) or np.linalg.norm(pockets - diamond, axis=1).min() > 1.5 * rail:
            cv2.circle(inset.ground, inset.plan(diamond).tolist(), 2 << SHIFT, (214, 206, 190), -1, cv2.LINE_AA, SHIFT)
    for pocket in pockets:
        radius = round(2.1 * table.ball_radius * scale * (1 << SHIFT))
        cv2.circle(inset.ground, inset.plan(pocket).tolist(), radius, INK, -1, cv2.LINE_AA, SHIFT)


def _diamonds(table: Table, away: float) -> FloatArray:
    """Marks on the rails (n, 2) m: eighths of the length and fourths of the width, `away` outside the noses."""
    eighths, fourths = np.arange(1, 8) * table.length / 8, np.arange(1, 4) * table.width / 4
    rows = [np.column_stack([eighths, np.full(7, y)]) for y in (-away, table.width + away)]
    columns = [np.column_stack([np.full(3, x), fourths]) for x in (-away, table.length + away)]
    return np.concatenate(rows + columns)
