"""A shot drawn on its table from above: where every ball was, its way, and where it came to."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray, ImageArray
from video.drawing.palette import INK, KIND_COLOURS, WHITE, Colour, apart_from, mix
from video.drawing.table_inset import SHIFT, SUPERSAMPLE, WOOD, Inset, furnished
from video.drawing.text import lay, rounded_mask, text_mask, write

CLOTH: Colour = (34, 104, 96)
"""Of a table that no picture shows."""
WIDTH = 1280
"""px."""
SERIES: tuple[Colour, ...] = (
    (246, 244, 232), (255, 206, 40), (232, 72, 60), (96, 160, 255), (255, 142, 178), (255, 150, 60), (150, 220, 110),
    (190, 140, 255),
)  # fmt: skip
"""Colours of balls whose names say none, in order."""
TITLE = 18
"""px, size of the letters of the title."""
GHOST = 0.55
"""Share of cloth in what is drawn of a ball where it began."""


def colours_of(ids: Sequence[str]) -> list[Colour]:
    """A colour per ball: that of its name (`red`, `cue`, `red-2`), else one of `SERIES`."""
    named = [KIND_COLOURS.get(name) or KIND_COLOURS.get(name.split("-")[0]) for name in ids]
    spare = [colour for colour in SERIES if colour not in named] or list(SERIES)
    unnamed = [k for k, colour in enumerate(named) if colour is None]
    for order, k in enumerate(unnamed):
        named[k] = spare[order % len(spare)]
    return [apart_from(colour, CLOTH) for colour in named if colour is not None]


def draw_plan(
    table: Table,
    ids: Sequence[str],
    paths: Sequence[FloatArray],
    marks: FloatArray,
    title: str,
    below: Callable[[Inset, Sequence[Colour]], None] | None = None,
) -> ImageArray:
    """A still (h, `WIDTH`, 3) of the ways `paths` (n, 2) m of balls `ids`.

    `marks` (m, 2) m are where they met something. A ball is drawn faint where its way begins and
    whole where it ends; a way with NaN has gaps. `below` draws on the empty table first, in the colours of the balls.
    """
    inset = furnished(table, CLOTH, False, WIDTH)
    colours = colours_of(ids)
    if below is not None:
        below(inset, colours)
    for path, colour in zip(paths, colours, strict=True):
        _way(inset, path, colour)
    for mark in marks[np.isfinite(marks).all(axis=1)]:
        cv2.circle(
            inset.ground, inset.plan(mark).tolist(), 3 * SUPERSAMPLE << SHIFT, WHITE, SUPERSAMPLE, cv2.LINE_AA, SHIFT
        )
    seen = [path[np.isfinite(path).all(axis=1)] for path in paths]
    for which, share in ((0, GHOST), (-1, 0.0)):  # where a ball ends hides where another began, never the other way
        for places, colour in zip(seen, colours, strict=True):
            if len(places):
                _ball(inset, table, places[which], mix(colour, CLOTH, share), mix(INK, CLOTH, share))
    picture = cv2.resize(inset.ground, inset.size, interpolation=cv2.INTER_AREA)
    for name, places in zip(ids, seen, strict=True):
        if len(places):
            _name(picture, inset, places[-1], name)
    _entitle(picture, title)
    return np.asarray(picture, dtype=np.uint8)


def _entitle(picture: ImageArray, title: str) -> None:
    """The title on the lower rail, on a ground that hides the diamonds behind it."""
    height, width = text_mask(title, TITLE).shape
    left, top = 16, picture.shape[0] - height - 6
    if title:
        lay(picture, rounded_mask(width + 16, height, height // 4), left - 8, top, WOOD)
    write(picture, title, left, top, TITLE, WHITE)


def _way(inset: Inset, path: FloatArray, colour: Colour) -> None:
    whole = np.isfinite(path).all(axis=1)
    for part in np.split(path, np.flatnonzero(~whole)):
        line = part[np.isfinite(part).all(axis=1)]
        if len(line) > 1:
            points = inset.plan(line).reshape(-1, 1, 2)
            cv2.polylines(inset.ground, [points], False, colour, 2 * SUPERSAMPLE, cv2.LINE_AA, SHIFT)


def _ball(inset: Inset, table: Table, place: FloatArray, colour: Colour, edge: Colour) -> None:
    """As large as life: who touches whom shall be seen."""
    scale = float(np.linalg.norm(inset.to_plan[:, 0]))
    centre, radius = inset.plan(place).tolist(), round(table.ball_radius * scale * (1 << SHIFT))
    cv2.circle(inset.ground, centre, radius + (SUPERSAMPLE << SHIFT), edge, -1, cv2.LINE_AA, SHIFT)
    cv2.circle(inset.ground, centre, radius, colour, -1, cv2.LINE_AA, SHIFT)


def _name(picture: ImageArray, inset: Inset, place: FloatArray, name: str) -> None:
    """The name beside the ball, inside the picture."""
    x, y = inset.plan(place) / (SUPERSAMPLE << SHIFT)
    mask = text_mask(name, 15, bold=True)
    height, width = mask.shape[:2]
    away = inset.ball_radius / SUPERSAMPLE + 3
    left = x + away if x + away + width < picture.shape[1] else x - away - width
    write(picture, name, int(max(left, 0)), int(np.clip(y - height / 2, 0, picture.shape[0] - height)), 15, WHITE)
