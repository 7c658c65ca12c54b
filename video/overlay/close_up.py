"""One moment magnified: the picture with the fitted outlines of the balls, and a strip of those around it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import FLASH, INK, MIST, WHITE, Colour
from video.drawing.text import lay, rounded_mask, text_mask, write
from video.overlay.frame_overlay import draw_ring, fixed

SIZE = (960, 720)
"""px of a close-up."""
TILE, CAPTION = (320, 320), (190, 46)
"""px of one picture of a strip, and of what is written on it."""
AROUND = 2.6
"""ball radii that are shown around the balls."""
LARGEST = 24.0
"""times: pixels are not magnified further."""
DASHES = 36
RINGS: tuple[Colour, Colour] = ((96, 214, 255), (255, 150, 110))
SHIFT = 4
"""Binary digits after the point of OpenCV's sub-pixel coordinates."""


@dataclass(frozen=True, slots=True)
class Outline:
    """A ball as it was fitted: centre (2,) and radius in px of the picture."""

    name: str
    centre: FloatArray
    radius: float


@dataclass(frozen=True, slots=True)
class Scenery:
    """A picture (H, W, 3), its number and time (s), and the balls that matter."""

    picture: ImageArray
    frame: int
    t: float
    outlines: tuple[Outline, ...]
    moment: tuple[Outline, ...] = ()
    """The same balls at the moment in question."""
    line: FloatArray | None = None
    """(n, 2) px, a line on the table that the question is about, at the height of the centres."""


def close_up(scene: Scenery, caption: str, lines: Sequence[str]) -> ImageArray:
    """The balls magnified, their outlines and the gap between them, and what is called."""
    view, scale, corner = _magnified(scene, SIZE, _window([scene]))
    _draw_line(view, scene, scale, corner, 2)
    for outline in scene.moment:
        draw_ring(view, scale * (outline.centre - corner), scale * outline.radius, 1.5, WHITE, 0.7, DASHES)
    _draw_balls(view, scene, scale, corner, 2.0)
    _draw_gap(view, scene, scale, corner)
    _label(view, scene, scale, corner)
    lines = [*lines, f"shown: picture {scene.frame} at {scene.t:.4f} s", "dashed: the moment called"]
    height = 56 + 24 * len(lines)
    top = SIZE[1] - height - 20
    lay(view, rounded_mask(380, height, 12), 20, top, INK, 0.82)
    write(view, caption, 36, top + 8, 26, WHITE, bold=True)
    for row, line in enumerate(lines):
        write(view, line, 36, top + 46 + 24 * row, 17, MIST)
    return view


def strip(scenes: Sequence[Scenery], t: float) -> ImageArray:
    """Pictures around the moment t (s), side by side, all of one place and scale."""
    window = _window(scenes)
    left, top = _free_corner(scenes, window)
    tiles = []
    for scene in scenes:
        view, scale, corner = _magnified(scene, TILE, window)
        _draw_line(view, scene, scale, corner, 1)
        _draw_balls(view, scene, scale, corner, 1.4)
        lay(view, rounded_mask(*CAPTION, 8), left, top, INK, 0.8)
        write(view, f"picture {scene.frame}", left + 10, top + 2, 16, WHITE, bold=True)
        write(view, f"{scene.t:.4f} s  {1e3 * (scene.t - t):+.1f} ms", left + 10, top + 22, 14, MIST)
        tiles.append(view)
    gap = np.full((TILE[1], 4, 3), INK, dtype=np.uint8)
    row = [part for tile in tiles for part in (tile, gap)][:-1]
    return np.concatenate(row, axis=1)


def _free_corner(scenes: Sequence[Scenery], window: tuple[FloatArray, FloatArray]) -> tuple[int, int]:
    """Left and top, px of a tile, where the caption hides the fewest balls of a strip, in the same place on all."""
    scale, corner = _view(TILE, window)
    far = (TILE[0] - CAPTION[0] - 10, TILE[1] - CAPTION[1] - 10)
    places = [(10, 10), (10, far[1]), (far[0], 10), (far[0], far[1])]

    def hidden(place: tuple[int, int]) -> int:
        count = 0
        for outline in (outline for scene in scenes for outline in scene.outlines):
            centre, reach = scale * (outline.centre - corner), scale * outline.radius
            nearest = np.clip(centre, place, np.add(place, CAPTION))
            count += bool(np.hypot(*(centre - nearest)) < reach)
        return count

    return min(places, key=hidden)


def _window(scenes: Sequence[Scenery]) -> tuple[FloatArray, FloatArray]:
    """Middle (2,) and least extent (2,) in px that shows all balls of all pictures; all of it without balls."""
    outlines = [outline for scene in scenes for outline in scene.outlines]
    if not outlines:
        height, width = scenes[0].picture.shape[:2]
        return np.array([width, height]) / 2, np.array([width, height], dtype=np.float64)
    low = np.min([o.centre - AROUND * o.radius for o in outlines], axis=0)
    high = np.max([o.centre + AROUND * o.radius for o in outlines], axis=0)
    return (low + high) / 2, high - low


def _view(size: tuple[int, int], window: tuple[FloatArray, FloatArray]) -> tuple[float, FloatArray]:
    """Magnification of a window to `size`, and the window's corner (2,) in the picture."""
    middle, extent = window
    scale = float(min(np.min(np.array(size) / extent), LARGEST))
    return scale, middle - np.array(size) / (2 * scale)


def _magnified(
    scene: Scenery, size: tuple[int, int], window: tuple[FloatArray, FloatArray]
) -> tuple[ImageArray, float, FloatArray]:
    """The picture around a window, magnified to `size`; px per px, and the window's corner (2,) in the picture."""
    scale, corner = _view(size, window)
    # pixel centres are whole numbers in both pictures
    to_view = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    way = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    view = cv2.warpAffine(scene.picture, to_view, size, flags=way, borderMode=cv2.BORDER_CONSTANT, borderValue=INK)
    return np.ascontiguousarray(view, dtype=np.uint8), scale, corner


def _draw_line(view: ImageArray, scene: Scenery, scale: float, corner: FloatArray, width: int) -> None:
    if scene.line is None:
        return
    mask = np.zeros(view.shape[:2], dtype=np.uint8)
    way = np.clip(scale * (scene.line - corner), -1e5, 1e5)  # what lies far outside the view fits no fixed-point number
    cv2.polylines(mask, [fixed(way).reshape(-1, 1, 2)], False, 255, width, cv2.LINE_AA, SHIFT)
    lay(view, mask, 0, 0, FLASH)


def _draw_balls(view: ImageArray, scene: Scenery, scale: float, corner: FloatArray, width: float) -> None:
    for k, outline in enumerate(scene.outlines):
        centre = scale * (outline.centre - corner)
        draw_ring(view, centre, scale * outline.radius, width, RINGS[k % 2], 0.95)
        draw_ring(view, centre, 2.0, width, RINGS[k % 2], 0.95)


def _draw_gap(view: ImageArray, scene: Scenery, scale: float, corner: FloatArray) -> None:
    """The line of centres, bright between the two surfaces."""
    if len(scene.outlines) != 2:
        return
    one, two = scene.outlines
    apart = two.centre - one.centre
    n = apart / max(float(np.hypot(*apart)), 1e-9)
    ends = (one.centre, one.centre + one.radius * n, two.centre - two.radius * n, two.centre)
    points = [fixed(scale * (end - corner)).tolist() for end in ends]
    mask = np.zeros(view.shape[:2], dtype=np.uint8)
    cv2.line(mask, points[0], points[3], 120, 1, cv2.LINE_AA, SHIFT)
    lay(view, mask, 0, 0, WHITE)
    mask[:] = 0
    cv2.line(mask, points[1], points[2], 255, 4, cv2.LINE_AA, SHIFT)
    lay(view, mask, 0, 0, FLASH)


def _label(view: ImageArray, scene: Scenery, scale: float, corner: FloatArray) -> None:
    """Names above the balls, below the lower one, so that none hides the gap."""
    lowest = max((outline.centre[1] for outline in scene.outlines), default=0.0)
    for k, outline in enumerate(scene.outlines):
        width = text_mask(outline.name, 17, True).shape[1]
        below = len(scene.outlines) > 1 and outline.centre[1] == lowest
        away = scale * outline.radius + 8 if below else -scale * outline.radius - 34
        x, y = scale * (outline.centre - corner) + [-width / 2, away]
        lay(view, rounded_mask(width + 14, 26, 6), round(x) - 7, round(y), INK, 0.75)
        write(view, outline.name, x, y + 2, 17, RINGS[k % 2], bold=True)
