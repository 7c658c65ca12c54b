"""Plan of a table with the places of its balls and their distances to the two nearest cushions."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray, ImageArray
from models.estimation.ball_placement.ball_places import find_nearest_cushions
from video.drawing.label_layout import Rect, overlap_share
from video.drawing.palette import INK, WHITE, Colour, ensure_contrast, mix_colours
from video.drawing.table_inset import SHIFT, SUPERSAMPLE, TableInset, build_empty_inset
from video.drawing.table_plan import CLOTH_COLOUR, append_footer, assign_ball_colours
from video.drawing.text import blend_mask, draw_text, round_corner_mask, text_mask

PLAN_WIDTH_PX = 1680
"""px, width of the drawing."""
NUMBER_PX, NAME_PX = 16, 16
"""px, font sizes."""
LINE_SHARES = (0.5, 0.35, 0.65, 0.22, 0.78)
"""Places of a number along its line, in order of preference, as shares of the way from the ball to the nose."""
_OUTWARDS = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}


def draw_placement_plan(
    table: Table, ids: Sequence[str], xy: FloatArray, distances: FloatArray, title: str
) -> ImageArray:
    """Draw the balls of a table to scale, each with a line and the distance to its two nearest cushions.

    Args:
        table: The table.
        ids: Names of the N balls.
        xy: Centres (N, 2), m.
        distances: Distances (N, 4), m, of the centres to the noses in the order of `CUSHIONS`.
        title: Line of text below the plan.

    Returns:
        Image (h, `PLAN_WIDTH_PX`, 3).
    """
    inset = build_empty_inset(table, CLOTH_COLOUR, False, PLAN_WIDTH_PX)
    colours = assign_ball_colours(ids)
    lines = [_list_dimension_lines(place, row) for place, row in zip(xy, distances, strict=True)]
    for own, colour in zip(lines, colours, strict=True):
        for start, end, _ in own:
            _draw_dimension_line(inset, start, end, mix_colours(colour, CLOTH_COLOUR, 0.25))
    scale = float(np.linalg.norm(inset.table_to_canvas[:, 0]))
    radius = table.ball_radius * scale
    for place, colour in zip(xy, colours, strict=True):
        centre = inset.to_fixed_point(place).tolist()
        for grow, ink in ((SUPERSAMPLE, INK), (0, colour)):
            size = round((radius + grow) * (1 << SHIFT))
            cv2.circle(inset.canvas, centre, size, ink, -1, cv2.LINE_AA, SHIFT)
    plan = cv2.resize(inset.canvas, inset.size, interpolation=cv2.INTER_AREA)
    image = np.asarray(plan, np.uint8)
    _draw_texts(image, inset, ids, xy, lines, colours, radius / SUPERSAMPLE)
    return append_footer(image, title)


def _list_dimension_lines(place: FloatArray, distances: FloatArray) -> list[tuple[FloatArray, FloatArray, float]]:
    """List start (2,), end (2,) and length (m) of the lines from a ball to its nearest noses, one per axis."""
    lines = []
    for side in find_nearest_cushions(distances):
        outwards = np.array(_OUTWARDS[CUSHIONS[side]], float)
        lines.append((place, place + outwards * distances[side], float(distances[side])))
    return lines


def _draw_dimension_line(inset: TableInset, start: FloatArray, end: FloatArray, colour: Colour) -> None:
    """Draw a line with a stroke across its end at the nose."""
    across = np.array([end[1] - start[1], start[0] - end[0]])
    length = float(np.linalg.norm(across))
    if length == 0:
        return
    stroke = across / length * 0.012
    for line in (np.stack([start, end]), np.stack([end - stroke, end + stroke])):
        points = inset.to_fixed_point(line).reshape(-1, 1, 2)
        cv2.polylines(inset.canvas, [points], False, colour, SUPERSAMPLE, cv2.LINE_AA, SHIFT)


def _draw_texts(
    image: ImageArray, inset: TableInset, ids: Sequence[str], xy: FloatArray,
    lines: list[list[tuple[FloatArray, FloatArray, float]]], colours: Sequence[Colour], radius: float,
) -> None:  # fmt: skip
    """Draw the numbers on their lines and the names beside the balls, where they hide little."""
    unit = 1 / (SUPERSAMPLE << SHIFT)
    centres = inset.to_fixed_point(xy.reshape(-1, 2)) * unit
    taken: list[Rect] = [(x - radius, y - radius, 2 * radius, 2 * radius) for x, y in centres.tolist()]
    for own, colour in zip(lines, colours, strict=True):
        for start, end, length in own:
            ends = inset.to_fixed_point(np.stack([start, end])) * unit
            places = [ends[0] + share * (ends[1] - ends[0]) for share in LINE_SHARES]
            text = f"{1e3 * length:.0f}"
            taken.append(_draw_tag(image, text, places, taken, ensure_contrast(colour, INK), NUMBER_PX))
    for name, centre in zip(ids, centres, strict=True):
        width = text_mask(name, NAME_PX, bold=True).shape[1]
        away = radius + 6
        offsets = ((away + width / 2, -away), (-away - width / 2, -away), (away + width / 2, away),
                   (-away - width / 2, away), (0, -away - 10), (0, away + 10))  # fmt: skip
        taken.append(_draw_tag(image, name, [centre + o for o in np.array(offsets)], taken, WHITE, NAME_PX))


def _draw_tag(
    image: ImageArray, text: str, places: list[FloatArray], taken: list[Rect], colour: Colour, size_px: int
) -> Rect:
    """Draw a text on a dark panel at the place where it covers least of what is taken; return its rectangle."""
    height, width = text_mask(text, size_px, bold=True).shape
    box = (width + 10, height)
    rects = []
    for place in places:
        left = float(np.clip(place[0] - box[0] / 2, 0, image.shape[1] - box[0]))
        top = float(np.clip(place[1] - box[1] / 2, 0, image.shape[0] - box[1]))
        rects.append((left, top, float(box[0]), float(box[1])))
    best = min(rects, key=lambda rect: round(overlap_share(rect, taken), 3))
    left_px, top_px = round(best[0]), round(best[1])
    blend_mask(image, round_corner_mask(*box, box[1] // 4), left_px, top_px, INK, 0.66)
    draw_text(image, text, left_px + 5, top_px, size_px, colour, bold=True)
    return best
