"""Elements drawn on a frame: labels, contact flashes, dashed rings and the clock panel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import TrustLevel
from models.core.typing import BoolArray, FloatArray
from video.drawing.label_layout import Rect, make_squares
from video.drawing.masks import (
    SHIFT,
    blend_levels,
    blend_mask,
    disc_mask,
    draw_disc,
    draw_ring,
    draw_text,
    number_mask,
    round_corner_mask,
    text_mask,
    to_fixed_point,
)
from video.drawing.palette import FLASH, INK, MUTED_GREY, TRUST_COLOURS, WHITE, Colour, ensure_contrast, mix_colours
from video.io.yuv_frame import Canvas, YuvFrame

LABEL_OPACITY = 0.72
# px around a ball on which nothing is drawn.
BALL_MARGIN_PX = 1.0
# px, length of a dash with its gap around a ball whose position is measured, not fitted.
DASH_PX, MIN_DASHES = 12.0, 5


@dataclass(frozen=True, slots=True)
class FrameBalls:
    """N balls on one frame."""

    centre: FloatArray
    """(N, 2) px; NaN where absent."""
    radius: FloatArray
    """(N,) px."""
    speed: FloatArray
    """(N,) m/s; NaN where unknown."""
    heading: FloatArray
    """(N, 2) px, unit vectors of the motion; 0 at rest."""
    moving: BoolArray
    """(N,) the ball moves."""
    measured: BoolArray
    """(N,) the position is measured, not fitted."""
    is_supported: BoolArray
    """(N,) observed in a neighbouring frame, or predicted by an accepted fit."""

    @property
    def present(self) -> NDArray[np.intp]:
        """Indices of the balls on the frame."""
        return np.flatnonzero(np.isfinite(self.centre[:, 0]) & np.isfinite(self.radius))

    def radius_of(self, ball: int) -> float:
        """Return the radius of a ball, px; the largest of the others where it is unknown."""
        radius = float(self.radius[ball])
        return radius if np.isfinite(radius) else float(np.nanmax(self.radius, initial=4.0))

    def boxes(self, margin: float) -> FloatArray:
        """Return squares (n, 4) px around the balls with a margin in radii."""
        return make_squares(self.centre, self.radius * (1 + margin) + 2)


@contextmanager
def keep_balls_on_top(image: Canvas, balls: FrameBalls) -> Iterator[None]:
    """Draw the balls of an image once more over everything that is drawn in this context."""
    height, width = image.shape[:2]
    pieces = []
    for ball in balls.present:
        disc, x, y = disc_mask(balls.centre[ball], float(balls.radius[ball]) + BALL_MARGIN_PX)
        left, top = min(max(x, 0), width), min(max(y, 0), height)
        right, bottom = min(max(x + disc.shape[1], left), width), min(max(y + disc.shape[0], top), height)
        if right == left or bottom == top:
            continue
        if isinstance(image, YuvFrame):
            pixels = image.copy_patch(left, top, right, bottom)
        else:
            pixels = image[top:bottom, left:right].copy()
        cover = np.ascontiguousarray(disc[top - y : bottom - y, left - x : right - x])
        pieces.append((pixels, cover, left, top))
    yield
    for pixels, cover, left, top in pieces:
        blend_levels(image, pixels, cover, left, top)


def draw_measured_rings(image: Canvas, balls: FrameBalls, colours: Sequence[Colour], scale: float) -> None:
    """Draw dashed rings around moving balls whose position is measured, not fitted."""
    for ball in balls.present:
        if balls.measured[ball] and balls.moving[ball] and balls.is_supported[ball]:
            radius = float(balls.radius[ball]) + 3.5 * scale
            dashes = max(MIN_DASHES, round(2 * np.pi * radius / (DASH_PX * scale)))
            draw_ring(
                image, balls.centre[ball], radius, 1.6 * scale, mix_colours(colours[ball], WHITE, 0.5), 0.9, dashes
            )


# Ball radii from a point of contact that both balls lie within.
CONTACT_RADII = 2.2


def draw_flash(
    image: Canvas,
    centre: FloatArray,
    radius: float,
    age: float,
    scale: float,
    strength: float,
    opacity: float = 1.0,
) -> None:
    """Draw a flash around a contact and both of its balls: `age` 0 to 1 of its life; `strength` scales its reach."""
    remaining = (1 - age) ** 2
    thickness = (1.5 + 2.5 * remaining) * scale
    ring_radius = radius * (CONTACT_RADII + strength * (1 - remaining)) + thickness
    draw_ring(image, centre, ring_radius, thickness, FLASH, 0.9 * opacity * (1 - age))
    draw_ring(image, centre, ring_radius + thickness, 1.2 * scale, WHITE, 0.7 * opacity * (1 - age))


@dataclass(frozen=True, slots=True)
class Label:
    """A bold name and a value on a dark background, with a coloured bar."""

    name: str
    value: str
    colour: Colour

    def size(self, scale: float) -> tuple[int, int]:
        """Return width and height, px."""
        return _label_size(self.name, self.value, _font_size(scale))

    def draw(self, image: Canvas, corner: FloatArray, scale: float, opacity: float = 1.0) -> None:
        """Draw with the top-left corner at `corner` (2,), in place."""
        width, height = self.size(scale)
        letters = _font_size(scale)
        x, y = round(float(corner[0])), round(float(corner[1]))
        background, inset = round_corner_mask(width, height, max(2, height // 4)), height // 5
        blend_mask(image, background, x, y, INK, LABEL_OPACITY * opacity)
        bar = round_corner_mask(max(3, letters // 4), height - 2 * inset, max(1, letters // 8))
        blend_mask(image, bar, x + inset, y + inset, ensure_contrast(self.colour, INK), opacity)
        top = y + (height - text_mask(self.name, letters, True).shape[0]) / 2
        advance = draw_text(image, self.name, x + 0.95 * letters, top, letters, WHITE, True, opacity)
        left, ink = x + 1.4 * letters + advance, mix_colours(WHITE, MUTED_GREY, 0.45)
        draw_text(image, self.value, left, top, letters, ink, opacity=opacity)


@lru_cache(maxsize=256)
def _label_size(name: str, value: str, letters: int) -> tuple[int, int]:
    """Return width and height, px, of a label with a font size; cached because it is needed several times per frame."""
    after = text_mask(value, letters, False).shape[1] + 0.45 * letters if value else 0
    return round(text_mask(name, letters, True).shape[1] + after + 1.35 * letters), round(1.65 * letters)


# Font size of labels in a frame of 720 rows, px.
LABEL_LETTERS = 14.0


def _font_size(scale: float) -> int:
    """Return the font size of labels, px."""
    return round(LABEL_LETTERS * scale)


@dataclass(frozen=True, slots=True)
class ClockPanel:
    """Panel with the time in milliseconds, the slowdown and, where there is one, the trust level."""

    slowdown_text: str
    trust_level: TrustLevel = "green"
    trust_text: str = ""

    def size(self, scale: float) -> tuple[int, int]:
        """Return width and height, px."""
        small = round(13 * scale)
        lower = text_mask(self.slowdown_text, small).shape[1] + text_mask(self.trust_text, small).shape[1]
        if self.trust_text:
            lower += round(1.65 * small + 9.2 * scale)
        upper = number_mask("00.000", round(27 * scale), bold=True).shape[1] + round(22 * scale)
        return max(lower, upper) + round(24 * scale) + 2, round(62 * scale)

    def draw(self, image: Canvas, rect: Rect, t: float, scale: float) -> None:
        """Draw into `rect`, in place."""
        x, y, width, height = (round(v) for v in rect)
        seconds = number_mask(f"{t:06.3f}", round(27 * scale), bold=True)
        large, middle, small, pad = seconds.shape[1], round(17 * scale), round(13 * scale), round(12 * scale)
        row, unit_left = y + round(39 * scale), x + round(pad + large + 0.2 * round(27 * scale))
        blend_mask(image, round_corner_mask(width, height, max(3, height // 7)), x, y, INK, 0.8)
        draw_text(image, "s", unit_left, y + 5 * scale + 0.42 * round(27 * scale), middle, MUTED_GREY)
        advance = draw_text(image, self.slowdown_text, x + pad, row, small, MUTED_GREY)
        radius = 4.6 * scale
        dot = np.array([x + pad + advance + 1.2 * small + radius, y + 39 * scale + 0.62 * small])
        if self.trust_text:
            draw_disc(image, dot, radius, TRUST_COLOURS[self.trust_level])
            draw_text(image, self.trust_text, dot[0] + radius + 0.45 * small, row, small, MUTED_GREY)
        blend_mask(image, seconds, x + pad, y + round(5 * scale), WHITE)


# px of a trail with one opacity, and largest number of such pieces.
TRAIL_PIECE_PX, MAX_TRAIL_PIECES = 10.0, 18
# Opacity of the coloured line and of its white core.
TRAIL_OPACITY, CORE_OPACITY = 0.62, 0.85


def draw_trail(image: Canvas, path: FloatArray, fade: FloatArray, colour: Colour, width: float) -> None:
    """Draw a line with a white core along `path` (n, 2) px with opacity `fade` (n,)."""
    if len(path) < 2:
        return
    margin = width + 3
    x0, y0 = (int(v) for v in np.maximum(np.floor(path.min(axis=0) - margin), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(path.max(axis=0) + margin), [image.shape[1], image.shape[0]]))
    if x1 <= x0 or y1 <= y0:
        return
    pieces = _split_trail(path - [x0, y0], fade)
    for ink, thickness, opacity in (
        (colour, width, TRAIL_OPACITY),
        (mix_colours(WHITE, colour, 0.12), width * 0.3, CORE_OPACITY),
    ):
        mask = np.zeros((y1 - y0, x1 - x0), dtype=np.uint8)
        for line, own in pieces:
            if (level := round(own * opacity * 255)) > 2:
                cv2.polylines(mask, [line], False, level, max(1, round(thickness)), cv2.LINE_AA, SHIFT)
        blend_mask(image, mask, x0, y0, ink)


def _split_trail(path: FloatArray, fade: FloatArray) -> list[tuple[NDArray[np.int32], float]]:
    """Split a polyline (n, 2) px into lines of constant opacity, the oldest first."""
    points = to_fixed_point(path).reshape(-1, 1, 2)
    length = float(np.hypot(*np.diff(path, axis=0).T).sum())
    count = int(min(max(length / TRAIL_PIECE_PX, 2), MAX_TRAIL_PIECES, len(points) - 1))
    cuts = [k * (len(points) - 1) // count for k in range(count + 1)]
    return [(points[start : end + 1], float(fade[end])) for start, end in pairwise(cuts)]
