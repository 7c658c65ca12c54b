"""Close-up of a landing from above: the court plane as filmed, its lines, the place with its error, the call."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from models.core.number_format import format_probability
from models.core.rally import LandingHypothesis, Rally
from models.core.typing import FloatArray, ImageArray
from models.estimation.rally.landing_judgement import LandingCall
from models.estimation.rally.landing_margin import format_distance, format_margin
from video.drawing.court_plan import draw_court, draw_landing_mark, find_ellipse, outline_line
from video.drawing.label_layout import PANEL_MARGIN, Rect
from video.drawing.masks import (
    SHIFT,
    blend_colours,
    blend_mask,
    draw_panel,
    draw_text,
    drawing_scale,
    round_corner_mask,
    text_mask,
    to_fixed_point,
)
from video.drawing.palette import FLASH, INK, MUTED_GREY, WHITE, Colour, mix_colours
from video.io.clip import Clip, read_frames
from video.overlay.close_up import CLOSE_UP_SIZE, draw_polyline
from video.overlay.rally_annotation import VERDICT_COLOURS

# Share of the length of the court, and m, that a view is high at least; standard deviations and distances that fit in.
LEAST_SHARE, LEAST_HEIGHT, LARGEST_HEIGHT = 0.06, 0.4, 4.0
SHOWN_SIGMAS, SHOWN_DISTANCES = 8.0, 3.0
# Frames, and s around the landing, whose median shows the surface without people that run across.
SURFACE_FRAMES, SURFACE_S = 9, 2.0
# Opacities of the paint of lines that is drawn over the filmed one, and of the shade over what is out.
PAINT_OPACITY, OUT_SHADE = 0.85, 0.38
# Pixels between those for which the place in the image is computed; between them it is interpolated.
MAP_STEP = 8
VERDICT_WORDS = {"in": "IN", "out": "OUT", "undecided": "CANNOT BE DECIDED"}


@dataclass(frozen=True, slots=True)
class SurfaceView:
    """A view straight down onto the playing surface, or onto the floor beside a table."""

    to_view: FloatArray
    """(2, 3) from x, y, 1, m, to px of the view."""
    size: tuple[int, int]
    """Width and height, px."""
    height: float
    """m, z of the plane."""

    @property
    def scale(self) -> float:
        """Pixels per metre."""
        return float(np.linalg.norm(self.to_view[:, 0]))

    def to_pixels(self, xy: FloatArray) -> FloatArray:
        """Map places (..., 2), m, to px (..., 2)."""
        return np.asarray(xy @ self.to_view[:, :2].T + self.to_view[:, 2])

    def to_court(self, px: FloatArray) -> FloatArray:
        """Map px (..., 2) to places (..., 3), m."""
        xy = (px - self.to_view[:, 2]) @ np.linalg.inv(self.to_view[:, :2]).T
        return np.concatenate([xy, np.full((*xy.shape[:-1], 1), self.height)], axis=-1)

    def fill(self, image: ImageArray, corners: FloatArray, colour: Colour, opacity: float) -> None:
        """Fill a polygon with corners (n, 2), m."""
        mask = np.zeros(image.shape[:2], np.uint8)
        cv2.fillPoly(mask, [to_fixed_point(np.clip(self.to_pixels(corners), -1e5, 1e5))], 255, cv2.LINE_AA, SHIFT)
        blend_mask(image, mask, 0, 0, colour, opacity)


def frame_landing(rally: Rally, call: LandingCall, landing: LandingHypothesis, size: tuple[int, int]) -> SurfaceView:
    """Choose a view of a size (px) that shows a landing, its error and the nearest line.

    The far end is on top, or the right end on the right, as in the image.
    """
    sport, place = rally.scene.sport, landing.place
    spread = float(np.sqrt(np.linalg.eigvalsh(landing.covariance[:2, :2]).max()))
    least = max(LEAST_SHARE * sport.length, LEAST_HEIGHT)
    distance = abs(call.distance) if np.isfinite(call.distance) else 0.0
    high = float(np.clip(max(SHOWN_SIGMAS * spread, SHOWN_DISTANCES * distance), least, LARGEST_HEIGHT))
    edge = find_line_edge(rally, call, landing)
    is_near = edge is not None and distance < 0.8 * high
    middle = (place[:2] + edge) / 2 if edge is not None and is_near else place[:2]
    axes = np.array([[1.0, 0], [0, -1.0]]) if sport.is_filmed_from_side else np.array([[0, 1.0], [-1.0, 0]])
    by = size[1] / high * axes
    is_low = place[2] < sport.floor / 2
    return SurfaceView(np.column_stack([by, np.array(size) / 2 - by @ middle]), size, sport.floor if is_low else 0.0)


def find_line_edge(rally: Rally, call: LandingCall, landing: LandingHypothesis) -> FloatArray | None:
    """Find the point (2,), m, of the outer edge of the line of a call that is nearest to its landing; None without."""
    line = next((one for one in rally.scene.sport.lines if one.name == call.line), None)
    if line is None or not np.isfinite(call.distance):
        return None
    axis = 0 if line.start[0] == line.end[0] else 1
    sides = landing.place[axis] + np.array([call.distance, -call.distance])
    edge = landing.place[:2].copy()
    edge[axis] = sides[np.argmin(np.abs(sides - line.start[axis]))]
    return np.asarray(edge)


def draw_landing(
    clip: Clip, rally: Rally, call: LandingCall, size: tuple[int, int] = CLOSE_UP_SIZE
) -> ImageArray:  # fmt: skip
    """Draw the close-up of a landing.

    Args:
        call: Verdict on it.
        size: Width and height of the image, px.

    Returns:
        Image (h, w, 3); without any landing, a dark one that states so.
    """
    scale, landing = drawing_scale(size[1]), call.landing
    if landing is None:
        image = np.full((size[1], size[0], 3), INK, np.uint8)
        draw_words(image, call, scale)
        return image
    view = frame_landing(rally, call, landing, size)
    image = _film_surface(clip, rally, view, landing.t)
    if view.height == 0:
        _draw_lines(image, rally, call, view)
    _draw_place(image, rally, call, landing, view, scale)
    _draw_overview(image, rally, landing, scale)
    draw_words(image, call, scale)
    return image


def _film_surface(clip: Clip, rally: Rally, view: SurfaceView, t: float) -> ImageArray:
    """Return the median (h, w, 3) of the surface over frames around a time: people who run across vanish."""
    middle = max(min(t, float(rally.t[-1]) - SURFACE_S), float(rally.t[0]) + SURFACE_S)
    moments = middle + np.linspace(-SURFACE_S, SURFACE_S, SURFACE_FRAMES)
    rows = np.unique(np.abs(rally.t[:, None] - moments).argmin(axis=0))
    columns, lines = (np.arange(0, side + MAP_STEP, MAP_STEP) for side in view.size)
    coarse = view.to_court(np.stack(np.meshgrid(columns, lines), axis=-1).astype(np.float64))
    shift = np.array([[1 / MAP_STEP, 0, 0], [0, 1 / MAP_STEP, 0]], np.float32)
    layers, flags = [], cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    for frame, image in read_frames(clip, indices=rally.frame[rows]):
        px = rally.scene.camera.to_pixels(coarse, frame)
        where = cv2.warpAffine(np.nan_to_num(px, nan=-1e4).astype(np.float32), shift, view.size, flags=flags)
        layers.append(cv2.remap(image, where, None, cv2.INTER_CUBIC, borderMode=cv2.BORDER_CONSTANT, borderValue=INK))
    return np.ascontiguousarray(np.median(layers, axis=0).astype(np.uint8))


def _draw_lines(image: ImageArray, rally: Rally, call: LandingCall, view: SurfaceView) -> None:
    """Shade what is out, and draw the paint of the lines where they are by the rules."""
    good = np.zeros(image.shape[:2], np.uint8)
    for x0, y0, x1, y1 in call.rectangles:
        corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
        cv2.fillPoly(good, [to_fixed_point(np.clip(view.to_pixels(corners), -1e5, 1e5))], 255, cv2.LINE_AA, SHIFT)
    blend_mask(image, 255 - good, 0, 0, INK, OUT_SHADE)
    for line in rally.scene.sport.lines:
        paint = WHITE if line.name == call.line else mix_colours(WHITE, MUTED_GREY, 0.5)
        view.fill(image, outline_line(line.start, line.end, line.width), paint, PAINT_OPACITY)


def _draw_place(
    image: ImageArray, rally: Rally, call: LandingCall, landing: LandingHypothesis, view: SurfaceView, scale: float
) -> None:
    """Draw the ellipses of one and two standard deviations, the object true to scale, and the distance to the line."""
    place, covariance = landing.place[:2], landing.covariance[:2, :2]
    view.fill(image, place + find_ellipse(covariance, 2.0), FLASH, 0.22)
    view.fill(image, place + find_ellipse(covariance, 1.0), FLASH, 0.4)
    for sigmas in (1.0, 2.0):
        draw_polyline(image, view.to_pixels(place + find_ellipse(covariance, sigmas)), max(1, round(1.5 * scale)))
    ball = find_ellipse(np.eye(2) * rally.scene.sport.object.radius**2, 1.0)
    draw_polyline(image, view.to_pixels(place + ball), max(1, round(2 * scale)), WHITE)
    edge = find_line_edge(rally, call, landing)
    if edge is None or view.height != 0:
        return
    ends = view.to_pixels(np.stack([place, edge]))
    colour = VERDICT_COLOURS[call.verdict]
    draw_polyline(image, ends, round(3 * scale), colour)
    across = (ends[1] - ends[0])[::-1] * [-1, 1] / max(float(np.hypot(*(ends[1] - ends[0]))), 1e-9)
    draw_polyline(
        image, np.stack([ends[1] - 9 * scale * across, ends[1] + 9 * scale * across]), round(3 * scale), colour
    )
    text = format_distance(call.distance, call.distance_sigma)
    aside = across if across[1] <= 0 else -across
    reach = text_mask(text, round(17 * scale), True).shape[1] / 2 * abs(aside[0]) + 26 * scale
    draw_panel(image, text, ends.mean(axis=0) + reach * aside, round(17 * scale), WHITE)


def _draw_overview(image: ImageArray, rally: Rally, landing: LandingHypothesis, scale: float) -> None:
    """Draw where on the court the view is, in the lower right corner, and a scale beside it."""
    plan = draw_court(rally.scene.sport, round(0.3 * image.shape[0]))
    draw_landing_mark(plan, landing.place, landing.covariance)
    margin = round(PANEL_MARGIN * image.shape[0])
    x, y = (side - own - margin for side, own in zip(image.shape[1::-1], plan.size, strict=True))
    blend_colours(image, plan.render(), round_corner_mask(*plan.size, round(6 * scale)), x, y)


def draw_words(image: ImageArray, call: LandingCall, scale: float) -> Rect:
    """Write verdict, probability and distance into the upper left corner, and return the place of the panel."""
    large, small, margin = round(34 * scale), round(18 * scale), round(PANEL_MARGIN * image.shape[0])
    chances = f"in {format_probability(call.probability)}, out {format_probability(call.out_probability)}"
    margin_words = format_margin(call) or "the clip does not show where it came down"
    lines = [VERDICT_WORDS[call.verdict], *filter(None, (margin_words, f"{call.area.replace('-', ' ')}: {chances}"))]
    sizes = [large, *(small for _ in lines[1:])]
    masks = [text_mask(line, size, k == 0) for k, (line, size) in enumerate(zip(lines, sizes, strict=True))]
    width = min(max(mask.shape[1] for mask in masks) + 2 * small, image.shape[1] - 2 * margin)
    height = sum(mask.shape[0] for mask in masks) + small
    blend_mask(image, round_corner_mask(width, height, small // 2), margin, margin, INK, 0.8)
    y = margin + small // 2
    for line, size, mask in zip(lines, sizes, masks, strict=True):
        is_verdict = size == large
        draw_text(
            image, line, margin + small, y, size, VERDICT_COLOURS[call.verdict] if is_verdict else WHITE, is_verdict
        )
        y += mask.shape[0]
    return float(margin), float(margin), float(width), float(height)
