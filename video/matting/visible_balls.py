"""Which balls a picture shows, be they observed in it or not."""

from __future__ import annotations

import numpy as np

from models.core.typing import BoolArray, FloatArray, ImageArray
from video.matting.background_plate import Plate
from video.matting.ball_matting import Outline
from video.matting.ball_timeline import Sightings

Box = tuple[int, int, int, int]
"""x, y, width, height"""

INNER_RADII, LEAST_VISIBLE = 0.7, 0.08
"""Radii around its centre in which a ball's colour is told, and the share of its box that must not be hidden."""
RING_RADII = (1.3, 1.7)
"""Radii around its centre between which there is table around a ball that nothing touches."""
NO_TABLE = 28.0
"""Levels of 255 by which a pixel differs from the table in any usual light."""


def shown_balls(sightings: Sightings, plate: Plate, row: int, picture: ImageArray) -> BoolArray:
    """(N,) balls in the picture: the observed, and where it shows rather the ball than the plate.

    A ball half hidden by another is seen by anything that is no table: what is left of it may be its number alone. A
    whole one has its own colour, or is a disc of other colours with table all round: stripes turn.
    """
    shown: BoolArray = sightings.observed[row].copy()
    for ball in np.flatnonzero(~shown & np.isfinite(sightings.centre[row, :, 0])):
        box, inner, visible = _visible_part(sightings, row, int(ball), picture.shape)
        if visible.sum() < LEAST_VISIBLE * max(visible.size, 1):
            continue
        x, y, width, height = box
        around, known = plate.patch(*box, sightings.motion(float(sightings.t[row])))
        if not known.all():
            continue
        seen, empty = (p[visible].astype(np.float32) for p in (picture[y : y + height, x : x + width], around))
        if visible.sum() < inner.sum():
            shown[ball] = np.mean(np.abs(seen - empty).max(axis=1) > NO_TABLE) > 0.5
        else:
            mean = seen.mean(axis=0)
            near = np.linalg.norm(mean - sightings.colour[ball]) < np.linalg.norm(mean - empty.mean(axis=0))
            shown[ball] = near or _disc_on_table(sightings, plate, row, int(ball), picture)
    return shown


def _disc_on_table(sightings: Sightings, plate: Plate, row: int, ball: int, picture: ImageArray) -> bool:
    """Whether something that is no table lies where a ball should, and nothing of it around: no hand, no cue."""
    centre, radius = sightings.centre[row, ball], float(sightings.radius[row, ball])
    x, y, width, height = box = _box(centre, RING_RADII[1] * radius, picture.shape)
    around, known = plate.patch(*box, sightings.motion(float(sightings.t[row])))
    if not known.all():
        return False
    unlike = np.abs(picture[y : y + height, x : x + width].astype(np.float32) - around).max(axis=2) > NO_TABLE
    apart = Outline(centre[None], centre, radius).distance(*box) / radius
    inner, ring = unlike[apart < INNER_RADII], unlike[(apart > RING_RADII[0]) & (apart < RING_RADII[1])]
    return bool(inner.size and ring.size and inner.mean() > 0.5 > ring.mean())


def _visible_part(
    sightings: Sightings, row: int, ball: int, shape: tuple[int, ...]
) -> tuple[Box, BoolArray, BoolArray]:
    """A box x, y, width, height around a ball, in it (h, w) the ball, and those of its pixels that no other hides."""
    centre, radius = sightings.centre[row, ball], float(sightings.radius[row, ball])
    box = _box(centre, radius, shape)
    inner: BoolArray = Outline(centre[None], centre, radius).distance(*box) < INNER_RADII * radius
    visible = inner.copy()
    for other in np.flatnonzero(sightings.observed[row] & (sightings.centre[row, :, 1] > centre[1])):
        outline = sightings.outline(row, int(other))
        visible &= outline.distance(*box) > outline.radius + outline.edge
    return box, inner, visible


def _box(centre: FloatArray, reach: float, shape: tuple[int, ...]) -> Box:
    """The pixels within `reach` px of a place, cut at the picture."""
    x0, y0 = (int(v) for v in np.maximum(np.floor(centre - reach), 0))
    x1, y1 = (int(v) for v in np.minimum(np.ceil(centre + reach) + 1, [shape[1], shape[0]]))
    return x0, y0, max(x1 - x0, 0), max(y1 - y0, 0)
