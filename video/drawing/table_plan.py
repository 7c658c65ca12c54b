"""Drawing of a whole shot on the plan of its table: start, path and end of each ball, and the contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.ball_look import WHITE, BallLook, Colour
from models.core.naming import Naming, TableView, find_table_view
from models.core.scene import CUSHIONS, Scene, Table
from models.core.typing import ByteArray, FloatArray, ImageArray
from video.drawing.masks import (
    LINE_SPACING,
    SHIFT,
    blend_colours,
    blend_mask,
    draw_paragraph,
    draw_text,
    round_corner_mask,
    text_mask,
    wrap_text,
)
from video.drawing.palette import INK, MUTED_GREY, ensure_contrast, lab_to_rgb, mix_colours
from video.io.yuv_frame import Canvas

# Cloth of a table without footage.
CLOTH_COLOUR: Colour = (34, 104, 96)
# px, longer side of the drawing, and font size of the names of balls and rails.
PLAN_WIDTH, NAME_PX = 1280, 15
# px, font size and margin of the text below the table.
FOOTER_TEXT_PX, FOOTER_MARGIN = 17, 16
# Share of the cloth colour in a ball that is drawn at its start.
START_FADE = 0.55
# Half width of the band of a striped ball, ball radii.
BAND_SHARE = 0.5


def draw_ball_disc(canvas: ImageArray, centre: Sequence[int], radius: int, look: BallLook, faded: float = 0.0) -> None:
    """Draw a ball as the clip shows it: a disc of its paint, or a white one with a band of it.

    Args:
        canvas: Image (h, w, 3), drawn upon.
        centre: x, y in fixed-point px.
        radius: Radius in fixed-point px.
        look: How the ball looks.
        faded: Share of the cloth that shines through.
    """
    paint, white, edge = (mix_colours(colour, CLOTH_COLOUR, faded) for colour in (look.colour, WHITE, INK))
    cv2.circle(canvas, centre, radius + (SUPERSAMPLE << SHIFT), edge, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(canvas, centre, radius, paint, -1, cv2.LINE_AA, SHIFT)
    if look.is_striped:
        half = np.degrees(np.arccos(BAND_SHARE))
        for pole in (-90, 90):  # caps above and below the band
            arc = cv2.ellipse2Poly((0, 0), (radius, radius), 0, round(pole - half), round(pole + half), 4)
            cv2.fillPoly(canvas, [arc + np.asarray(centre, np.int32)], white, cv2.LINE_AA, SHIFT)


def draw_table_plan(
    table: Table,
    naming: Naming,
    ids: Sequence[str],
    paths: Sequence[FloatArray],
    contact_points: FloatArray,
    title: str,
    draw_background: Callable[[TableInset, Sequence[Colour]], None] | None = None,
    longest: int = PLAN_WIDTH,
    name_px: int = NAME_PX,
) -> ImageArray:
    """Draw the paths of the balls on an empty table that lies as in the clip.

    A ball is drawn faint at its start and solid at its end.

    Args:
        table: Table to draw.
        naming: Names and looks of the balls, and how the table lies in the frame.
        ids: Ids of the balls.
        paths: Path of each ball (n, 2), m; NaN makes a gap.
        contact_points: Positions of the contacts (m, 2), m.
        title: Text below the table, one or several lines; empty for none.
        draw_background: Function that draws on the empty table first, in the colours of the balls' lines.
        longest: Longer side without the text, px.
        name_px: Font size of the names of balls and rails, px.

    Returns:
        Image (h, w, 3).
    """
    inset = build_empty_inset(table, CLOTH_COLOUR, naming.view, longest)
    looks = [naming.find_look(name) for name in ids]
    lines = [ensure_contrast(look.colour, CLOTH_COLOUR) for look in looks]
    if draw_background is not None:
        draw_background(inset, lines)
    for path, colour in zip(paths, lines, strict=True):
        _draw_path(inset, path, colour)
    for mark in contact_points[np.isfinite(contact_points).all(axis=1)]:
        centre = inset.to_fixed_point(mark).tolist()
        cv2.circle(inset.canvas, centre, 3 * SUPERSAMPLE << SHIFT, WHITE, SUPERSAMPLE, cv2.LINE_AA, SHIFT)
    finite_paths = [path[np.isfinite(path).all(axis=1)] for path in paths]
    for which, faded in ((0, START_FADE), (-1, 0.0)):  # ends are drawn over starts
        for places, look in zip(finite_paths, looks, strict=True):
            if len(places):
                inset.draw_true_ball(table, places[which], look, faded)
    image = inset.reduce_canvas(inset.canvas)
    name_rails(image, inset, table, naming, name_px)
    for name, places in zip(ids, finite_paths, strict=True):
        if len(places):
            _draw_ball_name(image, inset, places[-1], naming.name_ball(name), name_px)
    return append_footer(image, title)


def name_rails(image: ImageArray, inset: TableInset, table: Table, naming: Naming, size: int = NAME_PX) -> None:
    """Write on each rail of a plan (h, w, 3) what a viewer of the clip calls it."""
    rail, length, width = RAIL_SHARE * table.length / 2, table.length, table.width
    aside = 5 / 16  # between two diamonds, away from pockets
    places = (
        (-rail, aside * width),
        (length + rail, aside * width),
        (aside * length, -rail),
        (aside * length, width + rail),
    )
    for cushion, place in zip(CUSHIONS, places, strict=True):
        text = naming.view.name_rail(cushion)
        height, breadth = text_mask(text, size).shape[:2]
        x, y = inset.to_fixed_point(np.array(place)) / (SUPERSAMPLE << SHIFT)
        left, top = np.clip([x - breadth / 2, y - height / 2], 0, [image.shape[1] - breadth, image.shape[0] - height])
        draw_text(image, text, int(left), int(top), size, MUTED_GREY)


def append_footer(image: ImageArray, text: str) -> ImageArray:
    """Append a strip with text below an image, so that it hides nothing.

    Args:
        image: Image (h, w, 3).
        text: One or several lines; empty for none.

    Returns:
        Image (h + strip, w, 3).
    """
    count = len(wrap_text(text, FOOTER_TEXT_PX, image.shape[1] - 2 * FOOTER_MARGIN))
    if not count:
        return image
    strip = np.full((count * round(LINE_SPACING * FOOTER_TEXT_PX) + 10, image.shape[1], 3), INK, np.uint8)
    draw_paragraph(strip, text, FOOTER_MARGIN, 5, FOOTER_TEXT_PX, WHITE)
    return np.vstack([image, strip])


def _draw_path(inset: TableInset, path: FloatArray, colour: Colour) -> None:
    """Draw a path (n, 2) m, interrupted where it is NaN."""
    whole = np.isfinite(path).all(axis=1)
    for part in np.split(path, np.flatnonzero(~whole)):
        line = part[np.isfinite(part).all(axis=1)]
        if len(line) > 1:
            points = inset.to_fixed_point(line).reshape(-1, 1, 2)
            cv2.polylines(inset.canvas, [points], False, colour, 2 * SUPERSAMPLE, cv2.LINE_AA, SHIFT)


def _draw_ball_name(image: ImageArray, inset: TableInset, place: FloatArray, name: str, size: int) -> None:
    """Draw the name beside its ball, inside the image."""
    x, y = inset.to_fixed_point(place) / (SUPERSAMPLE << SHIFT)
    mask = text_mask(name, size, bold=True)
    height, width = mask.shape[:2]
    away = inset.ball_radius / SUPERSAMPLE + 3
    left = x + away if x + away + width < image.shape[1] else x - away - width
    draw_text(image, name, int(max(left, 0)), int(np.clip(y - height / 2, 0, image.shape[0] - height)), size, WHITE)


# Width of the drawn rails, share of the table length.
RAIL_SHARE = 0.055
# Factor by which the canvas is larger than the final plan: reducing it gives even anti-aliasing.
SUPERSAMPLE = 2
# Factor by which balls are drawn larger than true to scale, to remain visible.
BALL_GROWTH = 1.35
WOOD: Colour = (58, 44, 36)


@dataclass(frozen=True, slots=True)
class TableInset:
    """A plan of the table, which lies as in the frame."""

    canvas: ImageArray
    """(h, w, 3) the empty table, `SUPERSAMPLE` times the final size."""
    table_to_canvas: FloatArray
    """(2, 3) affine map from m to px of `canvas`."""
    ball_radius: float
    """px of `canvas`."""

    @property
    def size(self) -> tuple[int, int]:
        """Final width and height, px."""
        return self.canvas.shape[1] // SUPERSAMPLE, self.canvas.shape[0] // SUPERSAMPLE

    def to_fixed_point(self, xy: FloatArray) -> NDArray[np.int32]:
        """Map points (..., 2) m to fixed-point px of `canvas`."""
        px = xy @ self.table_to_canvas[:, :2].T + self.table_to_canvas[:, 2]
        return np.asarray(np.rint(px * (1 << SHIFT)), dtype=np.int32)

    def draw_true_ball(self, table: Table, place: FloatArray, look: BallLook, faded: float = 0.0) -> None:
        """Draw a ball at (2,) m true to scale, so that touching balls touch in the drawing."""
        scale = float(np.linalg.norm(self.table_to_canvas[:, 0]))
        radius = round(table.ball_radius * scale * (1 << SHIFT))
        draw_ball_disc(self.canvas, self.to_fixed_point(place).tolist(), radius, look, faded)

    def add_path(self, canvas: ImageArray, path: FloatArray, colour: Colour) -> None:
        """Draw a path (n, 2) m onto a copy of `canvas`, in place."""
        if len(path) > 1:
            line = self.to_fixed_point(path).reshape(-1, 1, 2)
            cv2.polylines(canvas, [line], False, mix_colours(colour, WHITE, 0.35), SUPERSAMPLE + 1, cv2.LINE_AA, SHIFT)

    def reduce_canvas(self, canvas: ImageArray) -> ImageArray:
        """Reduce a copy of `canvas` that holds the paths to its final size."""
        return np.asarray(cv2.resize(canvas, self.size, interpolation=cv2.INTER_AREA), np.uint8)

    def draw_with_balls(
        self, image: Canvas, x: int, y: int, plan: ImageArray, xy: FloatArray, colours: Sequence[Colour]
    ) -> None:
        """Draw a result of `reduce_canvas` onto `image` at (x, y), with balls at `xy` (N, 2) m, NaN if absent."""
        blend_colours(image, plan, round_corner_mask(*self.size, max(3, self.size[1] // 24)), x, y)
        radius = round(self.ball_radius * (1 << SHIFT))
        is_present = np.atleast_1d(np.isfinite(xy).all(axis=1))
        centres = self.to_fixed_point(np.where(is_present[:, None], xy, 0)).tolist()
        for (column, row), colour, present in zip(centres, colours, is_present, strict=True):
            if present:
                rim = mix_colours(INK, colour, 0.15)
                for reach, paint in ((radius + (1 << SHIFT), rim), (radius, colour)):
                    cover = _plan_disc(reach, column % PLAN_PX, row % PLAN_PX)
                    left, top = (place // PLAN_PX - cover.shape[0] // 2 for place in (column, row))
                    blend_mask(image, cover, x + left, y + top, paint)


# Fixed-point px of the canvas per px of the plan.
PLAN_PX = SUPERSAMPLE << SHIFT


@lru_cache(maxsize=4096)
def _plan_disc(radius: int, column: int, row: int) -> ByteArray:
    """Return the coverage of a disc whose centre is in the middle pixel of the plan; all in fixed-point px.

    Cached: over a shot, balls are drawn at the same fractions of a pixel again and again.
    """
    half = -(-radius // PLAN_PX) + 1
    mask = np.zeros(2 * (SUPERSAMPLE * (2 * half + 1),), np.uint8)
    centre = (half * PLAN_PX + column, half * PLAN_PX + row)
    cv2.circle(mask, centre, radius, 255, -1, cv2.LINE_AA, SHIFT)
    return np.asarray(cv2.resize(mask, None, fx=1 / SUPERSAMPLE, fy=1 / SUPERSAMPLE, interpolation=cv2.INTER_AREA))


def build_table_inset(scene: Scene, longest: int) -> TableInset:
    """Build the plan of a calibrated table in the orientation that the table has in the frame.

    Args:
        scene: Table, camera and cloth colour.
        longest: Longer side of the plan, px.

    Returns:
        The plan without balls and paths.
    """
    view = find_table_view(scene.camera, scene.table)
    return build_empty_inset(scene.table, lab_to_rgb(scene.cloth_lab), view, longest)


def build_empty_inset(table: Table, cloth: Colour, view: TableView, longest: int) -> TableInset:
    """Build the plan of an empty table.

    Args:
        table: Table to draw.
        cloth: Colour of the cloth.
        view: How the table lies in the frame.
        longest: Longer side of the plan, px.

    Returns:
        The plan without balls and paths.
    """
    rail = RAIL_SHARE * table.length
    scale = longest * SUPERSAMPLE / (table.length + 2 * rail)
    origin, *units = view.turn_points(np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), table)
    to_plan = scale * np.column_stack([*(unit - origin for unit in units), origin + rail])
    columns, rows = (round((side + 2 * rail) * scale / SUPERSAMPLE) * SUPERSAMPLE for side in view.find_size(table))
    radius = max(BALL_GROWTH * table.ball_radius * scale, 2.2 * SUPERSAMPLE)
    inset = TableInset(np.full((rows, columns, 3), WOOD, dtype=np.uint8), to_plan, radius)
    _draw_table(inset, table, cloth, scale)
    return inset


def _draw_table(inset: TableInset, table: Table, cloth: Colour, scale: float) -> None:
    """Draw cushions, cloth, diamonds and pockets."""
    rail = RAIL_SHARE * table.length
    nose = 0.35 * rail
    for grow, colour in ((nose, mix_colours(cloth, INK, 0.35)), (0.0, mix_colours(cloth, INK, 0.08))):
        corners = np.array([[-grow, -grow], [table.length + grow, table.width + grow]])
        low, high = (inset.to_fixed_point(corner) for corner in corners)
        cv2.rectangle(inset.canvas, low.tolist(), high.tolist(), colour, -1, cv2.LINE_AA, SHIFT)
    pockets = table.pocket_centres
    for diamond in _diamond_positions(table, 0.67 * rail):
        if not len(pockets) or np.linalg.norm(pockets - diamond, axis=1).min() > 1.5 * rail:
            centre = inset.to_fixed_point(diamond).tolist()
            cv2.circle(inset.canvas, centre, 2 << SHIFT, (214, 206, 190), -1, cv2.LINE_AA, SHIFT)
    for pocket in pockets:
        radius = round(2.1 * table.ball_radius * scale * (1 << SHIFT))
        cv2.circle(inset.canvas, inset.to_fixed_point(pocket).tolist(), radius, INK, -1, cv2.LINE_AA, SHIFT)


def _diamond_positions(table: Table, away: float) -> FloatArray:
    """Return the rail marks (n, 2) m: eighths of the length and fourths of the width, `away` m outside the noses."""
    eighths, fourths = np.arange(1, 8) * table.length / 8, np.arange(1, 4) * table.width / 4
    rows = [np.column_stack([eighths, np.full(7, y)]) for y in (-away, table.width + away)]
    columns = [np.column_stack([np.full(3, x), fourths]) for x in (-away, table.length + away)]
    return np.concatenate(rows + columns)
