"""Interpolation of everything except balls between two frames, by optical flow both ways with occlusions.

Detection of tickers: lines of text and banners that shift as a whole, farther than optical flow can follow.

Letters resemble each other, so a coarse-to-fine flow loses a line of text that shifts by more than one letter. The
shift of the whole line follows from phase correlation (Kuglin and Hines 1975).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import Float32Array, FloatArray, ImageArray

# Fixed-point iterations of the flow lookup; after two, displacements are within 0.1 px except at edges.
LOOKUP_ITERATIONS = 2
# Levels of 255 between the two ends of a displacement above which they do not show the same object.
MAX_DISAGREEMENT = 10.0
# px of the reduced images over which the two ends of a displacement are compared.
MATCH_WINDOW_PX = 5
# Parameters of the dense inverse search: half the work of OpenCV's medium preset, as accurate on hands and cues.
PATCH_STRIDE, DESCENT_ITERATIONS, REFINEMENT_ITERATIONS = 4, 16, 1
# Reduction of the sides of a wide box.
QUARTER_SIZE = 4
# Reduction of the sides of a box, and the shorter side in px from which it applies.
SHRINK_FROM_SIDE = ((QUARTER_SIZE, 288), (2, 96))
# Weights that average the differences of three channels.
CHANNEL_MEAN = np.array([[0.5, 0.5, 0.5]], dtype=np.float32)


def prepare_flow(first: ImageArray, second: ImageArray) -> FlowPair:
    """Prepare the interpolation of two images by dense inverse search both ways.

    The flows (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29) are computed once for all times, at half or
    quarter size because flow fields are smooth. Each pixel of the new image has two candidate displacements, from the
    forward and from the backward flow. The candidate whose two ends agree better over a small window has more weight.
    In wide boxes it is used alone, at half the cost. Where neither agrees, something is covered or uncovered, and the
    nearer frame is used.

    Args:
        first: Image (h, w, 3), a whole frame or a box of any size above 32 px, without its moving balls.
        second: Image of the same size.

    Returns:
        The flows between them.
    """
    height, width = first.shape[:2]
    shrink = next((by for by, least in SHRINK_FROM_SIDE if min(height, width) >= least), 1)
    size = (-(-width // shrink), -(-height // shrink))
    small = [cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8) for image in (first, second)]
    a, b = (np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8) for image in small)
    grid, finest = pixel_grid(*a.shape), max(2 - shrink, 0)
    shifts = find_ticker_shifts(a, b)
    forward = apply_ticker_shifts(compute_flow(a, b, finest), a, b, shifts, grid)
    backward = apply_ticker_shifts(compute_flow(b, a, finest), b, a, [-shift for shift in shifts], grid)
    return FlowPair((first, second), (small[0], small[1]), forward, backward, grid, is_wide=shrink == QUARTER_SIZE)


@dataclass(frozen=True, slots=True)
class FlowPair:
    """Forward and backward flow between two images, with the images in full and in reduced size."""

    images: tuple[ImageArray, ImageArray]
    small_images: tuple[ImageArray, ImageArray]
    """The same images reduced; candidate displacements are compared on these."""
    forward: Float32Array
    """(h, w, 2) px of the reduced images, from the first to the second."""
    backward: Float32Array
    """(h, w, 2) px of the reduced images, from the second to the first."""
    small_grid: Float32Array
    """(h, w, 2) px, pixel coordinates of the reduced images."""
    is_wide: bool = False
    """Whether the better candidate is used alone."""

    def interpolate(self, share: float, shift: FloatArray | None = None) -> ImageArray:
        """Return the image (H, W, 3) at a share, 0 to 1, of the time from the first image to the second.

        With `shift` (2,) px, less than a pixel, all of it is moved by that.

        Where the ends of a displacement disagree, the nearer image is used: it is right more often than a mixture.
        """
        fields = [
            self._displacement_at(self.forward, share),
            np.negative(self._displacement_at(self.backward, 1 - share)),
        ]
        costs = [self._matching_cost(field, share) for field in fields]
        if self.is_wide:
            fields = [np.where((costs[1] < costs[0])[..., None], fields[1], fields[0])]
            costs = [np.minimum(*costs)]
        (height, width), (rows, columns) = self.images[0].shape[:2], costs[0].shape
        grid, stretch = pixel_grid(height, width), np.array([width / columns, height / rows], np.float32)
        if shift is not None:
            grid = grid - shift.astype(np.float32)
        agree = [1 / (cost + 1) ** 2 for cost in costs]
        mixtures = []
        for field, cost in zip(fields, costs, strict=True):
            displacement = cv2.resize(field * stretch, (width, height), interpolation=cv2.INTER_LINEAR)
            doubt = np.clip(cost / np.float32(MAX_DISAGREEMENT) - 1, 0, 1)
            later = cv2.resize(share + (smooth_step(share) - share) * doubt, (width, height))
            first = _sample_image(self.images[0], grid - np.float32(share) * displacement)
            second = _sample_image(self.images[1], grid + np.float32(1 - share) * displacement)
            mixtures.append(cv2.blendLinear(first, second, 1 - later, later))
        if len(mixtures) == 1:
            return np.asarray(mixtures[0], dtype=np.uint8)
        trust = cv2.resize(agree[0] / (agree[0] + agree[1]), (width, height))
        return np.asarray(cv2.blendLinear(mixtures[0], mixtures[1], trust, 1 - trust), dtype=np.uint8)

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


def smooth_step(share: float) -> float:
    """Return a share that passes quickly through the middle, so that a hand in a cross-fade appears double briefly."""
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


# Shifts that are sought in one box.
MAX_SHIFTS = 2
# Optical flow follows shorter shifts.
MIN_SHIFT_PX = 3.0
# Least height of a correlation peak, 1 for a pure translation; lower peaks are chance and coding noise.
MIN_PEAK = 0.04
# px, side of the window whose mean is subtracted, so that letters count and not the background.
HIGH_PASS_PX = 9
# Levels of 255 above which a pixel counts as changed.
MIN_CHANGE = 12.0
# px over which the two ends of a shift are compared.
WINDOW_PX = 5
# Levels by which a shift must fit better than the flow, and by which its two ends may differ at most.
MIN_IMPROVEMENT, MAX_DIFFERENCE = 6.0, 12.0
# Pixels that a shift must explain better to be accepted.
MIN_AREA_PX = 160


def find_ticker_shifts(first: ImageArray, second: ImageArray) -> list[Float32Array]:
    """Find the shifts of whole lines of text from one grey image (h, w) to another.

    Returns:
        Shifts (2,) px; the opposite shifts hold for the reverse direction.
    """
    if min(first.shape) < HIGH_PASS_PX:
        return []
    changed = cv2.blur(cv2.absdiff(first, second), (WINDOW_PX, WINDOW_PX)) > MIN_CHANGE
    return _find_shifts(first, second, changed) if np.count_nonzero(changed) >= MIN_AREA_PX else []


def apply_ticker_shifts(
    flow: Float32Array, first: ImageArray, second: ImageArray, shifts: list[Float32Array], grid: Float32Array
) -> Float32Array:
    """Replace a flow (h, w, 2) px by ticker shifts at the pixels where these fit both grey images better.

    `grid` (h, w, 2) px are the coordinates of every pixel.
    """
    if not shifts:
        return flow
    cost = _endpoint_difference(first, second, grid + flow)
    for shift in shifts:
        shift_field = np.broadcast_to(shift, flow.shape)
        shift_cost = _endpoint_difference(first, second, grid + shift_field)
        better = (cost - shift_cost > MIN_IMPROVEMENT) & (shift_cost < MAX_DIFFERENCE)
        if np.count_nonzero(better) >= MIN_AREA_PX:
            # The background between the letters shifts with them.
            better = (cv2.dilate(better.view(np.uint8), np.ones((WINDOW_PX, WINDOW_PX), np.uint8)) > 0) & (
                shift_cost <= cost
            )
            flow = np.where(better[..., None], shift_field, flow)
            cost = np.where(better, shift_cost, cost)
    return flow


def _endpoint_difference(first: ImageArray, second: ImageArray, where: Float32Array) -> Float32Array:
    """Return the levels (h, w) by which each pixel of the first image differs from its target `where` (h, w, 2) px."""
    sampled = cv2.remap(second, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(cv2.blur(cv2.absdiff(first, np.asarray(sampled)).astype(np.float32), (WINDOW_PX, WINDOW_PX)))


def _find_shifts(first: ImageArray, second: ImageArray, changed: NDArray[np.bool_]) -> list[Float32Array]:
    """Return the most likely shifts (x, y) px of the changed pixels as a whole, with subpixel accuracy."""
    height, width = (cv2.getOptimalDFTSize(side) for side in first.shape)
    weight = cv2.GaussianBlur(changed.astype(np.float32), (0, 0), 2.0)
    spectra = []
    for image in (first, second):
        detail = image.astype(np.float32)
        detail = (detail - cv2.blur(detail, (HIGH_PASS_PX, HIGH_PASS_PX))) * weight
        framed = np.zeros((height, width), dtype=np.float32)
        framed[: first.shape[0], : first.shape[1]] = detail
        spectra.append(np.fft.rfft2(framed))
    cross = np.conj(spectra[0]) * spectra[1]
    softness = _frequency_weights(height, width)
    peaks = np.fft.irfft2(cross / np.maximum(np.abs(cross), 1e-6) * softness, s=(height, width))
    least, shifts = MIN_PEAK * softness.mean(), list[Float32Array]()
    for _ in range(2 * MAX_SHIFTS):
        row, column = np.unravel_index(int(peaks.argmax()), peaks.shape)
        if len(shifts) == MAX_SHIFTS or peaks[row, column] < least:
            break
        shift = _refine_peak(peaks, int(row), int(column))
        if np.hypot(*shift) > MIN_SHIFT_PX:
            shifts.append(np.array(shift, dtype=np.float32))
        for dy in range(-2, 3):
            peaks[(row + dy) % height, (column + np.arange(-2, 3)) % width] = 0
    return shifts


@lru_cache(maxsize=32)
def _frequency_weights(height: int, width: int) -> NDArray[np.float64]:
    """Return weights (h, w // 2 + 1) of the spatial frequencies; the highest are noise."""
    y, x = np.fft.fftfreq(height)[:, None], np.fft.rfftfreq(width)[None]
    return np.asarray(np.exp(-0.5 * (x**2 + y**2) / 0.2**2))


def _refine_peak(peaks: NDArray[np.float64], row: int, column: int) -> tuple[float, float]:
    """Return the subpixel position (x, y) of a peak on a periodic plane, from its neighbours."""
    height, width = peaks.shape
    position = []
    for at, size, line in ((column, width, peaks[row]), (row, height, peaks[:, column])):
        left, centre, right = line[(at - 1) % size], line[at], line[(at + 1) % size]
        curvature = left - 2 * centre + right
        off = 0.5 * (left - right) / curvature if curvature < 0 else 0.0
        position.append(float((at + off + size / 2) % size - size / 2))
    return position[0], position[1]
