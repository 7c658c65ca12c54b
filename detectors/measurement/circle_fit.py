"""Centres of discs with subpixel accuracy and error estimates: edges along rays, and a robust circle through them.

On each ray the edge is where the colour changes fastest (any colour change, so a ball in its own shadow keeps its
outline: the soft rim of a shadow changes slower than the rim of a ball). Its place is the centroid of the squared
gradient, which blur that is the same on both sides does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.ball_colour import LUMA
from detectors.measurement.cloth_background import SHADOW_WEIGHT
from models.core.array_columns import replace_rows, take_rows
from models.core.typing import BoolArray, ByteArray, FloatArray

RAYS = 48
# Samples along a ray.
STEPS = 32
# Start and end of a ray, ball radii.
MIN_RAY_RADII, MAX_RAY_RADII = 0.5, 1.5
# Standard deviation of the prior of an edge about the circle, ball radii, for each iteration.
PRIOR_RADII = (0.2, 0.12, 0.07)
# Distance from the circle through all edges at which an edge no longer counts, ball radii, for each iteration.
LOOSE_RADII = (0.3, 0.15, 0.15)
# Gradient above which a stronger one is hardly preferred: the edge of a stripe must not outweigh that of the ball.
SATURATION_GRADIENT = 10.0
# Difference from the cloth, grey levels, at which the colour behind an edge is half taken for bare cloth.
BARE_CLOTH_LEVELS = 15.0
# Weight of an edge in front of another object; an edge in front of bare cloth has this weight plus 1.
COVERED_EDGE_WEIGHT = 0.5
# Standard deviation of the measured about the predicted radius, ball radii: calibration errors, blooming.
RADIUS_PRIOR_RADII = 0.05
# Least change of an edge, grey levels over a sixth of a radius.
MIN_GRADIENT = 9.0
# Distance up to which an edge supports a circle: ball radii, and px; the larger one counts.
TIGHT_RADII, TIGHT_PX = 0.07, 0.6
# Radius, over its own, within which a disc hides others behind it: the lens blurs its rim.
OCCLUDER_RADII = 1.15
# Share of unoccluded rays up to which the support is relative to this share, beyond to the unoccluded rays.
MIN_OPEN_SHARE = 0.35
# Standard deviation by sampling and coding that the edges do not show, px.
SIGMA_FLOOR_PX = 0.1
# Error of a centre over the root mean square residual of its edges. The causes of the residuals (a dark underside, its
# shadow, a stripe) are common to many neighbouring rays and to all frames of a ball at rest, so they do not average
# out; measured on rendered clips with known centres, where pulls are then one on average.
COMMON_ERROR_SHARE = 0.9
# Largest residual that counts, over the distance at which an edge still supports a circle.
MAX_RESIDUAL = 3.0

# Limits of the support of circles that are fitted again from other starts.
DOUBTFUL_SUPPORT = (0.35, 0.8)
# Number of the other starts, and their distance, ball radii.
RESTARTS, RESTART_RADII = 6, 0.6

ANGLES = np.arange(RAYS) * (2 * np.pi / RAYS)
DIRECTIONS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
DISTANCES = np.linspace(MIN_RAY_RADII, MAX_RAY_RADII, STEPS)
# Indices of the rays, and offsets of the samples whose centroid is the place of an edge.
RAY_INDICES, CENTROID_OFFSETS = np.arange(RAYS), np.arange(-4, 5)
DESIGN = np.column_stack([DIRECTIONS, np.ones(RAYS)])
# Products (RAYS, 9) of the design's columns: the normal equations are linear in the weights.
DESIGN_PRODUCTS = (DESIGN[:, :, None] * DESIGN[:, None, :]).reshape(RAYS, 9)


@dataclass(frozen=True, slots=True)
class Circles:
    """K fitted circles, px."""

    centre: FloatArray
    """(K, 2)"""
    radius: FloatArray
    """(K,)"""
    sigma: FloatArray
    """(K,) standard deviation per axis."""
    support: FloatArray
    """(K,) share of the rays whose edge is on the circle."""

    def take(self, rows: NDArray[np.int64] | BoolArray) -> Circles:
        """Select rows."""
        return take_rows(self, rows)


def fit_circles(
    rgb: ByteArray,
    smooth: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    cloth: FloatArray,
    basis: FloatArray,
    occluders: FloatArray | None = None,
) -> Circles:
    """Fit circles to the outlines of balls near rough centres.

    Args:
        rgb: Image (H, W, 3).
        smooth: The same from `smooth_image`.
        centre: Rough centres (K, 2) px.
        radius: Expected radii (K,) px.
        cloth: RGB (K, 3) of the empty table there.
        basis: Basis (3, 3) of the cloth's colours.
        occluders: Centre and radius (K, M, 3) px of discs in front of each ball, which hide its edges; NaN for none.

    Returns:
        The K circles.
    """
    if not len(centre):
        return Circles(np.empty((0, 2)), *(np.empty(0) for _ in range(3)))
    place, fitted_radius = centre.astype(np.float64), radius.astype(np.float64)
    for turn, prior in enumerate(PRIOR_RADII):
        edge, strength = _locate_edges(
            rgb, smooth, place, radius, fitted_radius / radius, prior, cloth, basis, occluders
        )
        # The first iteration starts a pixel or two off; later ones trust the circle more.
        step, dr, weights, residual = _solve_circles(edge, strength, radius, LOOSE_RADII[turn])
        place = place + step
        fitted_radius = radius + dr
    return _assess_circles(place, fitted_radius, radius, weights, residual, strength)


def refit_circles(
    rgb: ByteArray,
    smooth: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    relative_radius: FloatArray,
    cloth: FloatArray,
    basis: FloatArray,
) -> Circles:
    """Fit circles whose centres and radii are known from the previous frame, in one iteration.

    Args:
        rgb: Image (H, W, 3).
        smooth: The same from `smooth_image`.
        centre: Previous centres (K, 2) px.
        radius: Expected radii (K,) px.
        relative_radius: Previous measured over expected radius (K,).
        cloth: RGB (K, 3) of the empty table there.
        basis: Basis (3, 3) of the cloth's colours.

    Returns:
        The K circles.
    """
    if not len(centre):
        return Circles(np.empty((0, 2)), *(np.empty(0) for _ in range(3)))
    edge, strength = _locate_edges(rgb, smooth, centre, radius, relative_radius, PRIOR_RADII[-1], cloth, basis)
    step, dr, weights, residual = _solve_circles(edge, strength, radius, LOOSE_RADII[-1])
    return _assess_circles(centre + step, radius + dr, radius, weights, residual, strength)


def retry_doubtful_circles(
    rgb: ByteArray, smooth: ByteArray, circles: Circles, expected: FloatArray, cloth: FloatArray, basis: FloatArray
) -> Circles:
    """Fit circles with doubtful support again from starts around them: a stripe or a number may have attracted them.

    Args:
        rgb: Image (H, W, 3).
        smooth: The same from `smooth_image`.
        circles: K circles.
        expected: Expected radii (K,) px.
        cloth: RGB (K, 3) of the empty table there.
        basis: Basis (3, 3) of the cloth's colours.

    Returns:
        The K circles, the better ones replaced.
    """
    doubtful = np.flatnonzero((circles.support > DOUBTFUL_SUPPORT[0]) & (circles.support < DOUBTFUL_SUPPORT[1]))
    if not len(doubtful):
        return circles
    around = RESTART_RADII * DIRECTIONS[:: RAYS // RESTARTS]
    starts = circles.centre[doubtful, None] + expected[doubtful, None, None] * around
    repeated_cloth = np.repeat(cloth[doubtful], RESTARTS, axis=0)
    refitted = fit_circles(
        rgb, smooth, starts.reshape(-1, 2), np.repeat(expected[doubtful], RESTARTS), repeated_cloth, basis
    )
    near = np.linalg.norm(refitted.centre - np.repeat(circles.centre[doubtful], RESTARTS, axis=0), axis=1)
    support = np.where(near < np.repeat(expected[doubtful], RESTARTS), refitted.support, 0.0).reshape(-1, RESTARTS)
    best = np.argmax(support, axis=1)
    better = support[np.arange(len(doubtful)), best] > circles.support[doubtful] + 0.1
    rows, chosen = doubtful[better], (np.arange(len(doubtful)) * RESTARTS + best)[better]
    return replace_rows(circles, rows, refitted.take(chosen))


def _locate_edges(
    rgb: ByteArray,
    smooth: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    relative_radius: FloatArray,
    prior: float,
    cloth: FloatArray,
    basis: FloatArray,
    occluders: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Locate the edge on every ray: distance (K, A) px from the centre, gradient (K, A), NaN where discs hide it."""
    profile = sample_ray_profiles(rgb, smooth, centre, radius, basis)
    half = 2
    change = profile[:, :, 2 * half :] - profile[:, :, : -2 * half]
    gradient = np.sqrt(np.einsum("kasc,kasc->kas", change, change))
    at = DISTANCES[half:-half]
    near_circle = np.exp(-0.5 * ((at - relative_radius[:, None]) / prior) ** 2)
    hidden = None if occluders is None else _is_occluded(centre, radius, at, occluders)
    if hidden is not None:
        gradient[hidden] = 0.0
    # Behind the outline of a ball there is cloth; behind that of its stripe or its number there is more of the ball.
    away = profile[:, :, 2 * half :] - (cloth @ build_shadow_weighted_basis(basis).T)[:, None, None]
    bare = 1 / (1 + np.sqrt(np.einsum("kasc,kasc->kas", away, away)) / BARE_CLOTH_LEVELS)
    expected = gradient / (gradient + SATURATION_GRADIENT) * near_circle[:, None] * (COVERED_EDGE_WEIGHT + bare)
    best = np.argmax(expected, axis=2)
    near = np.minimum(np.maximum(best[..., None] + CENTROID_OFFSETS, 0), len(at) - 1)
    balls = np.arange(len(centre))[:, None]
    local = gradient[balls[..., None], RAY_INDICES[:, None], near]
    weight = np.maximum(local - 0.5 * local.max(axis=2, keepdims=True), 0)
    place = (weight * at[near]).sum(axis=2) / np.maximum(weight.sum(axis=2), 1e-9)
    strength = gradient[balls, RAY_INDICES, best]
    if hidden is not None:
        rim = np.argmin(np.abs(at - relative_radius[:, None]), axis=1)
        strength[hidden[balls, RAY_INDICES, rim[:, None]]] = np.nan
    return place * radius[:, None], strength


def _is_occluded(centre: FloatArray, radius: FloatArray, at: FloatArray, occluders: FloatArray) -> BoolArray:
    """Whether discs hide the places (K, A, S) at distances (S,), ball radii, on the rays about centres (K, 2)."""
    ray = centre[:, :, None, None] + radius[:, None, None, None] * DIRECTIONS.T[:, :, None] * at
    hidden = np.zeros((len(centre), RAYS, len(at)), dtype=bool)
    for disc in occluders.transpose(1, 2, 0)[..., None, None]:
        hidden |= (ray[:, 0] - disc[0]) ** 2 + (ray[:, 1] - disc[1]) ** 2 < (OCCLUDER_RADII * disc[2]) ** 2
    return hidden


def sample_ray_profiles(
    rgb: ByteArray, smooth: ByteArray, centre: FloatArray, radius: FloatArray, basis: FloatArray
) -> NDArray[np.float32]:
    """Sample colours (K, A, S, 3) along the rays, in the cloth's basis with brightness weighted down."""
    k = len(centre)
    offsets = DIRECTIONS[:, None] * DISTANCES[None, :, None]
    at = centre[:, None, None] + radius[:, None, None, None] * offsets[None]
    flat = at.reshape(k * RAYS, STEPS, 2).astype(np.float32)
    return _sample_colours(rgb, smooth, flat, build_shadow_weighted_basis(basis)).reshape(k, RAYS, STEPS, 3)


def build_shadow_weighted_basis(basis: FloatArray) -> NDArray[np.float32]:
    """Build the matrix (3, 3) from RGB to the cloth's basis with brightness weighted down."""
    return np.asarray(basis * np.array([[1.0], [1.0], [SHADOW_WEIGHT]]), dtype=np.float32)


def _sample_colours(
    rgb: ByteArray, smooth: ByteArray, at: NDArray[np.float32], colour_matrix: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Sample colours (n, m, 3) at px (n, m, 2): chroma of the smooth image, brightness of the sharp one.

    `colour_matrix` (3, 3) maps RGB to the returned colours.
    """
    sharp = cv2.remap(rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    around = cv2.remap(smooth, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    luma_matrix = np.outer(colour_matrix.sum(axis=1), LUMA)
    colours = cv2.transform(around.astype(np.float32), colour_matrix - luma_matrix)
    return np.asarray(cv2.add(colours, cv2.transform(sharp.astype(np.float32), luma_matrix)), dtype=np.float32)


def smooth_image(rgb: ByteArray) -> ByteArray:
    """Average an image over 3 x 3 pixels, for its colours.

    Clips store colour at half the resolution (4:2:0) and decoders repeat it: its edges are on even pixels only, and the
    centre of a red ball on blue cloth, which are equally bright, would be up to a pixel off.

    Args:
        rgb: Image (H, W, 3).

    Returns:
        Image (H, W, 3).
    """
    return np.asarray(cv2.blur(rgb, (3, 3)), dtype=np.uint8)


def _solve_circles(
    edge: FloatArray, strength: FloatArray, radius: FloatArray, loose: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Fit circles through edges (K, A): shift (K, 2), change of radius (K,), weights (K, A) and residuals (K, A)."""
    offset = edge - radius[:, None]
    design, squares = DESIGN, DESIGN_PRODUCTS
    # Occluded edges are NaN: fmax makes 0 of them.
    clear = np.minimum(np.fmax((strength - MIN_GRADIENT) / MIN_GRADIENT, 0), 1)
    scale = np.maximum(loose * radius, 0.8)[:, None]
    shift = np.zeros((len(edge), 3))
    # The median of an even number, faster than np.median.
    median = np.partition(offset, [RAYS // 2 - 1, RAYS // 2], axis=1)[:, RAYS // 2 - 1 : RAYS // 2 + 1].mean(axis=1)
    shift[:, 2] = np.minimum(np.maximum(median, -0.1 * radius), 0.1 * radius)
    for _ in range(4):
        residual = offset - shift @ design.T
        weights = clear * np.maximum(1 - (residual / scale) ** 2, 0) ** 2
        normal = (weights @ squares).reshape(-1, 3, 3)
        right = (weights * offset) @ design
        # The predicted radius weighs as much as a few rays, the rough centre a little: a one-sided arc stays in place.
        normal[:, 2, 2] += 2.0 * (TIGHT_PX / (RADIUS_PRIOR_RADII * radius)) ** 2
        normal[:, [0, 1], [0, 1]] += 0.02
        shift = np.linalg.solve(normal, right[..., None])[..., 0]
    limit = 0.6 * radius[:, None]
    return np.clip(shift[:, :2], -limit, limit), shift[:, 2], weights, offset - shift @ design.T


def _assess_circles(
    centre: FloatArray,
    fitted_radius: FloatArray,
    expected: FloatArray,
    weights: FloatArray,
    residual: FloatArray,
    strength: FloatArray,
) -> Circles:
    """Estimate the error and the support of fitted circles."""
    tight = np.maximum(TIGHT_RADII * expected, TIGHT_PX)[:, None]
    good = (np.abs(residual) < 2 * tight) & (strength > MIN_GRADIENT)
    spread = np.sqrt((weights * residual**2).sum(1) / np.maximum(weights.sum(1) - 3, 1.0))
    normal = (weights @ DESIGN_PRODUCTS).reshape(-1, 3, 3) + 0.02 * np.eye(3)
    # Neighbouring rays of a small ball cross the same pixels: they are one observation.
    repeated = np.maximum(1.0, RAYS * 1.5 / (2 * np.pi * expected))
    variance = np.linalg.inv(normal)[:, [0, 1], [0, 1]].mean(axis=1) * spread**2 * repeated
    misses = np.minimum(np.abs(residual), MAX_RESIDUAL * tight)
    open_rays = ~np.isnan(strength)
    count = np.maximum(open_rays.sum(axis=1), 1)
    common = (misses**2 * open_rays).sum(axis=1) / count
    sigma = np.sqrt(SIGMA_FLOOR_PX**2 + variance + COMMON_ERROR_SHARE**2 * common)
    return Circles(centre, fitted_radius, sigma, good.sum(axis=1) / np.maximum(count, MIN_OPEN_SHARE * RAYS))
