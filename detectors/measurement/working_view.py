"""The table in the working picture: cropped and scaled so that every clip's balls are about equally large.

All searching happens there, so its cost depends on the table and not on the resolution of the clip.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import POCKETS, Camera, Scene, Table
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

WORKING_RADIUS_PX = 7.5
"""Radius of a ball in the working picture, about: it is the whole divided by a whole number."""
CUSHION_SLACK_RADII = 0.55
"""How far beyond its place at the cushion (one radius inside the nose) a centre may be seen: calibration."""
JAW_RADII = 2.6
"""Around a pocket's centre a ball may stand between the jaws, as far as the line of the noses."""
CORNER_HOLE_RADII, SIDE_HOLE_RADII = 1.4, 0.7
"""Nearer than this to where the noses' lines meet, or to the middle of a side, a ball has dropped."""
POCKET_RADII = 3.0
"""Reach of a pocket's opening about its corner."""
POCKET_SEEN_RADII = 1.5
"""The same in the picture: its lining stands upright, and in a low view it hides far more of the cloth."""
MARGIN_RADII = 1.8
"""Picture kept around the place of the outermost centres."""


@dataclass(frozen=True, slots=True)
class View:
    """The working picture of a scene, (h, w) px, `scale` working px per px of the reference picture."""

    scene: Scene
    box: tuple[int, int, int, int]
    """x0, y0, x1, y1 px: the part of the reference picture it shows."""
    scale: float
    radius: Float32Array
    """(h, w) working px: radius of a ball whose centre is seen there."""
    typical: float
    """Working px: median of `radius`."""
    centres: BoolArray
    """(h, w) where the centre of a ball on the table may be."""
    pockets: BoolArray
    """(h, w) where a centre is at a pocket, which is seen as a dark shape of its own."""
    cloth: BoolArray
    """(h, w) the playing surface."""
    area: BoolArray
    """(h, w) what balls can cover."""
    rim: BoolArray
    """(h, w) the outermost pixels of `area`, and what lies beyond."""

    def to_picture(self, working: FloatArray) -> FloatArray:
        """Working px (..., 2) to px of the reference picture."""
        px: FloatArray = (working + 0.5) / self.scale - 0.5 + np.array(self.box[:2], dtype=float)
        return px

    def to_working(self, px: FloatArray) -> FloatArray:
        """Reference px (..., 2) to working px."""
        working: FloatArray = (px - np.array(self.box[:2], dtype=float) + 0.5) * self.scale - 0.5
        return working

    def picture(self, rgb: ByteArray, frame: int | None = None) -> ByteArray:
        """The working picture (h, w, 3) of a whole picture."""
        h, w = self.radius.shape
        x0, y0, x1, y1 = self.box
        motion = self.scene.camera.motion
        if motion is not None and frame is not None:
            return self._followed(rgb, motion[frame])
        crop = rgb[y0:y1, x0:x1]
        if crop.shape[:2] == (h, w):
            return np.ascontiguousarray(crop)
        return np.asarray(cv2.resize(crop, (w, h), interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def enlarged(self, rgb: ByteArray, frame: int | None, part: tuple[slice, slice], factor: float) -> ByteArray:
        """A part (rows, columns) of the working picture of a whole one (H, W, 3), about `factor` times as large."""
        rows, columns = part
        size = round((columns.stop - columns.start) * factor), round((rows.stop - rows.start) * factor)
        motion = self.scene.camera.motion
        if motion is not None and frame is not None:
            grown = np.array([size[0] / (columns.stop - columns.start), size[1] / (rows.stop - rows.start)])
            shift = (0.5 - np.array([columns.start, rows.start])) * grown - 0.5
            matrix = np.diag([*grown, 1.0]) + np.column_stack([np.zeros((3, 2)), [*shift, 0.0]])
            matrix = matrix @ self._from_frame(motion[frame])
            return np.asarray(cv2.warpPerspective(rgb, matrix, size, flags=cv2.INTER_LINEAR), dtype=np.uint8)
        (x0, y0, _, _), s = self.box, self.scale
        left, right = x0 + round(columns.start / s), x0 + round(columns.stop / s)
        top, bottom = y0 + round(rows.start / s), y0 + round(rows.stop / s)
        way = cv2.INTER_AREA if size[0] < right - left else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(rgb[top:bottom, left:right], size, interpolation=way), dtype=np.uint8)

    def _followed(self, rgb: ByteArray, motion: FloatArray) -> ByteArray:
        h, w = self.radius.shape
        matrix = self._from_frame(motion)
        return np.asarray(cv2.warpPerspective(rgb, matrix, (w, h), flags=cv2.INTER_LINEAR), dtype=np.uint8)

    def _from_frame(self, motion: FloatArray) -> FloatArray:
        """Homography (3, 3) from px of a frame to working px; `motion` (3, 3) takes reference px to the frame's."""
        s, (x0, y0) = self.scale, self.box[:2]
        to_working = np.array([[s, 0, (0.5 - x0) * s - 0.5], [0, s, (0.5 - y0) * s - 0.5], [0, 0, 1.0]])
        return np.asarray(to_working @ np.linalg.inv(motion))

    def window(self, part: tuple[slice, slice]) -> View:
        """A part of the working picture, given by its rows and columns, as a view of its own."""
        (x0, y0, _, _), rows, columns = self.box, *part
        left, right = round(columns.start / self.scale), round(columns.stop / self.scale)
        top, bottom = round(rows.start / self.scale), round(rows.stop / self.scale)
        maps = (self.centres, self.pockets, self.cloth, self.area, self.rim)
        return View(
            self.scene,
            (x0 + left, y0 + top, x0 + right, y0 + bottom),
            self.scale,
            self.radius[part],
            self.typical,
            *(each[part] for each in maps),
        )

    def predicted_radius(self, px: FloatArray) -> FloatArray:
        """Radius (...) px of the reference picture that a ball has at reference px (..., 2)."""
        return predicted_radius(self.scene, px)


def pixel_at(shape: tuple[int, ...], working: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column (n,) of the pixel of a picture (h, w) that is nearest to working px (n, 2)."""
    h, w = shape[:2]
    column = np.clip(np.rint(working[..., 0]).astype(int), 0, w - 1)
    row = np.clip(np.rint(working[..., 1]).astype(int), 0, h - 1)
    return row, column


def value_at(mask: NDArray[Any], working: FloatArray) -> NDArray[Any]:
    """Values (n,) of a picture (h, w, ...) at working px (n, 2)."""
    return np.asarray(mask[pixel_at(mask.shape, working)])


def view_of(scene: Scene) -> View:
    """Lay the working picture over a scene."""
    camera, table = scene.camera, scene.table
    box = _box(camera, table)
    middle = float(camera.radius_px(np.array([table.length / 2, table.width / 2]), table.ball_radius))
    shrink = max(1, round(middle / WORKING_RADIUS_PX))
    w, h = (box[2] - box[0]) // shrink, (box[3] - box[1]) // shrink
    box = (box[0], box[1], box[0] + w * shrink, box[1] + h * shrink)
    scale = 1.0 / shrink
    px = _grid(box, scale, w, h)
    at_centres = camera.to_table(px, table.ball_radius)
    centres = _allowed(table, at_centres)
    pockets = np.zeros((h, w), dtype=bool)
    for pocket in table.pocket_centres:
        pockets |= _within_reach(at_centres, pocket, POCKET_RADII * table.ball_radius)
        seen = camera.to_pixels(pocket, table.ball_radius)
        pockets |= _within_reach(px, seen, POCKET_SEEN_RADII * float(camera.radius_px(pocket, table.ball_radius)))
    on_cloth = camera.to_table(px, 0.0)
    cloth = (on_cloth[..., 0] > 0) & (on_cloth[..., 0] < table.length)
    cloth &= (on_cloth[..., 1] > 0) & (on_cloth[..., 1] < table.width)
    radius = _radius_map(scene, box, scale, w, h)
    reach = 2 * int(np.ceil(radius.max() * 1.5)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    area = cv2.dilate(centres.astype(np.uint8), kernel).astype(bool)
    inner = cv2.erode(area.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return View(scene, box, scale, radius, float(np.median(radius[centres])), centres, pockets, cloth, area, inner == 0)


def predicted_radius(scene: Scene, px: FloatArray) -> FloatArray:
    """Radius (...) px of a ball seen at reference px (..., 2)."""
    xy = scene.camera.to_table(px, scene.table.ball_radius)
    return np.asarray(scene.camera.radius_px(xy, scene.table.ball_radius), dtype=np.float64)


def _box(camera: Camera, table: Table) -> tuple[int, int, int, int]:
    outline = camera.to_pixels(table.corners, table.ball_radius)
    margin = MARGIN_RADII * float(camera.radius_px(table.corners, table.ball_radius).max())
    low = np.clip(np.floor(outline.min(axis=0) - margin), 0, None).astype(int)
    high = np.ceil(outline.max(axis=0) + margin).astype(int) + 1
    x1, y1 = min(int(high[0]), camera.width_px), min(int(high[1]), camera.height_px)
    return int(low[0]), int(low[1]), x1, y1


def _grid(box: tuple[int, int, int, int], scale: float, w: int, h: int) -> FloatArray:
    x = (np.arange(w) + 0.5) / scale - 0.5 + box[0]
    y = (np.arange(h) + 0.5) / scale - 0.5 + box[1]
    return np.stack(np.meshgrid(x, y), axis=-1)


def _allowed(table: Table, xy: FloatArray) -> BoolArray:
    radius = table.ball_radius
    inset = radius * (1 - CUSHION_SLACK_RADII)
    inside = _within(table, xy, inset)
    for pocket in table.pocket_centres:
        jaws = _within_reach(xy, pocket, JAW_RADII * radius)
        inside |= jaws & _within(table, xy, 0.0)
    for name, pocket in zip(POCKETS, table.pocket_centres, strict=False):
        hole = CORNER_HOLE_RADII if "-" in name else SIDE_HOLE_RADII
        inside &= ~_within_reach(xy, pocket, hole * radius)
    return inside


def _within_reach(xy: FloatArray, place: FloatArray, reach: float) -> BoolArray:
    """Which points (..., 2) lie within a reach of a place (2,)."""
    near: BoolArray = (xy[..., 0] - place[0]) ** 2 + (xy[..., 1] - place[1]) ** 2 < reach**2
    return near


def _within(table: Table, xy: FloatArray, inset: float) -> BoolArray:
    x, y = xy[..., 0], xy[..., 1]
    within: BoolArray = (x > inset) & (x < table.length - inset) & (y > inset) & (y < table.width - inset)
    return within


def _radius_map(scene: Scene, box: tuple[int, int, int, int], scale: float, w: int, h: int) -> Float32Array:
    """Radius in working px on every 16th pixel, interpolated: it changes slowly."""
    step = 16
    coarse = _grid(box, scale / step, -(-w // step), -(-h // step))
    radii = (predicted_radius(scene, coarse) * scale).astype(np.float32)
    size = (radii.shape[1] * step, radii.shape[0] * step)
    return np.asarray(cv2.resize(radii, size, interpolation=cv2.INTER_LINEAR)[:h, :w], dtype=np.float32)
