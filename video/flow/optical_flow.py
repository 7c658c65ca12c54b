"""Interpolation of everything except balls between two frames, by optical flow both ways with occlusions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.flow.ticker import apply_ticker_shifts, find_ticker_shifts

FrameAtTime = Callable[[float], ImageArray]
"""Function that returns the image (h, w, 3) at a share, 0 to 1, of the time from the first frame to the second."""

LOOKUP_ITERATIONS = 2
"""Fixed-point iterations of the flow lookup; after two, displacements are within 0.1 px except at edges."""
MAX_DISAGREEMENT = 10.0
"""Levels of 255 between the two ends of a displacement above which they do not show the same object."""
MATCH_WINDOW_PX = 5
"""px of the reduced images over which the two ends of a displacement are compared."""
PATCH_STRIDE, DESCENT_ITERATIONS, REFINEMENT_ITERATIONS = 4, 16, 1
"""Parameters of the dense inverse search: half the work of OpenCV's medium preset, as accurate on hands and cues."""
QUARTER_SIZE = 4
"""Reduction of the sides of a wide box."""
SHRINK_FROM_SIDE = ((QUARTER_SIZE, 288), (2, 96))
"""Reduction of the sides of a box, and the shorter side in px from which it applies."""
CHANNEL_MEAN = np.array([[0.5, 0.5, 0.5]], dtype=np.float32)
"""Weights that average the differences of three channels."""


class Interpolator(Protocol):
    """Interpolates everything except balls between two frames.

    Moving balls are removed from the frames before, and composited at their fitted positions afterwards.
    """

    def prepare(self, first: ImageArray, second: ImageArray) -> FrameAtTime:
        """Prepare two images (h, w, 3) of the same size, whole frames or boxes of any size above 32 px."""


@dataclass(frozen=True, slots=True)
class CrossFade:
    """Interpolates by cross-fading the two frames."""

    def prepare(self, first: ImageArray, second: ImageArray) -> FrameAtTime:
        """Return the weighted mean as a function of the time."""
        return lambda share: np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class OpticalFlowInterpolator:
    """Interpolates by dense inverse search (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29) both ways.

    Each pixel of the new image has two candidate displacements, from the forward and from the backward flow. The
    candidate whose two ends agree better over a small window has more weight. In wide boxes it is used alone, at half
    the cost. Where neither agrees, something is covered or uncovered, and the nearer frame is used.
    """

    def prepare(self, first: ImageArray, second: ImageArray) -> FrameAtTime:
        """Compute both flows once for all times, at half or quarter size because flow fields are smooth."""
        height, width = first.shape[:2]
        shrink = next((by for by, least in SHRINK_FROM_SIDE if min(height, width) >= least), 1)
        size = (-(-width // shrink), -(-height // shrink))
        small = tuple(_resize_image(image, size) for image in (first, second))
        grey = [np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8) for image in small]
        grids, finest = (pixel_grid(height, width), pixel_grid(*grey[0].shape)), max(2 - shrink, 0)
        a, b = grey
        shifts = find_ticker_shifts(a, b)
        forward = apply_ticker_shifts(compute_flow(a, b, finest), a, b, shifts, grids[1])
        backward = apply_ticker_shifts(compute_flow(b, a, finest), b, a, [-shift for shift in shifts], grids[1])
        pair = _FlowPair(
            (first, second), (small[0], small[1]), forward, backward, *grids, is_wide=shrink == QUARTER_SIZE
        )
        return pair.interpolate


@dataclass(frozen=True, slots=True)
class _FlowPair:
    """Forward and backward flow between two images, with the images in full and in reduced size."""

    images: tuple[ImageArray, ImageArray]
    small_images: tuple[ImageArray, ImageArray]
    """The same images reduced; candidate displacements are compared on these."""
    forward: Float32Array
    """(h, w, 2) px of the reduced images, from the first to the second."""
    backward: Float32Array
    """(h, w, 2) px of the reduced images, from the second to the first."""
    grid: Float32Array
    """(H, W, 2) px, pixel coordinates of the images."""
    small_grid: Float32Array
    """(h, w, 2) px, pixel coordinates of the reduced images."""
    is_wide: bool = False
    """Whether the better candidate is used alone."""

    def interpolate(self, share: float) -> ImageArray:
        """Return the image (H, W, 3) at a share of the time."""
        forward, backward = (
            self._displacement_at(self.forward, share),
            np.negative(self._displacement_at(self.backward, 1 - share)),
        )
        costs = self._matching_cost(forward, share), self._matching_cost(backward, share)
        if self.is_wide:
            displacement = np.where((costs[1] < costs[0])[..., None], backward, forward)
            return self._blend_along(displacement, np.minimum(*costs), share)
        first, second = self._blend_along(forward, costs[0], share), self._blend_along(backward, costs[1], share)
        agree = [1 / (cost + 1) ** 2 for cost in costs]
        weight = cv2.resize(agree[0] / (agree[0] + agree[1]), (self.grid.shape[1], self.grid.shape[0]))
        return np.asarray(cv2.blendLinear(first, second, weight, 1 - weight), dtype=np.uint8)

    def _displacement_at(self, flow: Float32Array, share: float) -> Float32Array:
        """Return the displacement (h, w, 2) px over the whole gap at each pixel of the image at a share of the time."""
        displacement = flow
        for _ in range(LOOKUP_ITERATIONS):
            displacement = _sample_field(flow, self.small_grid - np.float32(share) * displacement)
        return displacement

    def _matching_cost(self, displacement: Float32Array, share: float) -> Float32Array:
        """Return the levels (h, w) by which the two ends of a displacement differ around each pixel."""
        first = _sample_image(self.small_images[0], self.small_grid - np.float32(share) * displacement)
        second = _sample_image(self.small_images[1], self.small_grid + np.float32(1 - share) * displacement)
        difference = cv2.transform(cv2.absdiff(first, second), CHANNEL_MEAN)
        return np.asarray(cv2.blur(difference, (MATCH_WINDOW_PX, MATCH_WINDOW_PX)), dtype=np.float32)

    def _blend_along(self, displacement: Float32Array, cost: Float32Array, share: float) -> ImageArray:
        """Blend both images along the displacement; where its ends disagree, use the nearer one.

        The nearer image is right more often than a mixture.
        """
        height, width = self.grid.shape[:2]
        shrink = np.array([width / displacement.shape[1], height / displacement.shape[0]], dtype=np.float32)
        wide = np.asarray(cv2.resize(displacement * shrink, (width, height)), dtype=np.float32)
        first = _sample_image(self.images[0], self.grid - np.float32(share) * wide)
        second = _sample_image(self.images[1], self.grid + np.float32(1 - share) * wide)
        sure = np.clip(cost / np.float32(MAX_DISAGREEMENT) - 1, 0, 1)
        weight = share + np.float32(_smooth_step(share) - share) * cv2.resize(sure, (width, height))
        weight = np.asarray(weight, dtype=np.float32)
        return np.asarray(cv2.blendLinear(first, second, 1 - weight, weight), dtype=np.uint8)


def _smooth_step(share: float) -> float:
    """Return a share that passes quickly through the middle."""
    x = float(np.clip((share - 0.3) / 0.4, 0, 1))
    return x * x * (3 - 2 * x)


@lru_cache(maxsize=512)
def pixel_grid(height: int, width: int) -> Float32Array:
    """Return the coordinates of every pixel.

    Args:
        height: Rows.
        width: Columns.

    Returns:
        x and y of each pixel (h, w, 2), px. The array is shared and read-only.
    """
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    places.setflags(write=False)
    return places


def _sample_field(values: Float32Array, where: Float32Array) -> Float32Array:
    """Sample a field at places (h, w, 2) px by bilinear interpolation."""
    looked = cv2.remap(values, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.float32)


def _sample_image(image: ImageArray, where: Float32Array) -> ImageArray:
    """Sample an image at places (h, w, 2) px by bilinear interpolation."""
    looked = cv2.remap(image, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.uint8)


def _resize_image(image: ImageArray, size: tuple[int, int]) -> ImageArray:
    """Reduce an image to a size (w, h) by area averaging."""
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def compute_flow(first: ImageArray, second: ImageArray, finest: int = 1) -> Float32Array:
    """Compute the dense optical flow from one grey image to another.

    Args:
        first: First image (h, w).
        second: Second image (h, w).
        finest: The flow is computed down to a scale of 2^-finest.

    Returns:
        Displacement of each pixel of the first image (h, w, 2), px.
    """
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(finest)
    search.setPatchStride(PATCH_STRIDE)
    search.setGradientDescentIterations(DESCENT_ITERATIONS)
    search.setVariationalRefinementIterations(REFINEMENT_ITERATIONS)
    return np.asarray(search.calc(first, second, np.zeros((*first.shape, 2), dtype=np.float32)), dtype=np.float32)
