"""Drawing of a whole shot on the plan of its table: start, path and end of each ball, and the contacts."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import INK, KIND_COLOURS, WHITE, Colour, ensure_contrast, mix_colours
from video.drawing.table_inset import SHIFT, SUPERSAMPLE, TableInset, build_empty_inset
from video.drawing.text import draw_text, text_mask

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
