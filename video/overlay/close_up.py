"""Magnified views of one moment: a frame with the fitted outlines of the balls, and a strip of neighbouring frames."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from models.core.typing import FloatArray, ImageArray
from video.drawing.label_layout import make_squares, place_panel
from video.drawing.masks import SHIFT, blend_mask, draw_panel, draw_ring, draw_text, round_corner_mask, to_fixed_point
from video.drawing.palette import FLASH, INK, MUTED_GREY, WHITE, Colour
from video.drawing.table_plan import append_footer

# px, size of a close-up.
CLOSE_UP_SIZE = (960, 720)
# px, size of one frame of a strip, and of its caption.
TILE_SIZE, CAPTION_SIZE = (320, 320), (190, 46)
# px, size of the view of a place.
PLACE_SIZE = (480, 360)
# Ball radii shown around the balls.
MARGIN_RADII = 2.6
# Ball radii shown on either side of a place.
PLACE_RADII = 7.0
# Largest magnification of pixels.
MAX_MAGNIFICATION = 24.0
# Dashes of a ring.
DASHES = 36
# Colours of the outlines of the first and of the second ball.
RING_COLOURS: tuple[Colour, Colour] = ((96, 214, 255), (255, 150, 110))


# (2, 2) px, middle and least extent of a part of a frame.
Window = FloatArray


@dataclass(frozen=True, slots=True)
class NamedOutline:
    """Fitted outline of a ball: centre (2,) and radius in px of the frame."""

    name: str
    centre: FloatArray
    radius: float


@dataclass(frozen=True, slots=True)
class CloseUpFrame:
    """A frame (H, W, 3), its index and time (s), and the outlines of the balls concerned."""

    image: ImageArray
    frame: int
    t: float
    outlines: tuple[NamedOutline, ...]
    moment_outlines: tuple[NamedOutline, ...] = ()
    """The same balls at the moment in question."""
    line: FloatArray | None = None
    """(n, 2) px, a line on the table that the question refers to, at the height of the ball centres."""
    shows_line: bool = False
    """Whether the view contains the whole line."""


def draw_close_up(frame: CloseUpFrame, caption: str, lines: Sequence[str]) -> ImageArray:
    """Draw a magnified frame with the outlines of the balls, the gap between them, and the call.

    Args:
        frame: Frame and outlines.
        caption: Answer to the question, the title.
        lines: Further lines of text.

    Returns:
        Image of `CLOSE_UP_SIZE` with the text below it.
    """
    view, scale, corner = _draw_named_balls(frame, CLOSE_UP_SIZE, _enclose_balls([frame]))
    _draw_gap(view, frame, scale, corner)
    lines = [*lines, f"frame {frame.frame} at {frame.t:.4f} s"]
    lines += ["dashed: the moment of the call"] if frame.moment_outlines else []
    return append_footer(view, "\n".join([caption, *lines]))


def draw_frame_strip(frames: Sequence[CloseUpFrame], t: float) -> ImageArray:
    """Draw frames around a moment side by side, at the same place and scale.

    Args:
        frames: Frames and outlines.
        t: The moment, s.

    Returns:
        Image (h, w, 3), one tile per frame.
    """
    window = _enclose_balls(frames)
    left, top = _free_corner(frames, window)
    tiles = []
    for scene in frames:
        view, scale, corner = magnify_image(scene.image, TILE_SIZE, window)
        if scene.line is not None:
            draw_polyline(view, scale * (scene.line - corner), 1)
        _draw_balls(view, scene, scale, corner, 1.4)
        blend_mask(view, round_corner_mask(*CAPTION_SIZE, 8), left, top, INK, 0.8)
        draw_text(view, f"frame {scene.frame}", left + 10, top + 2, 16, WHITE, bold=True)
        draw_text(view, f"{scene.t:.4f} s  {1e3 * (scene.t - t):+.1f} ms", left + 10, top + 22, 14, MUTED_GREY)
        tiles.append(view)
    gap = np.full((TILE_SIZE[1], 4, 3), INK, dtype=np.uint8)
    row = [part for tile in tiles for part in (tile, gap)][:-1]
    return np.concatenate(row, axis=1)


def draw_place(frame: CloseUpFrame, place: FloatArray, radius: float) -> ImageArray:
    """Draw a magnified place of a frame with the outlines and names of the balls; other balls stay plain.

    Args:
        frame: Frame and outlines; those of the moment in question are dashed.
        place: (2,) px, the place.
        radius: Radius of a ball there, px.

    Returns:
        Image of `PLACE_SIZE`.
    """
    reach = np.array([PLACE_RADII * radius, *(MARGIN_RADII * outline.radius for outline in frame.outlines)])
    places = np.stack([place, *(outline.centre for outline in frame.outlines)])
    return _draw_named_balls(frame, PLACE_SIZE, find_window(places, reach[:, None]))[0]


def _draw_named_balls(
    frame: CloseUpFrame, size: tuple[int, int], window: Window
) -> tuple[ImageArray, float, FloatArray]:
    """Draw a window of a frame with the balls, their names and a line; return its magnification and corner too."""
    view, scale, corner = magnify_image(frame.image, size, window)
    if frame.line is not None:
        draw_polyline(view, scale * (frame.line - corner), 2)
    for outline in frame.moment_outlines:
        draw_ring(view, scale * (outline.centre - corner), scale * outline.radius, 1.5, WHITE, 0.7, DASHES)
    _draw_balls(view, frame, scale, corner, 2.0)
    _draw_ball_names(view, frame, scale, corner)
    return view, scale, corner


def _free_corner(frames: Sequence[CloseUpFrame], window: Window) -> tuple[int, int]:
    """Return left and top, px of a tile, of the place where the caption hides least of the balls of all frames."""
    scale, corner = _view_transform(TILE_SIZE, window)
    outlines = [outline for scene in frames for outline in scene.outlines]
    centres = np.array([scale * (outline.centre - corner) for outline in outlines]).reshape(-1, 2)
    squares = make_squares(centres, np.array([scale * outline.radius for outline in outlines]))
    left, top, _, _ = place_panel(CAPTION_SIZE, TILE_SIZE, np.zeros(TILE_SIZE), squares)
    return round(left), round(top)


def find_window(places: FloatArray, reach: FloatArray | float) -> Window:
    """Find the window that shows places.

    Args:
        places: (n, 2) px; NaN is left out.
        reach: px, what is shown around every place, or around each one (n, 1).

    Returns:
        The window.
    """
    low, high = np.nanmin(places - reach, axis=0), np.nanmax(places + reach, axis=0)
    return np.stack([(low + high) / 2, high - low])


def _enclose_balls(frames: Sequence[CloseUpFrame]) -> Window:
    """Return a window with all balls, and the line where it is to be shown; the whole frame without any."""
    spots = [(one.centre, MARGIN_RADII * one.radius) for scene in frames for one in scene.outlines]
    lines = [scene.line for scene in frames if scene.shows_line and scene.line is not None]
    spots += [(place, np.ptp(line, axis=0).max() / 2) for line in lines for place in line]
    if not spots:
        height, width = frames[0].image.shape[:2]
        return np.array([[width / 2, height / 2], [width, height]])
    places, reach = zip(*spots, strict=True)
    return find_window(np.stack(places), np.array(reach)[:, None])


def _view_transform(size: tuple[int, int], window: Window) -> tuple[float, FloatArray]:
    """Return the magnification of a window to `size`, and the corner (2,) of the window in the frame."""
    middle, extent = window
    scale = float(min(np.min(np.array(size) / extent), MAX_MAGNIFICATION))
    return scale, middle - np.array(size) / (2 * scale)


def magnify_image(
    image: ImageArray, size: tuple[int, int], window: Window, keeps_inside: bool = False
) -> tuple[ImageArray, float, FloatArray]:
    """Magnify the part of a frame (H, W, 3) around a window.

    Args:
        image: The frame.
        size: Width and height of the result, px.
        window: What the result shows.
        keeps_inside: Whether to move the window into the frame, where it fits.

    Returns:
        The view, its magnification, and its corner (2,) in the frame, px.
    """
    scale, corner = _view_transform(size, window)
    if keeps_inside:
        room = np.array(image.shape[1::-1]) - np.array(size) / scale
        corner = np.where(room > 0, np.clip(corner, 0, np.maximum(room, 0)), room / 2)
    # Pixel centres are whole numbers in both images.
    to_view = np.array([[scale, 0, -scale * corner[0]], [0, scale, -scale * corner[1]]])
    interpolation = cv2.INTER_CUBIC if scale > 1 else cv2.INTER_AREA
    view = cv2.warpAffine(image, to_view, size, flags=interpolation, borderMode=cv2.BORDER_CONSTANT, borderValue=INK)
    return np.ascontiguousarray(view, dtype=np.uint8), scale, corner


def draw_polyline(view: ImageArray, points: FloatArray, width: int, colour: Colour = FLASH) -> None:
    """Draw a line through points (n, 2) px, in place; by default in the colour of what is in question."""
    mask = np.zeros(view.shape[:2], dtype=np.uint8)
    points = np.clip(points, -1e5, 1e5)  # far points overflow fixed-point numbers
    cv2.polylines(mask, [to_fixed_point(points).reshape(-1, 1, 2)], False, 255, width, cv2.LINE_AA, SHIFT)
    blend_mask(view, mask, 0, 0, colour)


def _draw_balls(view: ImageArray, frame: CloseUpFrame, scale: float, corner: FloatArray, width: float) -> None:
    """Draw the outlines and centres of the balls."""
    for k, outline in enumerate(frame.outlines):
        centre = scale * (outline.centre - corner)
        draw_ring(view, centre, scale * outline.radius, width, RING_COLOURS[k % 2], 0.95)
        draw_ring(view, centre, 2.0, width, RING_COLOURS[k % 2], 0.95)


def _draw_gap(view: ImageArray, frame: CloseUpFrame, scale: float, corner: FloatArray) -> None:
    """Draw the line of centres, bright between the two surfaces."""
    if len(frame.outlines) != 2:
        return
    one, two = frame.outlines
    separation = two.centre - one.centre
    n = separation / max(float(np.hypot(*separation)), 1e-9)
    ends = (one.centre, one.centre + one.radius * n, two.centre - two.radius * n, two.centre)
    points = [to_fixed_point(scale * (end - corner)).tolist() for end in ends]
    mask = np.zeros(view.shape[:2], dtype=np.uint8)
    cv2.line(mask, points[0], points[3], 120, 1, cv2.LINE_AA, SHIFT)
    blend_mask(view, mask, 0, 0, WHITE)
    mask[:] = 0
    cv2.line(mask, points[1], points[2], 255, 4, cv2.LINE_AA, SHIFT)
    blend_mask(view, mask, 0, 0, FLASH)


def _draw_ball_names(view: ImageArray, frame: CloseUpFrame, scale: float, corner: FloatArray) -> None:
    """Draw names above the balls, below the lower ball, so that they do not hide the gap."""
    lowest = max((outline.centre[1] for outline in frame.outlines), default=0.0)
    for k, outline in enumerate(frame.outlines):
        below = len(frame.outlines) > 1 and outline.centre[1] == lowest
        away = (scale * outline.radius + 21) * (1 if below else -1)
        draw_panel(view, outline.name, scale * (outline.centre - corner) + [0, away], 17, RING_COLOURS[k % 2])
