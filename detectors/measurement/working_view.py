"""The working image: the table, cropped and scaled so that the balls of every clip are about equally large.

All searches run on it, so their cost depends on the table and not on the resolution of the clip. The reference image is
the one that the camera calibration refers to; with a moving camera, frames differ from it by a homography.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import POCKETS, Camera, Scene, Table, apply_homography
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

# Approximate radius of a ball in the working image, which is the reference image divided by a whole number.
WORKING_RADIUS_PX = 7.5
# Least radius of a ball in the image that a network searches. In 15 rendered clips with smaller balls it misses 56 of
# 594, in the same clips at twice the size 6, and in 25 with larger ones 2 of 864.
MIN_SEEN_RADIUS_PX = 5.5
# Distance, ball radii, by which a centre may appear beyond that of a ball at the cushion: calibration errors.
CUSHION_SLACK_RADII = 0.55
# Distance from a pocket's centre within which a ball may be between the jaws, up to the line of the noses.
JAW_RADII = 2.6
# Distance from the intersection of the noses' lines, or from the middle of a side, within which a ball has dropped.
CORNER_HOLE_RADII, SIDE_HOLE_RADII = 1.4, 0.7
# Reach of a pocket's opening about its centre, on the table.
POCKET_RADII = 3.0
# The same in the image: the lining is upright, and in a low view it hides far more of the cloth.
POCKET_IMAGE_RADII = 1.5
# Margin of the working image around the outermost centres.
MARGIN_RADII = 1.8


@dataclass(frozen=True, slots=True)
class WorkingView:
    """The working image (h, w) of a scene and its masks; `scale` is in working px per px of the reference image."""

    scene: Scene
    box: tuple[int, int, int, int]
    """x0, y0, x1, y1 px: the part of the reference image it shows."""
    scale: float
    radius: Float32Array
    """(h, w) working px: radius of a ball whose centre appears there."""
    median_radius: float
    """Working px: median of `radius`."""
    centre_area: BoolArray
    """(h, w) where the centre of a ball on the table may be."""
    pocket_area: BoolArray
    """(h, w) where a centre is at a pocket, which appears as a dark shape."""
    cloth_area: BoolArray
    """(h, w) the playing surface."""
    ball_area: BoolArray
    """(h, w) where balls can cover the image."""
    border: BoolArray
    """(h, w) the outermost pixels of `ball_area`, and everything beyond."""

    @property
    def enlargement(self) -> int:
        """Factor by which the working image is enlarged for a network, which would miss smaller balls."""
        return max(1, int(np.ceil(MIN_SEEN_RADIUS_PX / self.median_radius)))

    def to_reference(self, working: FloatArray) -> FloatArray:
        """Working px (..., 2) to px of the reference image."""
        px: FloatArray = (working + 0.5) / self.scale - 0.5 + np.array(self.box[:2], dtype=float)
        return px

    def to_working(self, px: FloatArray) -> FloatArray:
        """Reference px (..., 2) to working px."""
        working: FloatArray = (px - np.array(self.box[:2], dtype=float) + 0.5) * self.scale - 0.5
        return working

    def reference_to_frame(self, px: FloatArray, frame: int) -> FloatArray:
        """Px (n, 2) of the reference image to px of a frame."""
        motion = self.scene.camera.motion_of(frame)
        return px if motion is None else apply_homography(motion, px)

    def working_to_frame(self, working: FloatArray, frame: int) -> FloatArray:
        """Working px (n, 2) to px of a frame."""
        return self.reference_to_frame(self.to_reference(working), frame)

    def frame_to_working(self, px: FloatArray, frame: int) -> FloatArray:
        """Px (n, 2) of a frame to working px."""
        motion = self.scene.camera.motion_of(frame)
        return self.to_working(px if motion is None else apply_homography(np.asarray(np.linalg.inv(motion)), px))

    def working_image(self, rgb: ByteArray, frame: int | None = None) -> ByteArray:
        """Compute the working image (h, w, 3) of an image (H, W, 3) of a frame."""
        h, w = self.radius.shape
        x0, y0, x1, y1 = self.box
        motion = None if frame is None else self.scene.camera.motion_of(frame)
        if motion is not None:
            return self._warp_frame(rgb, motion)
        crop = rgb[y0:y1, x0:x1]
        if crop.shape[:2] == (h, w):
            return np.ascontiguousarray(crop)
        return np.asarray(cv2.resize(crop, (w, h), interpolation=cv2.INTER_AREA), dtype=np.uint8)

    def enlarge_part(self, rgb: ByteArray, frame: int | None, part: tuple[slice, slice], factor: float) -> ByteArray:
        """Compute a part of the working image at a higher resolution.

        Args:
            rgb: Image (H, W, 3).
            frame: Number of the frame; None for the reference image.
            part: Rows and columns of the working image.
            factor: Approximate enlargement.

        Returns:
            Image (h, w, 3).
        """
        rows, columns = part
        size = round((columns.stop - columns.start) * factor), round((rows.stop - rows.start) * factor)
        motion = None if frame is None else self.scene.camera.motion_of(frame)
        if motion is not None:
            grown = np.array([size[0] / (columns.stop - columns.start), size[1] / (rows.stop - rows.start)])
            shift = (0.5 - np.array([columns.start, rows.start])) * grown - 0.5
            matrix = np.diag([*grown, 1.0]) + np.column_stack([np.zeros((3, 2)), [*shift, 0.0]])
            matrix = matrix @ self._frame_to_working_matrix(motion)
            return np.asarray(cv2.warpPerspective(rgb, matrix, size, flags=cv2.INTER_LINEAR), dtype=np.uint8)
        (x0, y0, _, _), s = self.box, self.scale
        left, right = x0 + round(columns.start / s), x0 + round(columns.stop / s)
        top, bottom = y0 + round(rows.start / s), y0 + round(rows.stop / s)
        way = cv2.INTER_AREA if size[0] < right - left else cv2.INTER_LINEAR
        return np.asarray(cv2.resize(rgb[top:bottom, left:right], size, interpolation=way), dtype=np.uint8)

    def _warp_frame(self, rgb: ByteArray, motion: FloatArray) -> ByteArray:
        h, w = self.radius.shape
        matrix = self._frame_to_working_matrix(motion)
        return np.asarray(cv2.warpPerspective(rgb, matrix, (w, h), flags=cv2.INTER_LINEAR), dtype=np.uint8)

    def _frame_to_working_matrix(self, motion: FloatArray) -> FloatArray:
        """Homography (3, 3) from px of a frame to working px; `motion` (3, 3) takes reference px to the frame's."""
        s, (x0, y0) = self.scale, self.box[:2]
        to_working = np.array([[s, 0, (0.5 - x0) * s - 0.5], [0, s, (0.5 - y0) * s - 0.5], [0, 0, 1.0]])
        return np.asarray(to_working @ np.linalg.inv(motion))

    def is_centre_near(self, places: FloatArray, reach: FloatArray) -> BoolArray:
        """Where (h, w) the centre of a ball is within its reach (n,) m of one of some places (n, 2) of the table."""
        h, w = self.radius.shape
        px = _reference_grid(self.box, self.scale, w, h)
        xy = self.scene.camera.to_table(px, self.scene.table.ball_radius)
        near = [_is_within_reach(xy, *one) for one in zip(places, np.maximum(reach, 0.0).tolist(), strict=True)]
        return np.asarray(np.any(near, axis=0))

    def predict_radius(self, px: FloatArray) -> FloatArray:
        """Radius (...) px of a ball that appears at reference px (..., 2)."""
        return predict_radius(self.scene, px)


def nearest_pixels(shape: tuple[int, ...], working: FloatArray) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Nearest pixels of places.

    Args:
        shape: Shape (h, w, ...) of the image.
        working: Places (..., 2), px.

    Returns:
        Rows (...) and columns (...), inside the image.
    """
    h, w = shape[:2]
    column = np.clip(np.rint(working[..., 0]).astype(int), 0, w - 1)
    row = np.clip(np.rint(working[..., 1]).astype(int), 0, h - 1)
    return row, column


def values_at(image: NDArray[Any], working: FloatArray) -> NDArray[Any]:
    """Values of an image at the nearest pixels of places.

    Args:
        image: Image (h, w, ...).
        working: Places (n, 2), px; those outside get the value of the border.

    Returns:
        Values (n, ...).
    """
    return np.asarray(image[nearest_pixels(image.shape, working)])


def build_view(scene: Scene) -> WorkingView:
    """Build the view of a scene.

    Args:
        scene: Table and camera.

    Returns:
        The working image's geometry and masks.
    """
    camera, table = scene.camera, scene.table
    box = _bounding_box(camera, table)
    middle = float(camera.radius_px(np.array([table.length / 2, table.width / 2]), table.ball_radius))
    shrink = max(1, round(middle / WORKING_RADIUS_PX))
    w, h = (box[2] - box[0]) // shrink, (box[3] - box[1]) // shrink
    box = (box[0], box[1], box[0] + w * shrink, box[1] + h * shrink)
    scale = 1.0 / shrink
    px = _reference_grid(box, scale, w, h)
    at_centres = camera.to_table(px, table.ball_radius)
    centres = _is_possible_centre(table, at_centres)
    pockets = np.zeros((h, w), dtype=bool)
    for pocket in table.pocket_centres:
        pockets |= _is_within_reach(at_centres, pocket, POCKET_RADII * table.ball_radius)
        pocket_px = camera.to_pixels(pocket, table.ball_radius)
        pockets |= _is_within_reach(
            px, pocket_px, POCKET_IMAGE_RADII * float(camera.radius_px(pocket, table.ball_radius))
        )
    on_cloth = camera.to_table(px, 0.0)
    cloth = (on_cloth[..., 0] > 0) & (on_cloth[..., 0] < table.length)
    cloth &= (on_cloth[..., 1] > 0) & (on_cloth[..., 1] < table.width)
    radius = _radius_map(scene, box, scale, w, h)
    reach = 2 * int(np.ceil(radius.max() * 1.5)) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (reach, reach))
    area = cv2.dilate(centres.astype(np.uint8), kernel).astype(bool)
    inner = cv2.erode(area.astype(np.uint8), np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=0)
    return WorkingView(
        scene, box, scale, radius, float(np.median(radius[centres])), centres, pockets, cloth, area, inner == 0
    )


def predict_radius(scene: Scene, px: FloatArray) -> FloatArray:
    """Radius (...) px of a ball that appears at reference px (..., 2)."""
    xy = scene.camera.to_table(px, scene.table.ball_radius)
    return np.asarray(scene.camera.radius_px(xy, scene.table.ball_radius), dtype=np.float64)


def _bounding_box(camera: Camera, table: Table) -> tuple[int, int, int, int]:
    outline = camera.to_pixels(table.corners, table.ball_radius)
    margin = MARGIN_RADII * float(camera.radius_px(table.corners, table.ball_radius).max())
    low = np.clip(np.floor(outline.min(axis=0) - margin), 0, None).astype(int)
    high = np.ceil(outline.max(axis=0) + margin).astype(int) + 1
    x1, y1 = min(int(high[0]), camera.width_px), min(int(high[1]), camera.height_px)
    return int(low[0]), int(low[1]), x1, y1


def _reference_grid(box: tuple[int, int, int, int], scale: float, w: int, h: int) -> FloatArray:
    x = (np.arange(w) + 0.5) / scale - 0.5 + box[0]
    y = (np.arange(h) + 0.5) / scale - 0.5 + box[1]
    return np.stack(np.meshgrid(x, y), axis=-1)


def _is_possible_centre(table: Table, xy: FloatArray) -> BoolArray:
    radius = table.ball_radius
    inset = radius * (1 - CUSHION_SLACK_RADII)
    inside = _is_inside_cushions(table, xy, inset)
    for pocket in table.pocket_centres:
        jaws = _is_within_reach(xy, pocket, JAW_RADII * radius)
        inside |= jaws & _is_inside_cushions(table, xy, 0.0)
    for name, pocket in zip(POCKETS, table.pocket_centres, strict=False):
        hole = CORNER_HOLE_RADII if "-" in name else SIDE_HOLE_RADII
        inside &= ~_is_within_reach(xy, pocket, hole * radius)
    return inside


def _is_within_reach(xy: FloatArray, place: FloatArray, reach: float) -> BoolArray:
    """Which points (..., 2) are within a reach of a place (2,)."""
    near: BoolArray = (xy[..., 0] - place[0]) ** 2 + (xy[..., 1] - place[1]) ** 2 < reach**2
    return near


def _is_inside_cushions(table: Table, xy: FloatArray, inset: float) -> BoolArray:
    x, y = xy[..., 0], xy[..., 1]
    within: BoolArray = (x > inset) & (x < table.length - inset) & (y > inset) & (y < table.width - inset)
    return within


def _radius_map(scene: Scene, box: tuple[int, int, int, int], scale: float, w: int, h: int) -> Float32Array:
    """Compute the radius (h, w) in working px on every 16th pixel and interpolate: it changes slowly."""
    step = 16
    coarse = _reference_grid(box, scale / step, -(-w // step), -(-h // step))
    radii = (predict_radius(scene, coarse) * scale).astype(np.float32)
    size = (radii.shape[1] * step, radii.shape[0] * step)
    return np.asarray(cv2.resize(radii, size, interpolation=cv2.INTER_LINEAR)[:h, :w], dtype=np.float32)
