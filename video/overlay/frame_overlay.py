"""What is drawn on a picture: trails, names and speeds, contact flashes, the clock."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Light
from models.core.typing import BoolArray, FloatArray, ImageArray
from video.drawing.label_layout import Rect
from video.drawing.mask_tile import Ink, Tile, stacked
from video.drawing.palette import FLASH, INK, LIGHTS, MIST, WHITE, Colour, apart_from, mix
from video.drawing.text import lay, lay_sparse, number_mask, rounded_mask, text_mask, write

SHIFT = 4
"""Binary digits after the point of OpenCV's sub-pixel coordinates."""
TRAIL_PIECE, MOST_PIECES = 10.0, 18
"""px of a trail with one opacity; pieces of a trail."""
TRAIL_OPACITY, CORE_OPACITY = 0.62, 0.85
LABEL_OPACITY = 0.72
DASH_PX, FEWEST_DASHES = 12.0, 5
"""Dash with its gap around a ball whose place is measured, not fitted."""


def unit(height: int) -> float:
    """Size of drawing against a picture of 720 rows; small pictures keep letters that can be read."""
    return max(height / 720, 0.78)


@dataclass(frozen=True, slots=True)
class Balls:
    """N balls on one picture."""

    centre: FloatArray
    """(N, 2) px; NaN where absent."""
    radius: FloatArray
    """(N,) px"""
    speed: FloatArray
    """(N,) m/s; NaN where unknown."""
    heading: FloatArray
    """(N, 2) px, unit vectors of the motion; 0 at rest."""
    moving: BoolArray
    """(N,)"""
    measured: BoolArray
    """(N,) place measured, not fitted."""
    sure: BoolArray
    """(N,) seen in a picture around, or carried by accepted physics."""

    @property
    def present(self) -> NDArray[np.intp]:
        """Indices of the balls on the picture."""
        return np.flatnonzero(np.isfinite(self.centre[:, 0]) & np.isfinite(self.radius))

    def radius_of(self, ball: int) -> float:
        """px; the largest of the others where it is unknown."""
        radius = float(self.radius[ball])
        return radius if np.isfinite(radius) else float(np.nanmax(self.radius, initial=4.0))

    def boxes(self, margin: float) -> list[Rect]:
        """Squares around the balls, with a margin in radii."""
        rects = []
        for ball in self.present:
            half = float(self.radius[ball]) * (1 + margin) + 2
            rects.append((float(self.centre[ball, 0]) - half, float(self.centre[ball, 1]) - half, 2 * half, 2 * half))
        return rects


def fixed(px: FloatArray) -> NDArray[np.int32]:
    """Pixels to OpenCV's fixed-point coordinates."""
    return np.asarray(np.rint(px * (1 << SHIFT)), dtype=np.int32)


def uncovered(shape: tuple[int, ...], balls: Balls) -> ImageArray:
    """(H, W) 255 where no ball lies on a picture of that shape, 0 on the balls."""
    free = np.full(shape[:2], 255, dtype=np.uint8)
    for ball in balls.present:
        centre, radius = fixed(balls.centre[ball]).tolist(), float(balls.radius[ball]) + 0.5
        cv2.circle(free, centre, round(radius * (1 << SHIFT)), 0, -1, cv2.LINE_AA, SHIFT)
    return free


def draw_trail(
    picture: ImageArray, way: FloatArray, fade: FloatArray, colour: Colour, width: float, free: ImageArray
) -> None:
    """A line along `way` (n, 2) px with opacity `fade` (n,) 0 to 1, its core white, where it is `free` (H, W)."""
    if len(way) < 2:
        return
    margin = width + 3
    x0, y0 = (int(v) for v in np.maximum(np.floor(way.min(axis=0) - margin), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(way.max(axis=0) + margin), [picture.shape[1], picture.shape[0]]))
    if x1 <= x0 or y1 <= y0:
        return
    pieces = _pieces(way - [x0, y0], fade)
    layers = []
    for ink, thickness, opacity in (
        (colour, width, TRAIL_OPACITY),
        (mix(WHITE, colour, 0.12), width * 0.3, CORE_OPACITY),
    ):
        mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        _strokes(mask, pieces, opacity, max(1, round(thickness)))
        layers.append((mask, ink))
    lay_sparse(picture, layers, x0, y0, free)


def _pieces(way: FloatArray, fade: FloatArray) -> list[tuple[NDArray[np.int32], float]]:
    """A polyline (n, 2) px cut into lines of even opacity, the oldest first."""
    points = fixed(way).reshape(-1, 1, 2)
    length = float(np.hypot(*np.diff(way, axis=0).T).sum())
    count = int(min(max(length / TRAIL_PIECE, 2), MOST_PIECES, len(points) - 1))
    cuts = [k * (len(points) - 1) // count for k in range(count + 1)]
    return [(points[start : end + 1], float(fade[end])) for start, end in pairwise(cuts)]


def _strokes(
    mask: ImageArray, pieces: Sequence[tuple[NDArray[np.int32], float]], opacity: float, thickness: int
) -> None:
    """Draw the pieces of a polyline, each with its own opacity."""
    for line, fade in pieces:
        level = round(fade * opacity * 255)
        if level > 2:
            cv2.polylines(mask, [line], False, level, thickness, cv2.LINE_AA, SHIFT)


def draw_ring(
    picture: ImageArray,
    centre: FloatArray,
    radius: float,
    thickness: float,
    colour: Colour,
    opacity: float,
    dashes: int = 0,
) -> None:
    """A circle, whole or dashed, in place."""
    if not np.isfinite(centre).all() or opacity <= 0.01:
        return
    half = int(np.ceil(radius + thickness + 2))
    x0, y0 = (int(v) for v in np.floor(centre) - half)
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    middle = fixed(centre - [x0, y0]).tolist()
    size = round(radius * (1 << SHIFT))
    stroke = max(1, round(thickness))
    if dashes:
        step = 360 / dashes
        for dash in range(dashes):
            start = dash * step
            cv2.ellipse(mask, middle, (size, size), 0, start, start + 0.5 * step, 255, stroke, cv2.LINE_AA, SHIFT)
    else:
        cv2.circle(mask, middle, size, 255, stroke, cv2.LINE_AA, SHIFT)
    lay(picture, mask, x0, y0, colour, opacity)


def draw_disc(picture: ImageArray, centre: FloatArray, radius: float, colour: Colour, opacity: float = 1.0) -> None:
    """A filled circle, in place."""
    mask, x, y = _disc(centre, radius)
    lay(picture, mask, x, y, colour, opacity)


def _disc(centre: FloatArray, radius: float) -> tuple[ImageArray, int, int]:
    """The mask of a filled circle, and its top-left pixel."""
    half = int(np.ceil(radius + 2))
    x0, y0 = (int(v) for v in np.floor(centre) - half)
    mask = np.zeros((2 * half + 2, 2 * half + 2), dtype=np.uint8)
    cv2.circle(mask, fixed(centre - [x0, y0]).tolist(), round(radius * (1 << SHIFT)), 255, -1, cv2.LINE_AA, SHIFT)
    return mask, x0, y0


def draw_measured(picture: ImageArray, balls: Balls, colours: Sequence[Colour], scale: float) -> None:
    """Dashed rings around balls that no accepted physics carries."""
    for ball in balls.present:
        if balls.measured[ball] and balls.moving[ball] and balls.sure[ball]:
            radius = float(balls.radius[ball]) + 3.5 * scale
            dashes = max(FEWEST_DASHES, round(2 * np.pi * radius / (DASH_PX * scale)))
            draw_ring(picture, balls.centre[ball], radius, 1.6 * scale, mix(colours[ball], WHITE, 0.5), 0.9, dashes)


def draw_flash(
    picture: ImageArray, centre: FloatArray, radius: float, age: float, scale: float, strength: float
) -> None:
    """A burst at a contact: `age` 0 to 1 of its life; `strength` scales its reach."""
    left = (1 - age) ** 2
    grown = radius * (0.5 + 1.9 * strength * (1 - left))
    draw_disc(picture, centre, radius * 0.3 * strength * left + 1, WHITE, 0.8 * left**2)
    draw_ring(picture, centre, grown, (1.5 + 2.5 * left) * scale, FLASH, 0.9 * (1 - age))
    draw_ring(picture, centre, grown * 0.72, 1.2 * scale, WHITE, 0.7 * (1 - age))


@dataclass(frozen=True, slots=True)
class Label:
    """A line of text in two weights on a dark ground, with a bar in a colour."""

    name: str
    value: str
    colour: Colour

    def size(self, scale: float) -> tuple[int, int]:
        """Width and height, px."""
        return _label_size(self.name, self.value, _letters(scale))

    def draw(self, picture: ImageArray, corner: FloatArray, scale: float, opacity: float = 1.0) -> None:
        """Draw with the top-left corner at `corner` (2,), in place."""
        width, height = self.size(scale)
        letters = _letters(scale)
        x, y = round(float(corner[0])), round(float(corner[1]))
        _name_tile(self.name, self.colour, width, height, letters).lay(picture, x, y, opacity)
        name = text_mask(self.name, letters, True)
        left = x + 1.4 * letters + name.shape[1]
        top = y + (height - name.shape[0]) / 2
        write(picture, self.value, left, top, letters, mix(WHITE, MIST, 0.45), opacity=opacity)


@lru_cache(maxsize=256)
def _label_size(name: str, value: str, letters: int) -> tuple[int, int]:
    """Width and height, px, of letters of that size: asked for several times per picture."""
    after = text_mask(value, letters, False).shape[1] + 0.45 * letters if value else 0
    return round(text_mask(name, letters, True).shape[1] + after + 1.35 * letters), round(1.65 * letters)


@lru_cache(maxsize=256)
def _name_tile(name: str, colour: Colour, width: int, height: int, letters: int) -> Tile:
    """A label without its value: the ground, the bar and the name."""
    bar = rounded_mask(max(3, letters // 4), height - 2 * (height // 5), max(1, letters // 8))
    mask = text_mask(name, letters, True)
    inks = (
        Ink(rounded_mask(width, height, max(2, height // 4)), 0, 0, INK, LABEL_OPACITY),
        Ink(bar, height // 5, height // 5, apart_from(colour, INK)),
        Ink(mask, round(0.95 * letters), round((height - mask.shape[0]) / 2), WHITE),
    )
    return stacked(width, height, inks)


def _letters(scale: float) -> int:
    """px, font size of labels."""
    return round(14 * scale)


@dataclass(frozen=True, slots=True)
class Clock:
    """Time in milliseconds, how much slower, and the light of trust."""

    slow: str
    light: Light
    word: str

    def size(self, scale: float) -> tuple[int, int]:
        """Width and height, px."""
        small = round(13 * scale)
        lower = text_mask(self.slow, small).shape[1] + text_mask(self.word, small).shape[1]
        return lower + round(24 * scale + 1.65 * small + 9.2 * scale) + 2, round(62 * scale)

    def draw(self, picture: ImageArray, rect: Rect, t: float, scale: float) -> None:
        """Draw into `rect`, in place."""
        x, y, width, height = (round(v) for v in rect)
        seconds = number_mask(f"{t:06.3f}", round(27 * scale), bold=True)
        _clock_tile(self, width, height, seconds.shape[1], scale).lay(picture, x, y)
        lay(picture, seconds, x + round(12 * scale), y + round(5 * scale), WHITE)


@lru_cache(maxsize=16)
def _clock_tile(clock: Clock, width: int, height: int, advance: int, scale: float) -> Tile:
    """A clock without its time, which is `advance` px wide: ground, unit, slowness, light and word."""
    small, pad, row = round(13 * scale), round(12 * scale), round(39 * scale)
    unit_left = round(pad + advance + 0.2 * round(27 * scale))
    slow, word = text_mask(clock.slow, small), text_mask(clock.word, small)
    radius = 4.6 * scale
    dot = np.array([pad + slow.shape[1] + 1.2 * small + radius, 39 * scale + 0.62 * small])
    inks = (
        Ink(rounded_mask(width, height, max(3, height // 7)), 0, 0, INK, 0.8),
        Ink(text_mask("s", round(17 * scale)), unit_left, round(5 * scale + 0.42 * round(27 * scale)), MIST),
        Ink(slow, pad, row, MIST),
        Ink(*_disc(dot, radius), LIGHTS[clock.light]),
        Ink(word, round(float(dot[0]) + radius + 0.45 * small), row, MIST),
    )
    return stacked(width, height, inks)


def error_text(sigma: float) -> str:
    """One standard deviation of a time (s) with the digits that it deserves: "± 0.6 ms"."""
    if not np.isfinite(sigma):
        return ""
    ms = sigma * 1e3
    return f"± {ms:.1f} ms" if ms < 9.95 else f"± {ms:.0f} ms"
