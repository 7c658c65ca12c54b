"""The table without its moving balls: what lies behind a ball, learnt from the times when it was elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]
Mask = NDArray[np.bool_]

RING_TOLERANCE = 14.0
"""Levels of 255 by which a pixel around a hole may differ from the plate and still count as the same cloth: beyond
are hands, cues and other balls; within are light, shadow and coding."""
RING_PIXELS = 500
"""Pixels of the ring that are looked at: enough for three numbers."""
SORTED_AT_ONCE = 65536
"""Pixels of the plate whose samples are sorted together: bounds memory."""


@dataclass(frozen=True, slots=True)
class Plate:
    """The empty table, known at the pixels that moving balls sweep, in the coordinates of the reference picture."""

    picture: Picture
    """(H, W, 3); black where `known` is False."""
    known: Mask
    """(H, W)"""

    def patch(self, x: int, y: int, width: int, height: int, motion: Floats | None) -> tuple[Picture, Mask]:
        """Picture (h, w, 3) and known (h, w) of a box that lies inside a frame seen through `motion` (3, 3)."""
        if motion is None:
            box = np.s_[y : y + height, x : x + width]
            return self.picture[box], self.known[box]
        back = np.linalg.inv(motion) @ np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        picture = cv2.warpPerspective(self.picture, back, (width, height), flags=flags)
        known = cv2.warpPerspective(self.known.astype(np.uint8) * 255, back, (width, height), flags=flags)
        return picture, known == 255


def learn_plate(swept: Mask, samples: Iterable[tuple[Picture, Mask, Floats | None]]) -> Plate:
    """Median over time of every swept pixel, over the samples in which no ball lies there.

    `swept` (H, W) says where a plate is needed. Each sample is a picture (H, W, 3), the mask (H, W) of all balls in
    it with their shadows, and the camera's motion (3, 3) from the reference picture to it. Pixels that are never
    free take the colour of their surroundings.
    """
    rows, columns = np.nonzero(swept)
    seen: list[Picture] = []
    for picture, covered, motion in samples:
        seen.append(_free_pixels(picture, covered, motion, rows, columns))
    plate = np.zeros((*swept.shape, 3), dtype=np.uint8)
    known = np.zeros(swept.shape, dtype=bool)
    if not seen or not len(rows):
        return Plate(plate, known)
    for start in range(0, len(rows), SORTED_AT_ONCE):
        part = slice(start, start + SORTED_AT_ONCE)
        values, free = _masked_median(np.stack([sample[part] for sample in seen]))
        plate[rows[part], columns[part]] = values
        known[rows[part], columns[part]] = free
    return Plate(_grow_into(plate, swept & ~known, known), known | swept)


def _free_pixels(
    picture: Picture, covered: Mask, motion: Floats | None, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> Picture:
    """Colours (n, 4) of the swept pixels in one sample; the fourth value is 255 where something covers them."""
    if motion is not None:
        size = (picture.shape[1], picture.shape[0])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        inside = cv2.warpPerspective((~covered).astype(np.uint8) * 255, motion, size, flags=flags)
        picture = cv2.warpPerspective(picture, motion, size, flags=flags)
        covered = inside < 255
    hidden = covered[rows, columns].astype(np.uint8) * 255
    return np.concatenate([picture[rows, columns], hidden[:, None]], axis=1)


def _masked_median(samples: Picture) -> tuple[Picture, Mask]:
    """Median (n, 3) of samples (S, n, 4) where the fourth value is 0; and whether there was any (n,)."""
    hidden = samples[..., 3] > 0
    ranked = np.where(hidden[..., None], np.uint8(255), samples[..., :3])
    ranked.sort(axis=0)
    count = (~hidden).sum(axis=0)
    middle = np.maximum(count - 1, 0) // 2
    values = np.take_along_axis(ranked, np.broadcast_to(middle[None, :, None], (1, *ranked.shape[1:])), axis=0)[0]
    return values, count > 0


def _grow_into(picture: Picture, hole: Mask, known: Mask) -> Picture:
    """Fill `hole` with the mean of the known pixels around it, from near to far."""
    picture, known = picture.copy(), known.copy()
    size = 9
    while (hole & ~known).any() and known.any() and size < 2 * max(picture.shape):
        weight = cv2.blur(known.astype(np.float32), (size, size))
        total = cv2.blur(np.where(known[..., None], picture, 0).astype(np.float32), (size, size))
        grown = hole & ~known & (weight > 1e-6)
        picture[grown] = np.rint(total[grown] / weight[grown][:, None]).astype(np.uint8)
        known = known | grown
        size = 2 * size + 1
    return picture


def fill_behind(patch: Picture, behind: Picture, ring: Mask) -> NDArray[np.float32]:
    """What `patch` (h, w, 3) would show without the ball: the plate `behind`, in the light of this picture.

    The pixels of `ring` (h, w), around the ball, tell how the light differs from the plate: a plane per channel
    through the differences, without those that are no cloth (`RING_TOLERANCE` from their median).
    """
    ground = behind.astype(np.float32)
    rows, columns = np.nonzero(ring)
    if len(rows) < 12:
        return ground
    sparse = slice(None, None, max(1, len(rows) // RING_PIXELS))
    rows, columns = rows[sparse], columns[sparse]
    difference = patch[rows, columns].astype(np.float32) - ground[rows, columns]
    middle = np.median(difference, axis=0)
    same = (np.abs(difference - middle) < RING_TOLERANCE).all(axis=1)
    if same.sum() < 0.3 * len(rows) or np.abs(middle).max() > 3 * RING_TOLERANCE:
        return ground
    height, width = ring.shape
    u, v = columns / width - 0.5, rows / height - 0.5
    basis = np.column_stack([np.ones(len(rows)), u, v]).astype(np.float32)[same]
    normal = basis.T @ basis + np.diag([1e-3, 0.1, 0.1]).astype(np.float32) * len(basis)
    offset, along, down = np.linalg.solve(normal, basis.T @ difference[same])
    across = (np.arange(width, dtype=np.float32) / width - 0.5)[None, :, None]
    downward = (np.arange(height, dtype=np.float32) / height - 0.5)[:, None, None]
    lit: NDArray[np.float32] = ground + offset + along * across + down * downward
    return np.clip(lit, 0, 255)
