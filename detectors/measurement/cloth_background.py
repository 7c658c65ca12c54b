"""The colour of the empty table, and the difference of an image from it.

Cloth has one colour under uneven light. A polynomial of low degree over the table models the light; markings, seams,
projected lines and the shade along the cushions are taken from the median of a few images, because they are narrower
than a ball. Structures as wide as a ball (balls at rest) are not.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.ball_colour import DISC_SAMPLES
from detectors.measurement.working_view import WorkingView, nearest_pixels, values_at
from models.core.scene import POCKETS
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray, IntArray
from models.numerics.statistics import estimate_sigma

# Weight of differences towards darker shades of the cloth's own colour, which are mostly shadows.
SHADOW_WEIGHT = 0.5
# Least threshold, grey levels of 255: differences by video coding and the grain of the cloth.
MIN_DIFFERENCE_LEVELS = 15.0
# Threshold over the standard deviation of the cloth's pixels.
NOISE_FACTOR = 5.0
# Half width, ball radii, below which a difference in the median image is a marking of the cloth.
MARKING_RADII = 0.6
# Radius, ball radii, up to which a region enclosed by a ball belongs to it, such as its number.
NUMBER_RADII = 0.3
# Degree of the polynomial of the cloth's colour over the table.
POLYNOMIAL_DEGREE = 4
# Differences up to this many grey levels, smoothed over this many ball radii, are attributed to the light.
GRADUAL_LEVELS, GRADUAL_RADII = 45.0, 3.0

# Ball radii within which samples are of a disc's core, and from which of its rim; and parts of the rim. One may be
# plain: a line may cross the disc, or a shadow hide it.
CORE_RADII, RIM_RADII, RIM_SECTORS = 0.5, 0.7, 6
# Contrast of a core over that of its rim below which the cloth shows through: a ball is opaque, and lightest in the
# middle. In 1,871 detections of balls in broadcasts it is 1.02 or more; of a projector's rings, two in three are below
# 0.3 and all below 0.7.
HOLLOW_SHARE = 0.7
# Contrast of the second palest part of the rim over that of the core below which the object is narrower than a ball:
# 0.01 to 0.04 on drawn lines; of 866 detections of balls in real clips, 0.10 or more.
INCOMPLETE_SHARE = 0.06


# Ball radii from the middle of a pocket at which cloth is looked for: holes of small tables reach up to 3.3.
HOLE_STEPS = np.arange(0.0, 5.0, 0.1)
# Steps for which cloth stays where a hole ends: the meshes of a net are narrower.
CLOTH_STEPS = 8
# Rays from a pocket onto the table, and how far they turn from its axis: further on are the jaws.
HOLE_RAYS, HOLE_HALF_ANGLE = 15, np.radians(25.0)
# Largest reach of the hole of a side pocket, in that of a corner: 0.2 to 0.5 on tables with nets.
MAX_SIDE_SHARE = 0.5
# Ball radii along the cushion from the middle of a long side within which its hole may lie: in a squeezed image of a
# coin table the nets hung 0.8 beside it, on both sides.
SIDE_SHIFTS = np.arange(-1.2, 1.3, 0.2)
# Ball radii within the edge of a hole in which a centre may still appear: errors of the calibration, and the shade of
# the edge. Nets were detected as balls up to 0.45 within the edge; of 256 balls on stills, the nearest to a corner lies
# 0.8 outside.
HOLE_SLACK_RADII = 0.3
# Largest factor by which the light on a net changes in a clip: a player's shade took a fifth of it from white nets,
# more than the threshold. Beyond it, or in another hue, something else is seen: a ball that drops.
MAX_LIGHT_CHANGE = 1.4
# Added to the diagonal of the normal equations of the polynomial, which is a count of pixels: they can be solved even
# if all visible cloth is in one line.
RIDGE = 1e-9
_SAMPLE_RADII = np.hypot(*DISC_SAMPLES.T)
# (SAMPLES,) distance from the middle of a disc, ball radii, and the part of its rim.
_SAMPLE_SECTORS = np.floor((np.arctan2(*DISC_SAMPLES.T) / (2 * np.pi) % 1) * RIM_SECTORS)
# Rows and columns of the whole image.
WHOLE_IMAGE = (slice(None), slice(None))


@dataclass(frozen=True, slots=True)
class ClothBackground:
    """The empty table in the working image."""

    colour: Float32Array
    """(h, w, 3) RGB of the empty table, markings included."""
    marking_places: NDArray[np.int64]
    """(n,) flat indices of the markings; plain cloth is accepted there too, as a cue that rested long looks like
    one."""
    plain_colour: Float32Array
    """(n, 3) RGB of the plain cloth there."""
    median_image: ByteArray
    """(h, w, 3) RGB median of the images, balls at rest included."""
    hole_area: BoolArray
    """(h, w) where a centre is over the hole of a pocket: a ball at rest there has dropped."""
    basis: FloatArray
    """(3, 3) rows: two axes across the cloth's colour, one along it (brightness)."""
    threshold: float
    """Grey levels above which a pixel is not cloth."""

    def measure_contrast(self, working: ByteArray, part: tuple[slice, slice] = WHOLE_IMAGE) -> Float32Array:
        """Measure the signed differences from the empty table along `basis`, with darker cloth weighted down.

        Args:
            working: Working image (H, W, 3).
            part: Rows and columns (h, w) to measure.

        Returns:
            Differences (h, w, 3), grey levels.
        """
        contrast = self._weight_shadows(cv2.subtract(working[part], self.colour[part], dtype=cv2.CV_32F))
        y, x = np.divmod(self.marking_places, working.shape[1])
        (top, bottom, _), (left, right, _) = (s.indices(n) for s, n in zip(part, working.shape[:2], strict=True))
        within = (y >= top) & (y < bottom) & (x >= left) & (x < right)
        if not within.any():
            return contrast
        y, x = y[within], x[within]
        plain = self._weight_shadows((working[y, x] - self.plain_colour[within])[None])[0]
        marked = contrast[y - top, x - left]
        nearer = (plain**2).sum(axis=1, keepdims=True) < (marked**2).sum(axis=1, keepdims=True)
        contrast[y - top, x - left] = np.where(nearer, plain, marked)
        return contrast

    def _weight_shadows(self, difference: Float32Array) -> Float32Array:
        first, second, along = cv2.split(cv2.transform(difference, self.basis.astype(np.float32)))
        return np.asarray(cv2.merge((first, second, cv2.max(along, SHADOW_WEIGHT * along))), dtype=np.float32)

    def measure_difference(self, working: ByteArray, row: IntArray, column: IntArray) -> Float32Array:
        """Measure the difference (n,) of single pixels from the cloth, grey levels, with shadows weighted down."""
        away = self._weight_shadows((working[row, column] - self.colour[row, column])[None])[0]
        return np.asarray(np.sqrt((away**2).sum(axis=1)), dtype=np.float32)

    def find_open_discs(self, working: ByteArray, centre: FloatArray, radius: FloatArray) -> BoolArray:
        """Find the discs through which or beside which plain cloth shows: rings and lines of light or paint.

        A ball is opaque and lightest in the middle, and hides the markings of the cloth too.

        Args:
            working: Working image (h, w, 3).
            centre: Centres (K, 2), working px.
            radius: Radii (K,), working px.

        Returns:
            Mask (K,).
        """
        if not len(centre):
            return np.zeros(0, dtype=np.bool_)
        at = centre[:, None] + radius[:, None, None] * DISC_SAMPLES
        difference = self._measure_difference_from_plain(working, *nearest_pixels(self.hole_area.shape, at))
        core = np.median(difference[:, _SAMPLE_RADII < CORE_RADII], axis=1)
        at_rim, sector = difference[:, _SAMPLE_RADII > RIM_RADII], _SAMPLE_SECTORS[_SAMPLE_RADII > RIM_RADII]
        rim = np.sort([np.median(at_rim[:, sector == k], axis=1) for k in range(RIM_SECTORS)], axis=0)
        is_hollow = (rim[1] > self.threshold) & (core < HOLLOW_SHARE * rim[1])
        return np.asarray(is_hollow | (rim[1] < INCOMPLETE_SHARE * core))

    def _measure_difference_from_plain(self, working: ByteArray, row: IntArray, column: IntArray) -> Float32Array:
        """Measure the difference (K, n) of pixels from the cloth without markings, with shadows weighted down."""
        plain, at = self.colour[row, column], row * working.shape[1] + column
        is_marked = np.isin(at, self.marking_places)
        plain[is_marked] = self.plain_colour[np.searchsorted(self.marking_places, at[is_marked])]
        return contrast_strength(self._weight_shadows(working[row, column] - plain))

    def is_lining(self, working: ByteArray, centre: FloatArray, radius: FloatArray) -> BoolArray:
        """Find the discs at working px (n, 2), of radii (n,), that are parts of a net: they stand still over a hole."""
        place = nearest_pixels(self.hole_area.shape, centre[:, None] + radius[:, None, None] * DISC_SAMPLES)
        # Means over the disc: single meshes of a net flicker, by video coding and where the camera is held by hand.
        now, usual = (image[place].mean(axis=1) for image in (working, self.median_image))
        light = (now * usual).sum(axis=1) / np.maximum((usual**2).sum(axis=1), 1.0)
        light = np.clip(light, 1 / MAX_LIGHT_CHANGE, MAX_LIGHT_CHANGE)[:, None]
        moved = np.abs(now - light * usual).max(axis=1)
        return np.asarray(values_at(self.hole_area, centre) & (moved <= self.threshold))

    def measure_movement(self, working: ByteArray, part: tuple[slice, slice] = WHOLE_IMAGE) -> ByteArray:
        """Measure the difference (h, w) of a part of a working image from the median image, grey levels."""
        red, green, blue = cv2.split(cv2.absdiff(working[part], self.median_image[part]))
        return np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.uint8)


def learn_cloth_background(working_images: list[ByteArray], view: WorkingView) -> ClothBackground:
    """Learn the colours of the empty table.

    Args:
        working_images: Working images (h, w, 3), at least one.
        view: View of the table.

    Returns:
        The empty table.
    """
    plate = np.median(np.stack(working_images), axis=0).astype(np.float32)
    smooth = _add_gradual_light(plate, _fit_cloth_polynomial(plate, view), view)
    basis = build_colour_basis(np.median(smooth[view.cloth_area], axis=0).astype(np.float64))
    threshold = max(MIN_DIFFERENCE_LEVELS, NOISE_FACTOR * _estimate_noise(plate, smooth, view))
    plate_bytes = np.asarray(np.rint(plate), dtype=np.uint8)
    none = np.empty(0, dtype=np.int64)
    no_hole = np.zeros(plate.shape[:2], dtype=bool)
    plain = ClothBackground(smooth, none, smooth.reshape(-1, 3)[none], plate_bytes, no_hole, basis, threshold)
    away = contrast_strength(plain.measure_contrast(plate_bytes))
    markings = (away > threshold) & view.ball_area & ~_is_as_wide_as_balls(away > threshold, view)
    marked = np.flatnonzero(markings)
    colour = np.where(markings[..., None], plate, smooth)
    holes = _find_holes(view, away <= threshold)
    return ClothBackground(colour, marked, smooth.reshape(-1, 3)[marked], plate_bytes, holes, basis, threshold)


def _find_holes(view: WorkingView, is_cloth: BoolArray) -> BoolArray:
    """Find where (h, w) a centre is over the hole of a pocket, as wide as the holes appear.

    Holes of one table are equal, and a ball at a pocket makes its hole look wider: the second smallest counts.
    """
    table = view.scene.table
    if not table.pockets:
        return np.zeros(view.radius.shape, dtype=bool)
    slack, is_corner = HOLE_SLACK_RADII * table.ball_radius, np.array(["-" in name for name in POCKETS])
    corners, sides = table.pocket_centres[is_corner], table.pocket_centres[~is_corner]
    corner = sorted(_measure_hole(view, is_cloth, pocket) for pocket in corners)[1]
    shifts = table.ball_radius * SIDE_SHIFTS[:, None] * [1.0, 0.0]
    depth = [min(_measure_hole(view, is_cloth, side, shift) for side in sides) for shift in shifts]
    side = np.tile(np.minimum(depth, MAX_SIDE_SHARE * corner), len(sides))
    places = (sides[:, None] + shifts).reshape(-1, 2)
    return view.is_centre_near(corners, np.full(4, corner - slack)) | view.is_centre_near(places, side - slack)


def _measure_hole(view: WorkingView, is_cloth: BoolArray, pocket: FloatArray, shift: FloatArray | float = 0.0) -> float:
    """Measure how far (m) the hole of a pocket, seen `shift` m beside it, reaches onto the table: to plain cloth."""
    table, camera = view.scene.table, view.scene.camera
    inwards = np.sign(np.array([table.length / 2, table.width / 2]) - pocket)
    axis = np.arctan2(inwards[1], inwards[0])
    angle = axis + np.linspace(-HOLE_HALF_ANGLE, HOLE_HALF_ANGLE, HOLE_RAYS)
    rays = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    places = pocket + shift + table.ball_radius * HOLE_STEPS[None, :, None] * rays[:, None]
    shown = values_at(is_cloth, view.to_working(camera.to_pixels(places, 0.0)))
    return table.ball_radius * float(np.median(HOLE_STEPS[_find_first_cloth(shown)]))


def _find_first_cloth(shown: BoolArray) -> IntArray:
    """Find the first step (n,) of each ray (n, S) from which cloth is shown for `CLOTH_STEPS`."""
    stays = np.asarray(np.lib.stride_tricks.sliding_window_view(shown, CLOTH_STEPS, axis=1).all(axis=2), dtype=bool)
    return np.asarray(np.where(stays.any(axis=1), stays.argmax(axis=1), 0))


def contrast_strength(contrast: Float32Array) -> Float32Array:
    """Length of the differences of each pixel.

    Args:
        contrast: Differences (h, w, 3).

    Returns:
        Lengths (h, w).
    """
    first, second, along = cv2.split(contrast)
    return np.asarray(cv2.magnitude(cv2.magnitude(first, second), along), dtype=np.float32)


def build_colour_basis(rgb: FloatArray) -> FloatArray:
    """Build orthonormal rows (3, 3) of which the last one points along a colour (3,)."""
    along = rgb / max(float(np.linalg.norm(rgb)), 1e-9)
    _, _, rows = np.linalg.svd(along[None])
    return np.vstack([rows[1:], along])


def _estimate_noise(plate: Float32Array, smooth: Float32Array, view: WorkingView) -> float:
    """Estimate the standard deviation of cloth pixels about the smooth cloth, robust against outliers."""
    residual = (plate - smooth)[view.cloth_area]
    return estimate_sigma(residual)


def _fit_cloth_polynomial(plate: Float32Array, view: WorkingView) -> Float32Array:
    """Fit a polynomial (h, w, 3) of the cloth's colour to the pixels that have it."""
    h, w = plate.shape[:2]
    powers = np.arange(POLYNOMIAL_DEGREE + 1)
    across, down = (np.linspace(-1, 1, n)[:, None] ** powers for n in (w, h))
    j, i = np.nonzero(powers[:, None] + powers <= POLYNOMIAL_DEGREE)
    rows = np.flatnonzero(view.cloth_area.ravel())[:: max(1, int(view.cloth_area.sum() // 20000))]
    design, colours = down[rows // w][:, j] * across[rows % w][:, i], plate.reshape(-1, 3)[rows].astype(np.float64)
    keep = _is_cloth_coloured(colours, view.scene.cloth_lab)
    for _ in range(5):
        kept_design = design[keep]  # normal equations: a tenth of the time, and the powers are all of size 1 at most
        coefficients = np.linalg.solve(
            kept_design.T @ kept_design + RIDGE * np.eye(len(j)), kept_design.T @ colours[keep]
        )
        miss = np.linalg.norm(colours - design @ coefficients, axis=1)
        keep = miss < max(3.0 * estimate_sigma(miss[keep], 0.0), 6.0)
    table = np.zeros((len(powers), len(powers), 3))
    table[j, i] = coefficients
    surface = [down @ table[..., channel] @ across.T for channel in range(3)]
    return np.asarray(np.clip(np.stack(surface, axis=-1), 0, 255), dtype=np.float32)


def _is_cloth_coloured(colours: FloatArray, cloth_lab: FloatArray) -> BoolArray:
    """Which colours (n, 3) are near the cloth's; the nearest half if few are."""
    lab = cv2.cvtColor((colours[None] / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    # Light differs over a table, hue does not: lightness counts a third.
    distance = np.linalg.norm((lab - cloth_lab) * np.array([0.33, 1.0, 1.0]), axis=1)
    near: BoolArray = distance < max(12.0, float(np.median(distance)))
    return near


def _add_gradual_light(plate: Float32Array, smooth: Float32Array, view: WorkingView) -> Float32Array:
    """Add changes over many radii that no polynomial models, such as lamps, to the smooth cloth (h, w, 3)."""
    residual = plate - smooth
    level = cv2.magnitude(cv2.magnitude(residual[..., 0], residual[..., 1]), residual[..., 2])
    weight = (view.cloth_area & (level < GRADUAL_LEVELS)).astype(np.float32)
    sigma = GRADUAL_RADII * view.median_radius
    total = cv2.GaussianBlur(weight, (0, 0), sigma)[..., None]
    gradual = cv2.GaussianBlur(residual * weight[..., None], (0, 0), sigma) / (total + 0.02)
    return np.asarray(np.clip(smooth + gradual, 0, 255), dtype=np.float32)


def _is_as_wide_as_balls(away: BoolArray, view: WorkingView) -> BoolArray:
    """Where (h, w) a difference is as wide as a ball, with its surroundings."""
    # The number of a ball may have the colour of the cloth.
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~away).astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < np.pi * (NUMBER_RADII * view.median_radius) ** 2
    whole = ((away | small[labels]) & view.ball_area).astype(np.uint8)
    kernel = build_disc_kernel(MARKING_RADII * view.median_radius)
    opened = cv2.morphologyEx(whole, cv2.MORPH_OPEN, kernel)
    return np.asarray(cv2.dilate(opened, kernel) > 0)


def build_disc_kernel(radius: float) -> ByteArray:
    """Build a round structuring element.

    Args:
        radius: Radius, px; at least 1 is used.

    Returns:
        Mask (n, n) of 0 and 1, n odd.
    """
    n = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (n, n)), dtype=np.uint8)
