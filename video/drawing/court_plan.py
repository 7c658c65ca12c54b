"""A court drawn from above and from the side: lines, net, flights, hits, bounces, and where something landed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np

from models.core.court import Sport
from models.core.typing import FloatArray, ImageArray
from video.drawing.masks import SHIFT, to_fixed_point
from video.drawing.palette import FLASH, INK, MUTED_GREY, WHITE, Colour, mix_colours

# Surface of the court, and what lies around it.
COURT_COLOUR, GROUND_COLOUR = (38, 92, 78), (24, 40, 44)
# Colours of the strokes of both sides, the nearer or left one first; both contrast with courts and with dark panels.
SIDE_COLOURS: dict[str, Colour] = {
    "near": (96, 214, 255), "left": (96, 214, 255), "far": (255, 168, 92), "right": (255, 168, 92), "": WHITE,
}  # fmt: skip
# Factor by which a drawing is larger before it is reduced, which makes its lines smooth.
SUPERSAMPLE = 2
# Share of the length of the court around it that is drawn, and m above the surface in a side view.
MARGIN_SHARE, SIDE_VIEW_HEIGHT = 0.13, {"badminton": 6.5, "tennis": 6.5, "table-tennis": 1.6}
# Largest number of standard deviations of an outline: 2 enclose 86 % of the places.
OUTLINE_SIGMAS = 2.0

View = Literal["above", "side"]


@dataclass(frozen=True, slots=True)
class CourtDrawing:
    """A drawing of a court to which paths and marks are added."""

    canvas: ImageArray
    """(h, w, 3), `SUPERSAMPLE` times the final size."""
    to_canvas: FloatArray
    """(2, 4) from x, y, z, 1, m, to px of the canvas."""

    @property
    def size(self) -> tuple[int, int]:
        """Final width and height, px."""
        return self.canvas.shape[1] // SUPERSAMPLE, self.canvas.shape[0] // SUPERSAMPLE

    def to_pixels(self, xyz: FloatArray) -> FloatArray:
        """Map places (..., 3), m, to px (..., 2) of the canvas."""
        return np.asarray(xyz @ self.to_canvas[:, :3].T + self.to_canvas[:, 3])

    def draw_path(self, xyz: FloatArray, colour: Colour, width: float = 2.0) -> None:
        """Draw a path (n, 3), m."""
        px = to_fixed_point(self.to_pixels(xyz[np.isfinite(xyz).all(axis=1)]))
        cv2.polylines(self.canvas, [px], False, colour, round(width * SUPERSAMPLE), cv2.LINE_AA, SHIFT)

    def draw_mark(self, place: FloatArray, colour: Colour, radius: float = 3.0) -> None:
        """Draw a disc of a radius (px of the final drawing) at a place (3,), m."""
        if np.isfinite(place).all():
            centre = to_fixed_point(self.to_pixels(place)).tolist()
            reach = round(radius * SUPERSAMPLE * (1 << SHIFT))
            cv2.circle(self.canvas, centre, reach + (SUPERSAMPLE << SHIFT), INK, -1, cv2.LINE_AA, SHIFT)
            cv2.circle(self.canvas, centre, reach, colour, -1, cv2.LINE_AA, SHIFT)

    def draw_ellipse(self, place: FloatArray, covariance: FloatArray, colour: Colour) -> None:
        """Draw the outline of `OUTLINE_SIGMAS` of a place (3,), m, with a covariance (3, 3), m^2; at least a ring."""
        if np.isfinite(place).all() and np.isfinite(covariance).all():
            by = self.to_canvas[:, :3]
            outline = self.to_pixels(place) + find_ellipse(by @ covariance @ by.T, OUTLINE_SIGMAS)
            cv2.polylines(self.canvas, [to_fixed_point(outline)], True, colour, SUPERSAMPLE, cv2.LINE_AA, SHIFT)

    def copy(self) -> CourtDrawing:
        """Return a drawing whose canvas is a copy of this one's."""
        return CourtDrawing(self.canvas.copy(), self.to_canvas)

    def render(self) -> ImageArray:
        """Render the drawing (h, w, 3) in its final size."""
        return np.asarray(cv2.resize(self.canvas, self.size, interpolation=cv2.INTER_AREA), np.uint8)


def find_ellipse(covariance: FloatArray, sigmas: float, count: int = 49) -> FloatArray:
    """Find the outline (count, 2) of a normal distribution with a covariance (2, 2) around (0, 0)."""
    values, axes = np.linalg.eigh(covariance)
    angle = np.linspace(0, 2 * np.pi, count)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return np.asarray(sigmas * (circle * np.sqrt(np.maximum(values, 0))) @ axes.T)


def outline_line(start: Sequence[float], end: Sequence[float], width: float) -> FloatArray:
    """Outline the paint of a line: corners (4, 2), m; it is as long as its centre."""
    ends = np.array([start, end], np.float64)
    way = ends[1] - ends[0]
    aside = np.array([-way[1], way[0]]) / max(float(np.hypot(*way)), 1e-9) * width / 2
    return np.array([ends[0] - aside, ends[1] - aside, ends[1] + aside, ends[0] + aside])


def draw_court(sport: Sport, longest: int, view: View = "above") -> CourtDrawing:
    """Draw an empty court.

    Args:
        longest: Longer side of the drawing, px.
        view: From above, as it lies in the image: the far end on top, or the left end on the left; or from the side,
            with its nearer or left end on the left.
    """
    margin = MARGIN_SHARE * sport.length
    if view == "side":
        top = SIDE_VIEW_HEIGHT.get(sport.name, sport.length / 2)
        spans = np.array([sport.length + 2 * margin, top - sport.floor + margin / 2])
        axes, origin = np.array([[1.0, 0, 0], [0, 0, -1.0]]), np.array([margin, top])
    elif sport.is_filmed_from_side:
        spans = np.array([sport.length, sport.width]) + 2 * margin
        axes, origin = np.array([[1.0, 0, 0], [0, -1.0, 0]]), np.array([margin, sport.width + margin])
    else:
        spans = np.array([sport.width, sport.length]) + 2 * margin
        axes, origin = np.array([[0, 1.0, 0], [-1.0, 0, 0]]), np.array([margin, sport.length + margin])
    scale = longest * SUPERSAMPLE / float(spans.max())
    columns, rows = (max(round(span * scale / SUPERSAMPLE), 2) * SUPERSAMPLE for span in spans)
    canvas = np.full((rows, columns, 3), GROUND_COLOUR, np.uint8)
    drawing = CourtDrawing(canvas, scale * np.column_stack([axes, origin]))
    _draw_profile(drawing, sport) if view == "side" else _draw_ground(drawing, sport)
    return drawing


def _draw_ground(drawing: CourtDrawing, sport: Sport) -> None:
    """Draw surface, lines and net as seen from above."""
    corners = np.column_stack([sport.corners, np.zeros(4)])
    _fill_shape(drawing, corners, COURT_COLOUR)
    for line in sport.lines:
        ends = np.array([[*line.start, 0.0], [*line.end, 0.0]])
        drawing.draw_path(ends, mix_colours(COURT_COLOUR, WHITE, 0.8), 1.0)
    middle, out = sport.length / 2, sport.net.overhang
    drawing.draw_path(np.array([[middle, -out, 0], [middle, sport.width + out, 0]]), MUTED_GREY, 2.0)


def _draw_profile(drawing: CourtDrawing, sport: Sport) -> None:
    """Draw floor, table and net as seen from the side."""
    away, middle = MARGIN_SHARE * sport.length, sport.length / 2
    drawing.draw_path(np.array([[-away, 0, sport.floor], [sport.length + away, 0, sport.floor]]), MUTED_GREY, 1.0)
    drawing.draw_path(np.array([[0, 0, 0], [sport.length, 0, 0.0]]), mix_colours(COURT_COLOUR, WHITE, 0.5), 3.0)
    drawing.draw_path(np.array([[middle, 0, 0], [middle, 0, sport.net.height]]), WHITE, 2.0)
    for x in (0.0, sport.length):
        drawing.draw_path(np.array([[x, 0, 0], [x, 0, -0.02 * sport.length]]), MUTED_GREY, 1.0)


def _fill_shape(drawing: CourtDrawing, corners: FloatArray, colour: Colour) -> None:
    """Fill a polygon with corners (n, 3), m."""
    cv2.fillPoly(drawing.canvas, [to_fixed_point(drawing.to_pixels(corners))], colour, cv2.LINE_AA, SHIFT)


def draw_landing_mark(drawing: CourtDrawing, place: FloatArray, covariance: FloatArray) -> None:
    """Draw where something landed, with its error."""
    drawing.draw_ellipse(place, covariance, FLASH)
    drawing.draw_mark(place, FLASH, 2.5)
