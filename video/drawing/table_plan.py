"""Drawing of a whole shot on the plan of its table: start, path and end of each ball, and the contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.scene import Scene, Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.circles import SHIFT
from video.drawing.palette import INK, KIND_COLOURS, WHITE, Colour, ensure_contrast, lab_to_rgb, mix_colours
from video.drawing.text import draw_text, round_corner_mask, text_mask
from video.io.pixel_kernels import blend_colours

CLOTH_COLOUR: Colour = (34, 104, 96)
"""Cloth of a table without footage."""
PLAN_WIDTH = 1280
"""px, width of the drawing."""
SPARE_COLOURS: tuple[Colour, ...] = (
    (246, 244, 232), (255, 206, 40), (232, 72, 60), (96, 160, 255), (255, 142, 178), (255, 150, 60), (150, 220, 110),
    (190, 140, 255),
)  # fmt: skip
"""Colours, in order, of balls whose names contain no colour."""
FOOTER_TEXT_PX, FOOTER_LINE_PX = 17, 24
"""px, font size and height of a line below the table."""
START_FADE = 0.55
"""Share of the cloth colour in a ball that is drawn at its start."""


def assign_ball_colours(ids: Sequence[str]) -> list[Colour]:
    """Assign a colour to each ball: the colour in its name (`red`, `cue`, `red-2`), else one of `SPARE_COLOURS`."""
    named = [KIND_COLOURS.get(name) or KIND_COLOURS.get(name.split("-")[0]) for name in ids]
    spare = [colour for colour in SPARE_COLOURS if colour not in named] or list(SPARE_COLOURS)
    unnamed = [k for k, colour in enumerate(named) if colour is None]
    for order, k in enumerate(unnamed):
        named[k] = spare[order % len(spare)]
    return [ensure_contrast(colour, CLOTH_COLOUR) for colour in named if colour is not None]


def draw_table_plan(
    table: Table,
    ids: Sequence[str],
    paths: Sequence[FloatArray],
    contact_points: FloatArray,
    title: str,
    draw_background: Callable[[TableInset, Sequence[Colour]], None] | None = None,
) -> ImageArray:
    """Draw the paths of the balls on an empty table.

    A ball is drawn faint at its start and solid at its end.

    Args:
        table: Table to draw.
        ids: Names of the balls.
        paths: Path of each ball (n, 2), m; NaN makes a gap.
        contact_points: Positions of the contacts (m, 2), m.
        title: Text below the table, one or several lines; empty for none.
        draw_background: Function that draws on the empty table first, in the colours of the balls.

    Returns:
        Image (h, `PLAN_WIDTH`, 3), higher than the table by the text.
    """
    inset = build_empty_inset(table, CLOTH_COLOUR, False, PLAN_WIDTH)
    colours = assign_ball_colours(ids)
    if draw_background is not None:
        draw_background(inset, colours)
    for path, colour in zip(paths, colours, strict=True):
        _draw_path(inset, path, colour)
    for mark in contact_points[np.isfinite(contact_points).all(axis=1)]:
        cv2.circle(
            inset.canvas,
            inset.to_fixed_point(mark).tolist(),
            3 * SUPERSAMPLE << SHIFT,
            WHITE,
            SUPERSAMPLE,
            cv2.LINE_AA,
            SHIFT,
        )
    finite_paths = [path[np.isfinite(path).all(axis=1)] for path in paths]
    for which, share in ((0, START_FADE), (-1, 0.0)):  # ends are drawn over starts
        for places, colour in zip(finite_paths, colours, strict=True):
            if len(places):
                _draw_ball(
                    inset,
                    table,
                    places[which],
                    mix_colours(colour, CLOTH_COLOUR, share),
                    mix_colours(INK, CLOTH_COLOUR, share),
                )
    image = cv2.resize(inset.canvas, inset.size, interpolation=cv2.INTER_AREA)
    for name, places in zip(ids, finite_paths, strict=True):
        if len(places):
            _draw_ball_name(image, inset, places[-1], name)
    return append_footer(np.asarray(image, dtype=np.uint8), title)


def append_footer(image: ImageArray, text: str) -> ImageArray:
    """Append a strip with text below an image, so that it hides nothing.

    Args:
        image: Image (h, w, 3).
        text: One or several lines; empty for none.

    Returns:
        Image (h + strip, w, 3).
    """
    lines = text.splitlines()
    if not lines:
        return image
    strip = np.full((len(lines) * FOOTER_LINE_PX + 10, image.shape[1], 3), INK, np.uint8)
    for k, line in enumerate(lines):
        draw_text(strip, line, 16, 5 + k * FOOTER_LINE_PX, FOOTER_TEXT_PX, WHITE)
    return np.vstack([image, strip])


def _draw_path(inset: TableInset, path: FloatArray, colour: Colour) -> None:
    """Draw a path (n, 2) m, interrupted where it is NaN."""
    whole = np.isfinite(path).all(axis=1)
    for part in np.split(path, np.flatnonzero(~whole)):
        line = part[np.isfinite(part).all(axis=1)]
        if len(line) > 1:
            points = inset.to_fixed_point(line).reshape(-1, 1, 2)
            cv2.polylines(inset.canvas, [points], False, colour, 2 * SUPERSAMPLE, cv2.LINE_AA, SHIFT)


def _draw_ball(inset: TableInset, table: Table, place: FloatArray, colour: Colour, edge: Colour) -> None:
    """Draw a ball true to scale, so that touching balls touch in the drawing."""
    scale = float(np.linalg.norm(inset.table_to_canvas[:, 0]))
    centre, radius = inset.to_fixed_point(place).tolist(), round(table.ball_radius * scale * (1 << SHIFT))
    cv2.circle(inset.canvas, centre, radius + (SUPERSAMPLE << SHIFT), edge, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(inset.canvas, centre, radius, colour, -1, cv2.LINE_AA, SHIFT)


def _draw_ball_name(image: ImageArray, inset: TableInset, place: FloatArray, name: str) -> None:
    """Draw the name beside its ball, inside the image."""
    x, y = inset.to_fixed_point(place) / (SUPERSAMPLE << SHIFT)
    mask = text_mask(name, 15, bold=True)
    height, width = mask.shape[:2]
    away = inset.ball_radius / SUPERSAMPLE + 3
    left = x + away if x + away + width < image.shape[1] else x - away - width
    draw_text(image, name, int(max(left, 0)), int(np.clip(y - height / 2, 0, image.shape[0] - height)), 15, WHITE)


RAIL_SHARE = 0.055
"""Width of the drawn rails, share of the table length."""
SUPERSAMPLE = 2
"""Factor by which the canvas is larger than the final plan: reducing it gives even anti-aliasing."""
BALL_GROWTH = 1.35
"""Factor by which balls are drawn larger than true to scale, to remain visible."""
WOOD: Colour = (58, 44, 36)


@dataclass(frozen=True, slots=True)
class TableInset:
    """A plan of the table in the orientation that the table has in the frame."""

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

    def draw(
        self, image: ImageArray, x: int, y: int, xy: FloatArray, paths: Sequence[FloatArray], colours: Sequence[Colour]
    ) -> None:
        """Draw the plan onto `image` at (x, y) with balls at `xy` (N, 2) m, NaN if absent, and their paths (n, 2) m."""
        canvas = self.canvas.copy()
        for path, colour in zip(paths, colours, strict=True):
            self.add_path(canvas, path, colour)
        self.draw_with_balls(image, x, y, canvas, xy, colours)

    def add_path(self, canvas: ImageArray, path: FloatArray, colour: Colour) -> None:
        """Draw a path (n, 2) m onto a copy of `canvas`, in place."""
        if len(path) > 1:
            line = self.to_fixed_point(path).reshape(-1, 1, 2)
            cv2.polylines(canvas, [line], False, mix_colours(colour, WHITE, 0.35), SUPERSAMPLE + 1, cv2.LINE_AA, SHIFT)

    def draw_with_balls(
        self, image: ImageArray, x: int, y: int, canvas: ImageArray, xy: FloatArray, colours: Sequence[Colour]
    ) -> None:
        """Draw a copy of `canvas` that already holds the paths onto `image` at (x, y), with balls at `xy` (N, 2) m."""
        canvas = canvas.copy()
        radius, is_present = round(self.ball_radius * (1 << SHIFT)), np.atleast_1d(np.isfinite(xy).all(axis=1))
        centres = self.to_fixed_point(np.where(is_present[:, None], xy, 0)).tolist()
        for centre, colour, present in zip(centres, colours, is_present, strict=True):
            if present:
                cv2.circle(
                    canvas, centre, radius + (1 << SHIFT), mix_colours(INK, colour, 0.15), -1, cv2.LINE_AA, SHIFT
                )
                cv2.circle(canvas, centre, radius, colour, -1, cv2.LINE_AA, SHIFT)
        width, height = self.size
        small = cv2.resize(canvas, (width, height), interpolation=cv2.INTER_AREA)
        corner = max(3, height // 24)
        cover = round_corner_mask(width, height, corner) * np.float32(1 / 255)
        image[y + corner : y + height - corner, x : x + width] = small[corner:-corner]
        for rows in (slice(0, corner), slice(height - corner, height)):  # only the rounded corners are transparent
            blend_colours(image, small[rows], cover[rows], x, y + rows.start, 1.0)


def build_table_inset(scene: Scene, longest: int) -> TableInset:
    """Build the plan of a calibrated table in the orientation that the table has in the frame.

    Args:
        scene: Table, camera and cloth colour.
        longest: Longer side of the plan, px.

    Returns:
        The plan without balls and paths.
    """
    return build_empty_inset(scene.table, lab_to_rgb(scene.cloth_lab), _is_upright(scene), longest)


def build_empty_inset(table: Table, cloth: Colour, upright: bool, longest: int) -> TableInset:
    """Build the plan of an empty table.

    Args:
        table: Table to draw.
        cloth: Colour of the cloth.
        upright: True if the x axis runs down, False if it runs to the right.
        longest: Longer side of the plan, px.

    Returns:
        The plan without balls and paths.
    """
    rail = RAIL_SHARE * table.length
    scale = longest * SUPERSAMPLE / (table.length + 2 * rail)
    sides = (table.length, table.width)
    long_px, short_px = (round((side + 2 * rail) * scale / SUPERSAMPLE) * SUPERSAMPLE for side in sides)
    if upright:
        to_plan = np.array([[0.0, -scale, (table.width + rail) * scale], [scale, 0.0, rail * scale]])
        shape = (long_px, short_px)
    else:
        to_plan = np.array([[scale, 0.0, rail * scale], [0.0, scale, rail * scale]])
        shape = (short_px, long_px)
    radius = max(BALL_GROWTH * table.ball_radius * scale, 2.2 * SUPERSAMPLE)
    inset = TableInset(np.full((*shape, 3), WOOD, dtype=np.uint8), to_plan, radius)
    _draw_table(inset, table, cloth, scale)
    return inset


def _is_upright(scene: Scene) -> bool:
    """Return whether the longer side of the table is closer to vertical than to horizontal in the frame."""
    middle = np.array([[0.5, 0.5], [0.51, 0.5]]) * [scene.table.length, scene.table.width]
    step = np.diff(scene.camera.to_pixels(middle, 0.0), axis=0)[0]
    return bool(abs(step[1]) > abs(step[0]))


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
            cv2.circle(
                inset.canvas,
                inset.to_fixed_point(diamond).tolist(),
                2 << SHIFT,
                (214, 206, 190),
                -1,
                cv2.LINE_AA,
                SHIFT,
            )
    for pocket in pockets:
        radius = round(2.1 * table.ball_radius * scale * (1 << SHIFT))
        cv2.circle(inset.canvas, inset.to_fixed_point(pocket).tolist(), radius, INK, -1, cv2.LINE_AA, SHIFT)


def _diamond_positions(table: Table, away: float) -> FloatArray:
    """Return the rail marks (n, 2) m: eighths of the length and fourths of the width, `away` m outside the noses."""
    eighths, fourths = np.arange(1, 8) * table.length / 8, np.arange(1, 4) * table.width / 4
    rows = [np.column_stack([eighths, np.full(7, y)]) for y in (-away, table.width + away)]
    columns = [np.column_stack([np.full(3, x), fourths]) for x in (-away, table.length + away)]
    return np.concatenate(rows + columns)
