"""Overlays that show where balls lay, and how present balls must move to lie there again."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.naming import Naming
from models.core.scene import CUSHIONS, Camera, Table
from models.core.typing import FloatArray, ImageArray
from models.estimation.ball_places import find_nearest_cushions
from video.drawing.label_layout import Rect, overlap_share, place_label
from video.drawing.masks import (
    SHIFT,
    blend_mask,
    draw_panel,
    draw_text,
    drawing_scale,
    measure_panel,
    round_corner_mask,
    text_mask,
    to_fixed_point,
)
from video.drawing.palette import INK, MUTED_GREY, TRUST_COLOURS, WHITE, Colour, ensure_contrast, mix_colours
from video.drawing.table_plan import (
    CLOTH_COLOUR,
    SUPERSAMPLE,
    TableInset,
    append_footer,
    build_empty_inset,
    name_rails,
)

# Points of the outline of a ball.
OUTLINE_POINTS = 72
# px, font sizes on a frame of 720 rows.
TEXT_PX, HEADER_PX = 15, 17
# Least length of an arrow in ball radii: a shift of two millimetres is a pixel or two.
MIN_ARROW_RADII = 0.9
# Colour of a ball that lies where it is wanted.
PLACED_COLOUR: Colour = TRUST_COLOURS["green"]
# Colour of a ball that must still be moved.
MISPLACED_COLOUR: Colour = TRUST_COLOURS["amber"]
# Colour of a wanted place without a ball.
MISSING_COLOUR: Colour = TRUST_COLOURS["red"]
# Colour of a place on the frame that it comes from.
WANTED_COLOUR: Colour = WHITE
# Colour of notes.
NOTE_COLOUR: Colour = MUTED_GREY


@dataclass(frozen=True, slots=True)
class PlacedRing:
    """A wanted place of a ball on an image."""

    xy: FloatArray
    """(2,) m, where the ball is wanted."""
    colour: Colour
    label: str
    """Text beside the ring; empty for none."""
    present: FloatArray | None = None
    """(2,) m, where the ball lies now; None if it was not found, or on the frame that the places come from."""


def project_ball_outline(camera: Camera, xy: FloatArray, radius: float) -> FloatArray:
    """Project the outline of a ball on the cloth.

    The outline is the circle in which the cone of lines of sight touches the sphere; its image is an ellipse whose
    centre lies further from the image centre than that of the ball.

    Args:
        xy: Centre (2,) of the ball, m.
        radius: Radius of the ball, m.

    Returns:
        Points (`OUTLINE_POINTS`, 2) px of the reference image.
    """
    centre = np.append(xy, radius)
    sight = camera.position - centre
    distance = float(np.linalg.norm(sight))
    normal = sight / distance
    across = np.cross(normal, np.eye(3)[int(np.argmin(np.abs(normal)))])
    across /= np.linalg.norm(across)
    ring = radius * np.sqrt(max(1 - (radius / distance) ** 2, 0.0))
    angle = np.linspace(0, 2 * np.pi, OUTLINE_POINTS, endpoint=False)[:, None]
    points = centre + normal * radius**2 / distance
    points = points + ring * (np.cos(angle) * across + np.sin(angle) * np.cross(normal, across))
    homogeneous = points @ camera.matrix[:, :3].T + camera.matrix[:, 3]
    return np.asarray(homogeneous[:, :2] / homogeneous[:, 2:])


def draw_places(
    image: ImageArray,
    camera: Camera,
    rings: list[PlacedRing],
    radius: float,
    header: list[tuple[str, Colour]],
    names: Sequence[tuple[str, FloatArray]] = (),
) -> ImageArray:
    """Draw wanted places on an image: rings, arrows from present balls, and labels.

    Args:
        image: Image (H, W, 3), which is not modified.
        camera: The camera of the image.
        rings: The wanted places.
        radius: Radius of the balls, m.
        header: Lines in the top left corner with their colours.
        names: Names to write at points (2,) px, such as those of the cushions.

    Returns:
        The drawing (H, W, 3).
    """
    drawn, scale = image.copy(), drawing_scale(image.shape[0])
    outlines = [project_ball_outline(camera, ring.xy, radius) for ring in rings]
    for ring, outline in zip(rings, outlines, strict=True):
        _stroke_line(drawn, outline, INK, 3.6 * scale, closed=True, opacity=0.55)
        _stroke_line(drawn, outline, ring.colour, 2.0 * scale, closed=True)
        _draw_cross(drawn, outline.mean(axis=0), ring.colour, scale)
    obstacles = [_bound_points(outline) for outline in outlines]
    for ring, outline in zip(rings, outlines, strict=True):
        if ring.present is not None:
            now = project_ball_outline(camera, ring.present, radius)
            obstacles.append(_bound_points(now))
            _draw_arrow(drawn, now, outline, ring.colour, scale)
    obstacles.append(_draw_header(drawn, header, scale))
    obstacles += [draw_panel(drawn, name, at, round(TEXT_PX * scale), NOTE_COLOUR) for name, at in names]
    for ring, outline in zip(rings, outlines, strict=True):
        if ring.label:
            obstacles.append(_draw_label(drawn, ring, outline, obstacles, scale))
    return drawn


def _draw_cross(image: ImageArray, centre: FloatArray, colour: Colour, scale: float) -> None:
    """Mark the centre of a wanted place."""
    for step in (np.array([2.5 * scale, 0.0]), np.array([0.0, 2.5 * scale])):
        _stroke_line(image, np.stack([centre - step, centre + step]), colour, 1.0 * scale)


def _draw_arrow(image: ImageArray, now: FloatArray, wanted: FloatArray, colour: Colour, scale: float) -> None:
    """Draw an arrow from the present place to the wanted one; a short one is lengthened in its direction."""
    start, end = now.mean(axis=0), wanted.mean(axis=0)
    length = float(np.linalg.norm(end - start))
    if length < 0.05:
        return
    radius = float(np.ptp(wanted, axis=0).max()) / 2
    direction = (end - start) / length
    end = start + direction * max(length, MIN_ARROW_RADII * radius)
    side = np.array([-direction[1], direction[0]])
    head = max(0.35 * radius, 4.0 * scale)
    tip = np.stack([end - head * direction + 0.6 * head * side, end, end - head * direction - 0.6 * head * side])
    for line in (np.stack([start, end]), tip):
        _stroke_line(image, line, INK, 3.6 * scale, opacity=0.55)
    for line in (np.stack([start, end]), tip):
        _stroke_line(image, line, colour, 2.0 * scale)


def _stroke_line(
    image: ImageArray, points: FloatArray, colour: Colour, width: float, closed: bool = False, opacity: float = 1.0
) -> None:
    """Draw a polyline (n, 2) px with smooth edges, in place, through a mask as small as the line."""
    margin = int(np.ceil(width)) + 2
    low = np.floor(points.min(axis=0)).astype(int) - margin
    size = np.ceil(points.max(axis=0)).astype(int) + margin - low
    if not np.isfinite(points).all() or (size > 4 * max(image.shape)).any():
        return
    mask = np.zeros((int(size[1]), int(size[0])), np.uint8)
    line: NDArray[np.int32] = to_fixed_point(points - low).reshape(-1, 1, 2)
    cv2.polylines(mask, [line], closed, 255, max(1, round(width)), cv2.LINE_AA, SHIFT)
    blend_mask(image, mask, int(low[0]), int(low[1]), colour, opacity)


def _bound_points(points: FloatArray) -> Rect:
    """Return the rectangle around points (n, 2) px."""
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    return float(low[0]), float(low[1]), float(size[0]), float(size[1])


def _draw_label(image: ImageArray, ring: PlacedRing, outline: FloatArray, obstacles: list[Rect], scale: float) -> Rect:
    """Draw the label of a ring where it hides little; return its rectangle."""
    size = round(TEXT_PX * scale)
    box = measure_panel(ring.label, size)
    centre, radius = outline.mean(axis=0), float(np.ptp(outline, axis=0).max()) / 2
    position = place_label(box, centre, radius, np.zeros(2), obstacles, (image.shape[1], image.shape[0]), None)
    middle = centre + position.top_left_corner(box, radius) + np.array(box) / 2
    return draw_panel(image, ring.label, middle, size, ring.colour)


def _draw_header(image: ImageArray, header: list[tuple[str, Colour]], scale: float) -> Rect:
    """Draw lines of text on a dark panel in the top left corner; return its rectangle."""
    if not header:
        return 0.0, 0.0, 1.0, 1.0
    size_px = round(HEADER_PX * scale)
    masks = [text_mask(text, size_px, bold=k == 0) for k, (text, _) in enumerate(header)]
    margin = round(9 * scale)
    width, height = max(m.shape[1] for m in masks) + 2 * margin, sum(m.shape[0] for m in masks) + margin
    blend_mask(image, round_corner_mask(width, height, max(3, margin)), margin, margin, INK, 0.78)
    top = margin + margin // 2
    for k, (text, colour) in enumerate(header):
        draw_text(image, text, 2 * margin, top, size_px, colour, bold=k == 0)
        top += masks[k].shape[0]
    return float(margin), float(margin), float(width), float(height)


# px, width of the drawing.
PLAN_WIDTH_PX = 1680
# px, font sizes.
NUMBER_PX, NAME_PX = 16, 16
# Places of a number along its line, in order of preference, as shares of the way from the ball to the nose.
LINE_SHARES = (0.5, 0.35, 0.65, 0.22, 0.78)
_OUTWARDS = {"left": (-1, 0), "right": (1, 0), "top": (0, -1), "bottom": (0, 1)}


def draw_placement_plan(
    table: Table, naming: Naming, ids: Sequence[str], xy: FloatArray, distances: FloatArray, title: str
) -> ImageArray:
    """Draw the balls of a table to scale, each with a line and the distance to its two nearest cushions.

    Args:
        naming: Names and looks of the balls, and how the table lies in the frame.
        ids: Ids of the N balls.
        xy: Centres (N, 2), m.
        distances: Distances (N, 4), m, of the centres to the noses in the order of `CUSHIONS`.
        title: Line of text below the plan.

    Returns:
        Image (h, `PLAN_WIDTH_PX`, 3).
    """
    inset = build_empty_inset(table, CLOTH_COLOUR, naming.view, PLAN_WIDTH_PX)
    looks = [naming.find_look(name) for name in ids]
    colours = [ensure_contrast(look.colour, CLOTH_COLOUR) for look in looks]
    lines = [_list_dimension_lines(place, row) for place, row in zip(xy, distances, strict=True)]
    for own, colour in zip(lines, colours, strict=True):
        for start, end, _ in own:
            _draw_dimension_line(inset, start, end, mix_colours(colour, CLOTH_COLOUR, 0.25))
    scale = float(np.linalg.norm(inset.table_to_canvas[:, 0]))
    radius = table.ball_radius * scale
    for place, look in zip(xy, looks, strict=True):
        inset.draw_true_ball(table, place, look)
    image = inset.reduce_canvas(inset.canvas)
    name_rails(image, inset, table, naming)
    _draw_texts(image, inset, [look.name for look in looks], xy, lines, colours, radius / SUPERSAMPLE)
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
    box = np.array(measure_panel(text, size_px))
    corners = np.clip(np.array(places) - box / 2, 0, np.array(image.shape[1::-1]) - box)
    shares = [round(overlap_share((*corner, *box.tolist()), taken), 3) for corner in corners.tolist()]
    return draw_panel(image, text, corners[int(np.argmin(shares))] + box / 2, size_px, colour)
