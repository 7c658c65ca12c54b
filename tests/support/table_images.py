"""Synthetic images of tables for tests: raised cushions, a cloth, pockets and balls through a pinhole camera."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np

from models.core.scene import NOSE_HEIGHT_RADII, Camera, Table, apply_homography
from models.core.typing import FloatArray, ImageArray

OVER = 2
"""Factor by which images are drawn larger and then reduced."""
CUSHION = 0.05
"""m, width of the cloth on a cushion."""
RAIL = 0.13
"""m, width of the wood around it."""


@dataclass(frozen=True)
class TableColours:
    """Colours (RGB) of a table."""

    cloth: tuple[int, int, int] = (30, 140, 90)
    cushion: float = 0.93
    shadow: float = 0.55
    wood: tuple[int, int, int] = (95, 60, 35)
    floor: tuple[int, int, int] = (120, 118, 112)
    noise: float = 3.0


def look_at_table(
    table: Table, focal: float, size: tuple[int, int], place: FloatArray, target: FloatArray, roll: float
) -> Camera:
    """Make a camera at `place` (3,) m that looks at `target` (3,), rolled by `roll` rad; its images have `size` px.

    The table's axes are x right, y down, z up as seen from above, so they are left-handed.
    """
    forward = target - place
    forward /= np.linalg.norm(forward)
    down = np.array([np.sin(roll), np.cos(roll), 0.0])
    down -= forward * (down @ forward)
    down /= np.linalg.norm(down)
    right = -np.cross(down, forward)  # left-handed world
    rotation = np.stack([right, down, forward])
    centre = np.array([(size[0] - 1) / 2, (size[1] - 1) / 2])
    k = np.array([[focal, 0, centre[0]], [0, focal, centre[1]], [0, 0, 1.0]])
    matrix = k @ np.column_stack([rotation, -rotation @ place])
    corners = np.zeros((4, 2))
    camera = Camera(matrix, size[0], size[1], corners, np.eye(8), "noses", float(place[2]), 0.0)
    corners_px = camera.to_pixels(table.corners, NOSE_HEIGHT_RADII * table.ball_radius)
    return Camera(matrix, size[0], size[1], corners_px, np.eye(8), "noses", float(place[2]), 0.0)


def draw_table(
    table: Table,
    camera: Camera,
    look: TableColours,
    balls: FloatArray | None = None,
    rng: np.random.Generator | None = None,
) -> ImageArray:
    """Draw a table, RGB (H, W, 3), with balls at (N, 2) m."""
    canvas = np.empty((camera.height_px * OVER, camera.width_px * OVER, 3), np.uint8)
    canvas[:] = look.floor
    nose = NOSE_HEIGHT_RADII * table.ball_radius
    cloth = np.array(look.cloth, np.float64)
    _fill_polygon(canvas, camera, _expand_corners(table, CUSHION + RAIL), nose, look.wood)
    _fill_polygon(canvas, camera, _expand_corners(table, CUSHION), nose, tuple(look.cushion * cloth))
    bed = canvas.copy()
    _fill_polygon(bed, camera, _expand_corners(table, 8 * CUSHION), 0.0, tuple(look.shadow * cloth))
    _fill_polygon(bed, camera, _expand_corners(table, -0.012), 0.0, tuple(cloth))
    # The bed is visible through the opening between the noses: near cushions hide its edge, far ones show their face.
    opening = np.zeros_like(canvas)
    _fill_polygon(opening, camera, table.corners, nose, (255, 255, 255))
    canvas = np.where(opening > 127, bed, canvas)
    for x, y in table.pocket_centres:
        reach = 0.012 if x in (0.0, table.length) else 0.035
        centre = np.array([x + np.sign(x - table.length / 2) * reach * (x != table.length / 2), y])
        centre[1] += np.sign(y - table.width / 2) * reach
        _draw_disc(canvas, camera, centre, nose, 0.062, (12, 12, 14))
    for index, (x, y) in enumerate(balls if balls is not None else []):
        colour = ((235, 230, 215), (190, 25, 30), (230, 180, 20), (25, 60, 160))[index % 4]
        _draw_ball(canvas, camera, np.array([x, y]), table.ball_radius, colour)
    small = cv2.resize(canvas, (camera.width_px, camera.height_px), interpolation=cv2.INTER_AREA)
    image = np.asarray(cv2.GaussianBlur(small, (0, 0), 0.6), np.uint8)
    if rng is None:
        return image
    noisy = image + rng.normal(0, look.noise, image.shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


def _expand_corners(table: Table, margin: float) -> FloatArray:
    return table.corners + margin * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])


def _fill_polygon(canvas: ImageArray, camera: Camera, polygon: FloatArray, z: float, colour: tuple[float, ...]) -> None:
    px = (camera.to_pixels(polygon, z) + 0.5) * OVER - 0.5
    cv2.fillPoly(canvas, [np.rint(px * 16).astype(np.int32)], colour, cv2.LINE_AA, 4)


def _draw_disc(
    canvas: ImageArray, camera: Camera, centre: FloatArray, z: float, radius: float, colour: tuple[float, ...]
) -> None:
    angles = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    _fill_polygon(canvas, camera, centre + radius * np.column_stack([np.cos(angles), np.sin(angles)]), z, colour)


def _draw_ball(
    canvas: ImageArray, camera: Camera, centre: FloatArray, radius: float, colour: tuple[float, ...]
) -> None:
    """Draw a ball; its outline is nearly a circle from every direction."""
    middle = (camera.to_pixels(centre, radius) + 0.5) * OVER - 0.5
    size = float(camera.radius_px(centre, radius)) * OVER
    x, y = np.rint(middle * 16).astype(int)
    cv2.circle(canvas, (int(x), int(y)), round(size * 16), colour, -1, cv2.LINE_AA, 4)


def write_clip(path: Path, images: list[ImageArray]) -> Path:
    """Write an H.264 clip at 25 fps."""
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=Fraction(25), options={"crf": "16", "preset": "ultrafast"})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p"
        for image in images:
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode())
    return path


def corner_error(located: FloatArray, true: FloatArray) -> float:
    """Return the largest distance (px) between corresponding corners."""
    return float(np.linalg.norm(located - true, axis=1).max())


def warp_image(image: ImageArray, homography: FloatArray) -> ImageArray:
    """Warp an image to a camera that moved by `homography` (3, 3), source to moved pixels."""
    size = (image.shape[1], image.shape[0])
    return np.asarray(cv2.warpPerspective(image, homography, size, borderMode=cv2.BORDER_REPLICATE), np.uint8)


def small_motion(angle: float, shift: tuple[float, float], tilt: float) -> FloatArray:
    """Return a homography (3, 3) of a hand-held camera: rotation (rad), shift (px) and tilt (1/px)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, shift[0]], [sine, cosine, shift[1]], [tilt, 0.4 * tilt, 1.0]])


__all__ = [
    "TableColours",
    "apply_homography",
    "corner_error",
    "draw_table",
    "look_at_table",
    "small_motion",
    "warp_image",
    "write_clip",
]
