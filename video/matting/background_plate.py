"""Background plate: the table without its moving balls, estimated from the frames in which each pixel is uncovered."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, FloatArray, ImageArray

# Levels of 255 by which a pixel of the ring around a ball may differ from the plate and still be cloth. Larger
# differences are hands, cues and other balls; smaller ones are light, shadow and coding.
RING_TOLERANCE = 14.0
# Pixels of the ring that are used: enough for three parameters.
MAX_RING_PIXELS = 500
# Levels of a coverage mask: the shadow of a ball, in which the colour is still measurable, or the ball itself.
COVERED_BY_SHADOW, COVERED_BY_BALL = 100, 255
# Levels of 255 within which a sample has the colour of the surrounding cloth; such samples from which they replace the
# median; and the share of a transient object that must have been seen uncovered.
MAX_CLOTH_DIFFERENCE, MIN_SIMILAR_SAMPLES, MIN_UNCOVERED_SHARE = 12, 2, 0.1
# Reduction of the frames for the local colour, and reduced pixels of its median window: a cue, a line or a ball fills
# less than half of it.
LOCAL_COLOUR_SHRINK, LOCAL_COLOUR_CELLS = 8, 9
# Pixels of the plate whose samples are sorted together, which bounds memory.
SORT_CHUNK_PX = 65536


@dataclass(frozen=True, slots=True)
class BackgroundPlate:
    """The empty table, valid at the pixels that moving balls cover, in the pixels of the reference frame."""

    image: ImageArray
    """(H, W, 3); black where not `valid`."""
    valid: BoolArray
    """(H, W)"""

    def extract_patch(
        self, x: int, y: int, width: int, height: int, motion: FloatArray | None
    ) -> tuple[ImageArray, BoolArray]:
        """Return the image (h, w, 3) and validity (h, w) of a box of a frame with the camera motion `motion` (3, 3).

        The box lies inside the frame.
        """
        if motion is None:
            box = np.s_[y : y + height, x : x + width]
            return self.image[box], self.valid[box]
        to_reference = np.linalg.inv(motion) @ np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        image = cv2.warpPerspective(self.image, to_reference, (width, height), flags=flags)
        valid = cv2.warpPerspective(self.valid.astype(np.uint8) * 255, to_reference, (width, height), flags=flags)
        return image, valid == 255


def estimate_background_plate(
    region: BoolArray, samples: Iterable[tuple[ImageArray, ImageArray, FloatArray | None]]
) -> BackgroundPlate:
    """Estimate the plate as the median over time of the uncovered samples of each pixel.

    A cue may rest at a place for most of the clip: where the samples differ, those with the colour of the surrounding
    cloth count. Pixels that are never uncovered are inpainted from their surroundings.

    Args:
        region: Reference pixels (H, W) where a plate is needed.
        samples: Frames (H, W, 3), their coverage masks (H, W) (`COVERED_BY_BALL`, `COVERED_BY_SHADOW` or 0), and the
            camera motion (3, 3) from the reference frame to each; None for a still camera.

    Returns:
        The plate.
    """
    rows, columns = np.nonzero(region)
    region_samples: list[ImageArray] = []
    small_images: list[ImageArray] = []
    for image, covered, motion in samples:
        image, covered = _warp_to_reference(image, covered, motion)
        region_samples.append(np.concatenate([image[rows, columns], covered[rows, columns, None]], axis=1))
        small_images.append(_shrink_image(image))
    plate, valid = np.zeros((*region.shape, 3), dtype=np.uint8), np.zeros(region.shape, dtype=bool)
    if not region_samples or not len(rows):
        return BackgroundPlate(plate, valid)
    cloth, evidence = plate.copy(), np.zeros((*region.shape, 2), dtype=np.uint8)
    difference, local_colour = np.zeros(region.shape, dtype=np.uint8), _local_colours(small_images, region.shape)
    for start in range(0, len(rows), SORT_CHUNK_PX):
        part = slice(start, start + SORT_CHUNK_PX)
        here, stack = (rows[part], columns[part]), np.stack([sample[part] for sample in region_samples])
        plate[here], valid[here] = _median_of_uncovered(stack)
        difference[here] = np.where(valid[here], cv2.absdiff(plate[here], local_colour[here]).max(axis=1), 0)
        doubtful = difference[here] > MAX_CLOTH_DIFFERENCE
        if doubtful.any():
            there = (here[0][doubtful], here[1][doubtful])
            cloth[there], evidence[there] = _mean_of_similar(stack[:, doubtful], local_colour[there])
    is_transient = _find_transient_objects(difference, evidence)
    is_replaceable = is_transient & (evidence[..., 0] > 0)
    plate[is_replaceable] = cloth[is_replaceable]
    valid &= ~is_transient | is_replaceable
    return BackgroundPlate(_inpaint_hole(plate, region & ~valid, valid), valid | region)


def _warp_to_reference(
    image: ImageArray, covered: ImageArray, motion: FloatArray | None
) -> tuple[ImageArray, ImageArray]:
    """Warp a sample (H, W, 3) and its coverage mask (H, W) to the reference frame."""
    if motion is None:
        return image, covered
    size = (image.shape[1], image.shape[0])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    uncovered = cv2.warpPerspective(255 - covered, motion, size, flags=flags)
    moved = cv2.warpPerspective(image, motion, size, flags=flags)
    return np.asarray(moved, dtype=np.uint8), np.asarray(255 - uncovered, dtype=np.uint8)


def _shrink_image(image: ImageArray) -> ImageArray:
    """Reduce an image for the estimate of local colours."""
    size = (-(-image.shape[1] // LOCAL_COLOUR_SHRINK), -(-image.shape[0] // LOCAL_COLOUR_SHRINK))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _local_colours(small: list[ImageArray], shape: tuple[int, ...]) -> ImageArray:
    """Return the typical colour (H, W, 3) around each pixel: cloth, except near cushions."""
    typical = cv2.medianBlur(np.median(np.stack(small), axis=0).astype(np.uint8), LOCAL_COLOUR_CELLS)
    return np.asarray(cv2.resize(typical, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR), dtype=np.uint8)


def _median_of_uncovered(samples: ImageArray) -> tuple[ImageArray, BoolArray]:
    """Return the median (n, 3) of the samples (S, n, 4) whose coverage is 0, and whether there is any (n,)."""
    hidden = samples[..., 3] > 0
    ranked = np.where(hidden[..., None], np.uint8(255), samples[..., :3])
    ranked.sort(axis=0)
    count = (~hidden).sum(axis=0)
    middle = np.maximum(count - 1, 0) // 2
    values = np.take_along_axis(ranked, np.broadcast_to(middle[None, :, None], (1, *ranked.shape[1:])), axis=0)[0]
    return values, count > 0


def _mean_of_similar(samples: ImageArray, local_colour: ImageArray) -> tuple[ImageArray, ImageArray]:
    """Return the mean (n, 3) of the samples (S, n, 4) under no ball that have the local colour (n, 3).

    The second result (n, 2) counts these samples and those under a ball.
    """
    under = samples[..., 3] > COVERED_BY_SHADOW
    difference = cv2.absdiff(samples[..., :3], np.broadcast_to(local_colour, samples[..., :3].shape)).max(axis=-1)
    is_similar = (difference < MAX_CLOTH_DIFFERENCE) & ~under
    total = np.einsum("snc,sn->nc", samples[..., :3], is_similar, dtype=np.float32)
    counts = np.stack([is_similar.sum(axis=0), under.sum(axis=0)], axis=-1)
    return np.rint(total / np.maximum(counts[:, :1], 1)).astype(np.uint8), counts.astype(np.uint8)


def _find_transient_objects(difference: ImageArray, evidence: ImageArray) -> BoolArray:
    """Return the pixels (H, W) where the plate shows an object that is not always there.

    `difference` (H, W) is the difference to the local colour. A cue is observed to come or go beside a ball, if not
    under
    it: an object of which a part was once uncovered cloth, and at times under a ball, is removed as a whole. Lines of
    one
    pixel are edges with jitter and stay.
    """
    seen_free = (difference > 2 * MAX_CLOTH_DIFFERENCE) & (evidence[..., 0] >= MIN_SIMILAR_SAMPLES)
    core = cv2.morphologyEx(seen_free.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    if not core.any():
        return np.zeros(difference.shape, dtype=bool)
    may_go = (difference > MAX_CLOTH_DIFFERENCE) & (evidence >= MIN_SIMILAR_SAMPLES).any(axis=-1)
    count, labels = cv2.connectedComponents(may_go.astype(np.uint8), connectivity=8)
    whole, part = (np.bincount(labels[mask], minlength=count) for mask in (may_go, core > 0))
    goes = part >= MIN_UNCOVERED_SHARE * np.maximum(whole, 1)
    goes[0] = False
    is_transient = cv2.dilate(goes[labels].astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    return np.asarray(is_transient & (difference > MAX_CLOTH_DIFFERENCE))


def _inpaint_hole(image: ImageArray, hole: BoolArray, valid: BoolArray) -> ImageArray:
    """Fill a hole smoothly from the valid pixels around it.

    Pull-push on an image pyramid in which only valid pixels count (Gortler et al. 1996, doi:10.1145/237170.237200,
    section 3.4): each hole takes the colours of the finest level that is valid there.
    """
    if not (hole & ~valid).any() or not valid.any():
        return image
    rows, columns = (np.flatnonzero((hole | valid).any(axis=axis)) for axis in (1, 0))
    box = np.s_[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1]
    weight = valid[box].astype(np.float32)
    levels = [(image[box].astype(np.float32) * weight[..., None], weight)]
    while levels[-1][1].min() == 0 and min(levels[-1][1].shape) > 1:
        levels.append(tuple(cv2.pyrDown(level) for level in levels[-1]))
    filled = levels[-1][0] / np.maximum(levels[-1][1], 1e-6)[..., None]
    for colour, weight in levels[-2::-1]:
        filled = cv2.pyrUp(filled, dstsize=weight.shape[::-1])
        sure = np.minimum(1, weight)[..., None]
        filled = np.where(sure > 0, colour / np.maximum(weight, 1e-6)[..., None], 0) * sure + filled * (1 - sure)
    grown, unknown = image.copy(), (hole & ~valid)[box]
    grown[box][unknown] = np.clip(np.rint(filled[unknown]), 0, 255).astype(np.uint8)
    return grown


def relight_background(patch: ImageArray, background: ImageArray, ring: BoolArray) -> NDArray[np.float32]:
    """Return the plate `background` (h, w, 3) in the light of the current frame.

    The pixels of `ring` (h, w), around the ball, measure how the light of `patch` (h, w, 3) differs from the plate: a
    plane per channel is fitted to the differences, without those that are no cloth (`RING_TOLERANCE` from the median).
    """
    ground = background.astype(np.float32)
    rows, columns = np.nonzero(ring)
    if len(rows) < 12:
        return ground
    sparse = slice(None, None, max(1, len(rows) // MAX_RING_PIXELS))
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
