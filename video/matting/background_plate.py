"""The table without its moving balls: what lies behind a ball, learnt from the times when it was elsewhere."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, FloatArray, ImageArray

RING_TOLERANCE = 14.0
"""Levels of 255 by which a pixel around a hole may differ from the plate and still count as the same cloth: beyond
are hands, cues and other balls; within are light, shadow and coding."""
RING_PIXELS = 500
"""Pixels of the ring that are looked at: enough for three numbers."""
SHADED, UNDER = 100, 255
"""What covers a pixel: the shadow of a ball, in which the colour can still be told, or the ball."""
SAME_CLOTH, LEAST_ALIKE, LEAST_SEEN_FREE = 12, 2, 0.1
"""Levels of 255 within which a sample has the colour of the cloth around; samples that say so before the median is not
believed; and the share of a thing of which this must be so."""
AROUND_SHRINK, AROUND_CELLS = 8, 9
"""By what pictures are made smaller to tell the colour around a pixel, and over how many of their pixels: a cue, a
line or a ball fills less than half of that."""
SORTED_AT_ONCE = 65536
"""Pixels of the plate whose samples are sorted together: bounds memory."""


@dataclass(frozen=True, slots=True)
class Plate:
    """The empty table, known at the pixels that moving balls sweep, in the coordinates of the reference picture."""

    picture: ImageArray
    """(H, W, 3); black where `known` is False."""
    known: BoolArray
    """(H, W)"""

    def patch(self, x: int, y: int, width: int, height: int, motion: FloatArray | None) -> tuple[ImageArray, BoolArray]:
        """Picture (h, w, 3) and known (h, w) of a box that lies inside a frame seen through `motion` (3, 3)."""
        if motion is None:
            box = np.s_[y : y + height, x : x + width]
            return self.picture[box], self.known[box]
        back = np.linalg.inv(motion) @ np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        picture = cv2.warpPerspective(self.picture, back, (width, height), flags=flags)
        known = cv2.warpPerspective(self.known.astype(np.uint8) * 255, back, (width, height), flags=flags)
        return picture, known == 255


def learn_plate(swept: BoolArray, samples: Iterable[tuple[ImageArray, ImageArray, FloatArray | None]]) -> Plate:
    """Median over time of every swept pixel, over the samples in which no ball lies there.

    `swept` (H, W) says where a plate is needed. Each sample is a picture (H, W, 3), (H, W) what covers it (`UNDER` a
    ball, `SHADED` by one, 0 elsewhere), and the camera's motion (3, 3) from the reference picture to it. A cue that
    lies there for longer than not is no table: where the samples differ, those that look like the cloth around are
    believed. Pixels that are never free take the colour of their surroundings.
    """
    rows, columns = np.nonzero(swept)
    seen: list[ImageArray] = []
    small: list[ImageArray] = []
    for picture, covered, motion in samples:
        picture, covered = _in_reference(picture, covered, motion)
        seen.append(np.concatenate([picture[rows, columns], covered[rows, columns, None]], axis=1))
        small.append(_made_small(picture))
    plate, known = np.zeros((*swept.shape, 3), dtype=np.uint8), np.zeros(swept.shape, dtype=bool)
    if not seen or not len(rows):
        return Plate(plate, known)
    cloth, evidence = plate.copy(), np.zeros((*swept.shape, 2), dtype=np.uint8)
    apart, around = np.zeros(swept.shape, dtype=np.uint8), _colours_around(small, swept.shape)
    for start in range(0, len(rows), SORTED_AT_ONCE):
        part = slice(start, start + SORTED_AT_ONCE)
        here, stack = (rows[part], columns[part]), np.stack([sample[part] for sample in seen])
        plate[here], known[here] = _masked_median(stack)
        apart[here] = np.where(known[here], cv2.absdiff(plate[here], around[here]).max(axis=1), 0)
        doubtful = apart[here] > SAME_CLOTH
        if doubtful.any():
            there = (here[0][doubtful], here[1][doubtful])
            cloth[there], evidence[there] = _like(stack[:, doubtful], around[there])
    strange = _lies_on_cloth(apart, evidence)
    told = strange & (evidence[..., 0] > 0)
    plate[told] = cloth[told]
    known &= ~strange | told
    return Plate(_grow_into(plate, swept & ~known, known), known | swept)


def _in_reference(picture: ImageArray, covered: ImageArray, motion: FloatArray | None) -> tuple[ImageArray, ImageArray]:
    """A sample (H, W, 3) as the camera sees it at the reference picture, and (H, W) what covers it."""
    if motion is None:
        return picture, covered
    size = (picture.shape[1], picture.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    free = cv2.warpPerspective(255 - covered, motion, size, flags=flags)
    moved = cv2.warpPerspective(picture, motion, size, flags=flags)
    return np.asarray(moved, dtype=np.uint8), np.asarray(255 - free, dtype=np.uint8)


def _made_small(picture: ImageArray) -> ImageArray:
    size = (-(-picture.shape[1] // AROUND_SHRINK), -(-picture.shape[0] // AROUND_SHRINK))
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _colours_around(small: list[ImageArray], shape: tuple[int, ...]) -> ImageArray:
    """(H, W, 3) The usual colour of what surrounds each pixel: of cloth, but near cushions."""
    usual = cv2.medianBlur(np.median(np.stack(small), axis=0).astype(np.uint8), AROUND_CELLS)
    return np.asarray(cv2.resize(usual, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def _masked_median(samples: ImageArray) -> tuple[ImageArray, BoolArray]:
    """Median (n, 3) of samples (S, n, 4) where the fourth value is 0; and whether there was any (n,)."""
    hidden = samples[..., 3] > 0
    ranked = np.where(hidden[..., None], np.uint8(255), samples[..., :3])
    ranked.sort(axis=0)
    count = (~hidden).sum(axis=0)
    middle = np.maximum(count - 1, 0) // 2
    values = np.take_along_axis(ranked, np.broadcast_to(middle[None, :, None], (1, *ranked.shape[1:])), axis=0)[0]
    return values, count > 0


def _like(samples: ImageArray, around: ImageArray) -> tuple[ImageArray, ImageArray]:
    """Mean (n, 3) of those samples (S, n, 4) under no ball that have the colour of what is `around` (n, 3).

    And (n, 2) how many they are, and how many lie under a ball.
    """
    under = samples[..., 3] > SHADED
    apart = cv2.absdiff(samples[..., :3], np.broadcast_to(around, samples[..., :3].shape)).max(axis=-1)
    alike = (apart < SAME_CLOTH) & ~under
    total = np.einsum("snc,sn->nc", samples[..., :3], alike, dtype=np.float32)
    counts = np.stack([alike.sum(axis=0), under.sum(axis=0)], axis=-1)
    return np.rint(total / np.maximum(counts[:, :1], 1)).astype(np.uint8), counts.astype(np.uint8)


def _lies_on_cloth(apart: ImageArray, evidence: ImageArray) -> BoolArray:
    """(H, W) where the plate shows what is not always there, by how far it is `apart` from the colour around.

    A cue is seen to come or go beside a ball, if not under it: what hangs together with a part that was cloth once,
    and was under a ball at times, goes with it. Lines of one pixel are edges that wander, and stay.
    """
    seen_free = (apart > 2 * SAME_CLOTH) & (evidence[..., 0] >= LEAST_ALIKE)
    core = cv2.morphologyEx(seen_free.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    if not core.any():
        return np.zeros(apart.shape, dtype=bool)
    may_go = (apart > SAME_CLOTH) & (evidence >= LEAST_ALIKE).any(axis=-1)
    count, labels = cv2.connectedComponents(may_go.astype(np.uint8), connectivity=8)
    whole, part = (np.bincount(labels[mask], minlength=count) for mask in (may_go, core > 0))
    goes = part >= LEAST_SEEN_FREE * np.maximum(whole, 1)
    goes[0] = False
    strange = cv2.dilate(goes[labels].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return np.asarray(strange & (apart > SAME_CLOTH))


def _grow_into(picture: ImageArray, hole: BoolArray, known: BoolArray) -> ImageArray:
    """Fill `hole` smoothly from the known pixels around it.

    A pyramid of pictures in which only what is known counts (Gortler et al. 1996, doi:10.1145/237170.237200, the
    pull-push of section 3.4): each hole takes the colours of the finest level that knows any.
    """
    if not (hole & ~known).any() or not known.any():
        return picture
    rows, columns = (np.flatnonzero((hole | known).any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    weight = known[box].astype(np.float32)
    levels = [(picture[box].astype(np.float32) * weight[..., None], weight)]
    while levels[-1][1].min() == 0 and min(levels[-1][1].shape) > 1:
        levels.append(tuple(cv2.pyrDown(level) for level in levels[-1]))
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)[..., None]
    for colour, weight in levels[-2::-1]:
        filled = cv2.pyrUp(filled, dstsize=weight.shape[::-1])
        sure = np.minimum(1, weight)[..., None]
        filled = np.where(sure > 0, colour / np.maximum(weight, 1e-6)[..., None], 0) * sure + filled * (1 - sure)
    grown, unknown = picture.copy(), (hole & ~known)[box]
    grown[box][unknown] = np.clip(np.rint(filled[unknown]), 0, 255).astype(np.uint8)
    return grown


def fill_behind(patch: ImageArray, behind: ImageArray, ring: BoolArray) -> NDArray[np.float32]:
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
