"""What is known from the pictures before: only where a picture differs from them are balls looked for anew.

A ball beside which nothing changed is measured again all the same, from where it was: the error of every picture
stays its own.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.cloth_background import disc_kernel
from detectors.measurement.working_view import View
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

CHANGED_SHARE = 0.4
"""Share of the cloth's threshold by which a place, averaged over 3 x 3 working px, has changed."""
REACH_RADII = 1.3
"""A change may concern balls with their centre this near to it."""
MARGIN_RADII = 2.0
"""Picture that the search for such centres needs around them."""
BLOCK = 4
"""Working px on a side of the blocks in which changes are kept."""
WHOLE_SHARE = 0.6
"""Share of the picture from which on all of it is searched."""
RENEWED_PICTURES = 15
"""After this many pictures everything is searched anew: what one picture hid, another may show."""


@dataclass(frozen=True, slots=True)
class Scan:
    """What a working picture (h, w) shows that the empty table does not."""

    contrast: Float32Array
    """(h, w, 3)"""
    strength: Float32Array
    foreground: BoolArray
    moving: BoolArray
    """Neither cloth nor part of the median picture."""


@dataclass(frozen=True, slots=True)
class Memory:
    """The state of a search through a clip; its arrays are written over from picture to picture."""

    scan: Scan
    searched: ByteArray
    """(h, w, 3) working picture as it was when each place was searched last."""
    home: FloatArray
    """(n, 2) working px of the sharp balls of the last picture."""
    relative: FloatArray
    """(n,) their seen radius over the predicted one."""
    age: int
    """Pictures since all of it was searched."""


def touched_places(memory: Memory | None, working: ByteArray, view: View, threshold: float) -> BoolArray:
    """Where (h, w) balls have to be looked for anew in a working picture."""
    if memory is None or memory.age >= RENEWED_PICTURES:
        return np.ones(view.radius.shape, dtype=bool)
    red, green, blue = cv2.split(cv2.absdiff(working, memory.searched))
    changed = cv2.blur(cv2.max(cv2.max(red, green), blue), (3, 3)) > CHANGED_SHARE * threshold
    return _whole(around(_blocks(changed & view.area), REACH_RADII * view.typical / BLOCK), view)


def around(places: BoolArray, reach: float) -> BoolArray:
    """What lies within a reach, px, of places (h, w)."""
    return np.asarray(cv2.dilate(places.astype(np.uint8), disc_kernel(reach)) > 0)


def windows(touched: BoolArray, view: View) -> list[tuple[slice, slice]]:
    """Rows and columns of the parts of the picture that hold the touched places and their surroundings."""
    h, w = touched.shape
    if touched.all():
        return [(slice(0, h), slice(0, w))]
    margin = int(np.ceil(MARGIN_RADII * float(view.radius.max()) / BLOCK))
    grown = cv2.dilate(_blocks(touched).astype(np.uint8), np.ones((2 * margin + 1, 2 * margin + 1), np.uint8))
    _, _, stats, _ = cv2.connectedComponentsWithStats(grown)
    boxes = [(x * BLOCK, y * BLOCK, (x + dx) * BLOCK, (y + dy) * BLOCK) for x, y, dx, dy, _ in stats[1:].tolist()]
    if sum((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in boxes) > WHOLE_SHARE * h * w:
        return [(slice(0, h), slice(0, w))]
    return [(slice(y0, min(y1, h)), slice(x0, min(x1, w))) for x0, y0, x1, y1 in boxes]


def _blocks(places: BoolArray) -> BoolArray:
    """Which blocks (h / BLOCK, w / BLOCK), rounded up, hold any of the places (h, w)."""
    h, w = places.shape
    padded = np.pad(places, ((0, -h % BLOCK), (0, -w % BLOCK)))
    rows = np.logical_or.reduce([padded[k::BLOCK] for k in range(BLOCK)])
    return np.asarray(np.logical_or.reduce([rows[:, k::BLOCK] for k in range(BLOCK)]))


def _whole(blocks: BoolArray, view: View) -> BoolArray:
    """The places (h, w) in blocks."""
    h, w = view.radius.shape
    return np.ascontiguousarray(blocks.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)[:h, :w])
