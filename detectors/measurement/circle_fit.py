"""The centre of a disc to a fraction of a pixel, with its error: edges along rays, a robust circle through them.

On each ray the edge is where the colour changes fastest (any colour change, so a ball in its own shadow keeps its
outline: the soft rim of a shadow changes slower than the rim of a ball). Its place is the centroid of the squared
gradient, which blur that is the same on both sides does not move.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from detectors.measurement.cloth_background import SHADOW_WEIGHT
from detectors.measurement.columns import with_rows
from models.core.typing import BoolArray, ByteArray, FloatArray

RAYS = 48
STEPS = 32
"""Samples along a ray."""
NEAREST, FARTHEST = 0.5, 1.5
"""Reach of a ray, ball radii."""
PRIOR_RADII = (0.2, 0.12, 0.07)
"""How far from the circle an edge is still looked for, one standard deviation, ball radii, round by round."""
LOOSE = (0.3, 0.15, 0.15)
"""How far an edge may be from the circle through all edges to count, ball radii, round by round."""
SATURATION = 10.0
"""Gradient above which a stronger one is no better: the rim of a stripe must not beat the rim of the ball."""
BARE_LEVELS = 15.0
"""Difference from the cloth, grey levels, at which what lies behind an edge is half bare cloth."""
COVERED_WORTH = 0.5
"""Worth of an edge with something else behind it, such as another ball, over that of an edge to the cloth less this."""
RADIUS_RADII = 0.05
"""How far the seen radius may be from the predicted one: error of the calibration, blooming; one standard deviation."""
LEAST_GRADIENT = 9.0
"""Grey levels over a sixth of a radius: weaker changes are no edge."""
TIGHT_RADII, TIGHT_PX = 0.07, 0.6
"""An edge supports a circle when it is within this of it."""
LUMA = np.array([0.299, 0.587, 0.114], dtype=np.float32)
"""Brightness of RGB (ITU-R BT.601)."""
HIDING_RADII = 1.15
"""Radius, over its own, of what a disc hides of those behind it: its rim is as soft as the lens makes it."""
LEAST_OPEN = 0.35
"""Share of the rays that must be open for support to be a share of those alone."""
FLOOR_PX = 0.1
"""Error that no edge shows: sampling, coding; px, one standard deviation."""
COMMON_SHARE = 0.9
"""Error of a centre over the root mean square miss of its edges. What makes them miss (a dark underside, its shadow, a
stripe) is common to many neighbouring rays and to all pictures of a ball at rest, so it does not average out; measured
on rendered clips with known centres, where pulls are then one on average."""
MOST_MISS = 3.0
"""Misses count up to this many times the distance at which an edge still supports a circle."""

DOUBTFUL = (0.35, 0.8)
"""Support between which a circle is tried again."""
RESTARTS, RESTART_RADII = 6, 0.6
"""How often, and how far away, ball radii."""

ANGLES = np.arange(RAYS) * (2 * np.pi / RAYS)
DIRECTIONS = np.column_stack([np.cos(ANGLES), np.sin(ANGLES)])
DISTANCES = np.linspace(NEAREST, FARTHEST, STEPS)
EACH_RAY, ABOUT_BEST = np.arange(RAYS), np.arange(-4, 5)
"""Indices of the rays, and of the samples about an edge that say where it is."""
DESIGN = np.column_stack([DIRECTIONS, np.ones(RAYS)])
SQUARES = (DESIGN[:, :, None] * DESIGN[:, None, :]).reshape(RAYS, 9)
"""Products of the design's columns: the normal equations are linear in the weights."""


@dataclass(frozen=True, slots=True)
class Circles:
    """K fitted circles, px."""

    centre: FloatArray
    """(K, 2)"""
    radius: FloatArray
    """(K,)"""
    sigma: FloatArray
    """(K,) one standard deviation per axis."""
    support: FloatArray
    """(K,) share of the rays whose edge lies on the circle."""

    def take(self, rows: NDArray[np.int64] | BoolArray) -> Circles:
        """Some of the rows."""
        return Circles(*(getattr(self, name)[rows] for name in self.__slots__))


def fit_circles(
    rgb: ByteArray,
    soft: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    cloth: FloatArray,
    basis: FloatArray,
    before: FloatArray | None = None,
) -> Circles:
    """Circles near guesses: centres (K, 2) px, expected radii (K,) px, in a picture (H, W, 3) and `softened`.

    `before` (K, M, 3) are centre and radius, px, of discs that stand before each, NaN for none: they hide its edges.
    """
    if not len(centre):
        return Circles(np.empty((0, 2)), *(np.empty(0) for _ in range(3)))
    place, seen = centre.astype(np.float64), radius.astype(np.float64)
    for turn, prior in enumerate(PRIOR_RADII):
        edge, strength = _edges(rgb, soft, place, radius, seen / radius, prior, cloth, basis, before)
        # The first look starts a pixel or two off; later ones trust the circle more.
        step, dr, weights, residual = _fit(edge, strength, radius, LOOSE[turn])
        place = place + step
        seen = radius + dr
    return _measured(place, seen, radius, weights, residual, strength)


def measure_again(
    rgb: ByteArray,
    soft: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    relative: FloatArray,
    cloth: FloatArray,
    basis: FloatArray,
) -> Circles:
    """Circles that were at centres (K, 2) px, of `relative` times the expected radii (K,) px, a picture ago."""
    if not len(centre):
        return Circles(np.empty((0, 2)), *(np.empty(0) for _ in range(3)))
    edge, strength = _edges(rgb, soft, centre, radius, relative, PRIOR_RADII[-1], cloth, basis)
    step, dr, weights, residual = _fit(edge, strength, radius, LOOSE[-1])
    return _measured(centre + step, radius + dr, radius, weights, residual, strength)


def second_chances(
    rgb: ByteArray, soft: ByteArray, circles: Circles, expected: FloatArray, cloth: FloatArray, basis: FloatArray
) -> Circles:
    """Try circles with doubtful support again from places around them: a stripe or a number is a strong false start."""
    doubtful = np.flatnonzero((circles.support > DOUBTFUL[0]) & (circles.support < DOUBTFUL[1]))
    if not len(doubtful):
        return circles
    around = RESTART_RADII * DIRECTIONS[:: RAYS // RESTARTS]
    starts = circles.centre[doubtful, None] + expected[doubtful, None, None] * around
    beneath = np.repeat(cloth[doubtful], RESTARTS, axis=0)
    again = fit_circles(rgb, soft, starts.reshape(-1, 2), np.repeat(expected[doubtful], RESTARTS), beneath, basis)
    near = np.linalg.norm(again.centre - np.repeat(circles.centre[doubtful], RESTARTS, axis=0), axis=1)
    worth = np.where(near < np.repeat(expected[doubtful], RESTARTS), again.support, 0.0).reshape(-1, RESTARTS)
    best = np.argmax(worth, axis=1)
    better = worth[np.arange(len(doubtful)), best] > circles.support[doubtful] + 0.1
    rows, chosen = doubtful[better], (np.arange(len(doubtful)) * RESTARTS + best)[better]
    return with_rows(circles, rows, again.take(chosen))


def _edges(
    rgb: ByteArray,
    soft: ByteArray,
    centre: FloatArray,
    radius: FloatArray,
    likely: FloatArray,
    prior: float,
    cloth: FloatArray,
    basis: FloatArray,
    before: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Edge on every ray: distance (K, A) px from the centre, gradient (K, A), NaN where other discs hide it."""
    profile = ray_profiles(rgb, soft, centre, radius, basis)
    half = 2
    change = profile[:, :, 2 * half :] - profile[:, :, : -2 * half]
    gradient = np.sqrt(np.einsum("kasc,kasc->kas", change, change))
    at = DISTANCES[half:-half]
    near_circle = np.exp(-0.5 * ((at - likely[:, None]) / prior) ** 2)
    hidden = None if before is None else _hidden(centre, radius, at, before)
    if hidden is not None:
        gradient[hidden] = 0.0
    # Behind the outline of a ball there is cloth; behind that of its stripe or its number there is more ball.
    away = profile[:, :, 2 * half :] - (cloth @ weighed(basis).T)[:, None, None]
    bare = 1 / (1 + np.sqrt(np.einsum("kasc,kasc->kas", away, away)) / BARE_LEVELS)
    expected = gradient / (gradient + SATURATION) * near_circle[:, None] * (COVERED_WORTH + bare)
    best = np.argmax(expected, axis=2)
    near = np.minimum(np.maximum(best[..., None] + ABOUT_BEST, 0), len(at) - 1)
    balls = np.arange(len(centre))[:, None]
    local = gradient[balls[..., None], EACH_RAY[:, None], near]
    weight = np.maximum(local - 0.5 * local.max(axis=2, keepdims=True), 0)
    place = (weight * at[near]).sum(axis=2) / np.maximum(weight.sum(axis=2), 1e-9)
    strength = gradient[balls, EACH_RAY, best]
    if hidden is not None:
        rim = np.argmin(np.abs(at - likely[:, None]), axis=1)
        strength[hidden[balls, EACH_RAY, rim[:, None]]] = np.nan
    return place * radius[:, None], strength


def _hidden(centre: FloatArray, radius: FloatArray, at: FloatArray, before: FloatArray) -> BoolArray:
    """Whether discs hide the places (K, A, S) at distances (S,), ball radii, on the rays about centres (K, 2)."""
    ray = centre[:, :, None, None] + radius[:, None, None, None] * DIRECTIONS.T[:, :, None] * at
    hidden = np.zeros((len(centre), RAYS, len(at)), dtype=bool)
    for disc in before.transpose(1, 2, 0)[..., None, None]:
        hidden |= (ray[:, 0] - disc[0]) ** 2 + (ray[:, 1] - disc[1]) ** 2 < (HIDING_RADII * disc[2]) ** 2
    return hidden


def ray_profiles(
    rgb: ByteArray, soft: ByteArray, centre: FloatArray, radius: FloatArray, basis: FloatArray
) -> NDArray[np.float32]:
    """Colours (K, A, S, 3) along the rays, in the cloth's basis with brightness weighed down."""
    k = len(centre)
    offsets = DIRECTIONS[:, None] * DISTANCES[None, :, None]
    at = centre[:, None, None] + radius[:, None, None, None] * offsets[None]
    flat = at.reshape(k * RAYS, STEPS, 2).astype(np.float32)
    return _colours_at(rgb, soft, flat, weighed(basis)).reshape(k, RAYS, STEPS, 3)


def weighed(basis: FloatArray) -> NDArray[np.float32]:
    """Takes RGB to the cloth's basis with brightness weighed down (3, 3)."""
    return np.asarray(basis * np.array([[1.0], [1.0], [SHADOW_WEIGHT]]), dtype=np.float32)


def _colours_at(
    rgb: ByteArray, soft: ByteArray, at: NDArray[np.float32], taken: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Colours (n, m, 3) at px (n, m, 2): those of the surroundings with the brightness of the place itself.

    `taken` (3, 3) takes RGB to the colours that are wanted.
    """
    sharp = cv2.remap(rgb, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    around = cv2.remap(soft, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    lighter = np.outer(taken.sum(axis=1), LUMA)
    found = cv2.transform(around.astype(np.float32), taken - lighter)
    return np.asarray(cv2.add(found, cv2.transform(sharp.astype(np.float32), lighter)), dtype=np.float32)


def softened(rgb: ByteArray) -> ByteArray:
    """The picture (H, W, 3) averaged over 3 x 3 pixels, where colours are read.

    Clips hold colour at half the resolution (4:2:0) and decoders repeat it: its edges stand on even pixels only, and a
    red ball on blue cloth, which are equally bright, would be seen up to a pixel off.
    """
    return np.asarray(cv2.blur(rgb, (3, 3)), dtype=np.uint8)


def _fit(
    edge: FloatArray, strength: FloatArray, radius: FloatArray, loose: float
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Shift (K, 2), change of radius (K,), weights (K, A) and residuals (K, A) of circles through edges (K, A)."""
    offset = edge - radius[:, None]
    design, squares = DESIGN, SQUARES
    # What is hidden is NaN: fmax makes 0 of it.
    clear = np.minimum(np.fmax((strength - LEAST_GRADIENT) / LEAST_GRADIENT, 0), 1)
    scale = np.maximum(loose * radius, 0.8)[:, None]
    shift = np.zeros((len(edge), 3))
    # The median of an even number, without what numpy's does beside.
    median = np.partition(offset, [RAYS // 2 - 1, RAYS // 2], axis=1)[:, RAYS // 2 - 1 : RAYS // 2 + 1].mean(axis=1)
    shift[:, 2] = np.minimum(np.maximum(median, -0.1 * radius), 0.1 * radius)
    for _ in range(4):
        residual = offset - shift @ design.T
        weights = clear * np.maximum(1 - (residual / scale) ** 2, 0) ** 2
        normal = (weights @ squares).reshape(-1, 3, 3)
        right = (weights * offset) @ design
        # The predicted radius is worth a few rays, and the guess a little: a one-sided arc stays put.
        normal[:, 2, 2] += 2.0 * (TIGHT_PX / (RADIUS_RADII * radius)) ** 2
        normal[:, [0, 1], [0, 1]] += 0.02
        shift = np.linalg.solve(normal, right[..., None])[..., 0]
    limit = 0.6 * radius[:, None]
    return np.clip(shift[:, :2], -limit, limit), shift[:, 2], weights, offset - shift @ design.T


def _measured(
    centre: FloatArray,
    seen: FloatArray,
    expected: FloatArray,
    weights: FloatArray,
    residual: FloatArray,
    strength: FloatArray,
) -> Circles:
    tight = np.maximum(TIGHT_RADII * expected, TIGHT_PX)[:, None]
    good = (np.abs(residual) < 2 * tight) & (strength > LEAST_GRADIENT)
    spread = np.sqrt((weights * residual**2).sum(1) / np.maximum(weights.sum(1) - 3, 1.0))
    normal = (weights @ SQUARES).reshape(-1, 3, 3) + 0.02 * np.eye(3)
    # Neighbouring rays of a small ball cross the same pixels: they are one observation.
    repeated = np.maximum(1.0, RAYS * 1.5 / (2 * np.pi * expected))
    variance = np.linalg.inv(normal)[:, [0, 1], [0, 1]].mean(axis=1) * spread**2 * repeated
    misses = np.minimum(np.abs(residual), MOST_MISS * tight)
    open_rays = ~np.isnan(strength)
    count = np.maximum(open_rays.sum(axis=1), 1)
    common = (misses**2 * open_rays).sum(axis=1) / count
    sigma = np.sqrt(FLOOR_PX**2 + variance + COMMON_SHARE**2 * common)
    return Circles(centre, seen, sigma, good.sum(axis=1) / np.maximum(count, LEAST_OPEN * RAYS))
