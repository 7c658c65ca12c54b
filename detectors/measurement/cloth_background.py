"""What the empty table looks like, and how far a picture differs from it.

Cloth is one colour under uneven light. A low polynomial over the table follows the light; markings, seams,
projected lines and the shade along the cushions are taken from the median of a few pictures, because they are
narrower than a ball. What is as wide as a ball (balls at rest) is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.working_view import View
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

SHADOW_WEIGHT = 0.5
"""Share at which a darker shade of the cloth's own colour counts: mostly it is a shadow."""
LEAST_DIFFERENCE = 15.0
"""Grey levels (of 255) that differ by chance: coding, grain of the cloth."""
NOISE_FACTOR = 5.0
MARKING_RADII = 0.6
"""Half width, in ball radii, below which a difference in the median picture is a marking of the cloth."""
NUMBER_RADII = 0.3
"""Size, in ball radii, up to which what a ball encloses is part of it."""
DEGREE = 4
GRADUAL_LEVELS, GRADUAL_RADII = 45.0, 3.0
"""Differences up to this many grey levels, smoothed over this many ball radii, are the light's."""

LEAST_PIVOT = 1e-9
"""Added to the normal equations of the cloth's polynomial, whose diagonal is a count of pixels: they can be solved even
where all cloth that is seen lies in a line."""
WHOLE = (slice(None), slice(None))


@dataclass(frozen=True, slots=True)
class Cloth:
    """The empty table in the working picture."""

    colour: Float32Array
    """(h, w, 3) RGB of the empty table, markings included."""
    marked: NDArray[np.int64]
    """(n,) flat places of the markings: a cue that lay there for long is taken for one, so plain cloth passes too."""
    plain: Float32Array
    """(n, 3) RGB of the plain cloth there."""
    plate: ByteArray
    """(h, w, 3) RGB median of the pictures, balls at rest included."""
    basis: FloatArray
    """(3, 3) rows: two axes across the cloth's colour, one along it (brightness)."""
    threshold: float
    """Grey levels above which a pixel is not cloth."""

    def contrast(self, working: ByteArray, part: tuple[slice, slice] = WHOLE) -> Float32Array:
        """Signed differences (h, w, 3) from the empty table along `basis`, darker cloth weighed down.

        Of a part of the picture, given by its rows and columns.
        """
        found = self._weighed(cv2.subtract(working[part], self.colour[part], dtype=cv2.CV_32F))
        y, x = np.divmod(self.marked, working.shape[1])
        (top, bottom, _), (left, right, _) = (s.indices(n) for s, n in zip(part, working.shape[:2], strict=True))
        within = (y >= top) & (y < bottom) & (x >= left) & (x < right)
        if not within.any():
            return found
        y, x = y[within], x[within]
        plain = self._weighed((working[y, x] - self.plain[within])[None])[0]
        marked = found[y - top, x - left]
        nearer = (plain**2).sum(axis=1, keepdims=True) < (marked**2).sum(axis=1, keepdims=True)
        found[y - top, x - left] = np.where(nearer, plain, marked)
        return found

    def _weighed(self, difference: Float32Array) -> Float32Array:
        first, second, along = cv2.split(cv2.transform(difference, self.basis.astype(np.float32)))
        return np.asarray(cv2.merge((first, second, cv2.max(along, SHADOW_WEIGHT * along))), dtype=np.float32)

    def unlike(self, working: ByteArray, row: IntArray, column: IntArray) -> Float32Array:
        """How unlike the cloth (n,) some pixels of a picture are, markings not told apart, shadows weighed down."""
        away = self._weighed((working[row, column] - self.colour[row, column])[None])[0]
        return np.asarray(np.sqrt((away**2).sum(axis=1)), dtype=np.float32)

    def moved(self, working: ByteArray, part: tuple[slice, slice] = WHOLE) -> ByteArray:
        """How far (h, w) a part of a picture differs from the median picture, grey levels."""
        red, green, blue = cv2.split(cv2.absdiff(working[part], self.plate[part]))
        return np.asarray(cv2.max(cv2.max(red, green), blue), dtype=np.uint8)


def learn_cloth(workings: list[ByteArray], view: View) -> Cloth:
    """The empty table from a few working pictures (h, w, 3), one is enough."""
    plate = np.median(np.stack(workings), axis=0).astype(np.float32)
    smooth = _followed(plate, _smooth_cloth(plate, view), view)
    basis = colour_basis(np.median(smooth[view.cloth], axis=0).astype(np.float64))
    threshold = max(LEAST_DIFFERENCE, NOISE_FACTOR * _noise(plate, smooth, view))
    plate_bytes = np.asarray(np.rint(plate), dtype=np.uint8)
    none = np.empty(0, dtype=np.int64)
    away = size(Cloth(smooth, none, smooth.reshape(-1, 3)[none], plate_bytes, basis, threshold).contrast(plate_bytes))
    markings = (away > threshold) & view.area & ~_as_wide_as_balls(away > threshold, view)
    marked = np.flatnonzero(markings)
    colour = np.where(markings[..., None], plate, smooth)
    return Cloth(colour, marked, smooth.reshape(-1, 3)[marked], plate_bytes, basis, threshold)


def size(contrast: Float32Array) -> Float32Array:
    """Length (h, w) of the differences (h, w, 3)."""
    first, second, along = cv2.split(contrast)
    return np.asarray(cv2.magnitude(cv2.magnitude(first, second), along), dtype=np.float32)


def colour_basis(rgb: FloatArray) -> FloatArray:
    """Orthonormal rows (3, 3); the last one points along a colour (3,)."""
    along = rgb / max(float(np.linalg.norm(rgb)), 1e-9)
    _, _, rows = np.linalg.svd(along[None])
    return np.vstack([rows[1:], along])


def _noise(plate: Float32Array, smooth: Float32Array, view: View) -> float:
    """Standard deviation of cloth pixels about the smooth cloth, without the outliers."""
    residual = (plate - smooth)[view.cloth]
    return float(1.4826 * np.median(np.abs(residual - np.median(residual, axis=0))))


def _smooth_cloth(plate: Float32Array, view: View) -> Float32Array:
    """Polynomial (h, w, 3) of the cloth's colour, fitted to the pixels that have it."""
    h, w = plate.shape[:2]
    powers = np.arange(DEGREE + 1)
    across, down = (np.linspace(-1, 1, n)[:, None] ** powers for n in (w, h))
    j, i = np.nonzero(powers[:, None] + powers <= DEGREE)
    rows = np.flatnonzero(view.cloth.ravel())[:: max(1, int(view.cloth.sum() // 20000))]
    design, colours = down[rows // w][:, j] * across[rows % w][:, i], plate.reshape(-1, 3)[rows].astype(np.float64)
    keep = _cloth_coloured(colours, view.scene.cloth_lab)
    for _ in range(5):
        kept = design[keep]  # normal equations: a tenth of the time, and the powers are all of size 1 at most
        coefficients = np.linalg.solve(kept.T @ kept + LEAST_PIVOT * np.eye(len(j)), kept.T @ colours[keep])
        miss = np.linalg.norm(colours - design @ coefficients, axis=1)
        keep = miss < max(3.0 * 1.4826 * float(np.median(miss[keep])), 6.0)
    table = np.zeros((len(powers), len(powers), 3))
    table[j, i] = coefficients
    surface = [down @ table[..., channel] @ across.T for channel in range(3)]
    return np.asarray(np.clip(np.stack(surface, axis=-1), 0, 255), dtype=np.float32)


def _cloth_coloured(colours: FloatArray, cloth_lab: FloatArray) -> BoolArray:
    """Which colours (n, 3) are near the cloth's; the nearest half where few are."""
    lab = cv2.cvtColor((colours[None] / 255).astype(np.float32), cv2.COLOR_RGB2LAB)[0]
    # Light differs over a table, hue does not: lightness counts a third.
    distance = np.linalg.norm((lab - cloth_lab) * np.array([0.33, 1.0, 1.0]), axis=1)
    near: BoolArray = distance < max(12.0, float(np.median(distance)))
    return near


def _followed(plate: Float32Array, smooth: Float32Array, view: View) -> Float32Array:
    """The smooth cloth (h, w, 3), with what changes over many radii and no polynomial follows, such as lamps."""
    residual = plate - smooth
    level = cv2.magnitude(cv2.magnitude(residual[..., 0], residual[..., 1]), residual[..., 2])
    weight = (view.cloth & (level < GRADUAL_LEVELS)).astype(np.float32)
    sigma = GRADUAL_RADII * view.typical
    total = cv2.GaussianBlur(weight, (0, 0), sigma)[..., None]
    gradual = cv2.GaussianBlur(residual * weight[..., None], (0, 0), sigma) / (total + 0.02)
    return np.asarray(np.clip(smooth + gradual, 0, 255), dtype=np.float32)


def _as_wide_as_balls(away: BoolArray, view: View) -> BoolArray:
    """Where a difference is as wide as a ball, with its surroundings."""
    # The number of a ball may have the colour of the cloth.
    _, labels, stats, _ = cv2.connectedComponentsWithStats((~away).astype(np.uint8), connectivity=4)
    small = stats[:, cv2.CC_STAT_AREA] < np.pi * (NUMBER_RADII * view.typical) ** 2
    whole = ((away | small[labels]) & view.area).astype(np.uint8)
    kernel = disc_kernel(MARKING_RADII * view.typical)
    opened = cv2.morphologyEx(whole, cv2.MORPH_OPEN, kernel)
    return np.asarray(cv2.dilate(opened, kernel) > 0)


def disc_kernel(radius: float) -> ByteArray:
    """Structuring element of a radius in px, at least 1."""
    n = 2 * max(1, round(radius)) + 1
    return np.asarray(cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (n, n)), dtype=np.uint8)
