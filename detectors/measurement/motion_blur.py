"""Motion-blur model of a fast ball: the share of the exposure for which a moving disc covers each pixel.

A pixel that the disc covers for a share a of the exposure shows (1 - a) of the cloth and a of the ball. For a disc of
the predicted size that moves from one place to another this share has a closed form, ends included; centre,
displacement and the two colours follow by least squares (variable projection: Golub and Pereyra 1973,
doi:10.1137/0710036).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import cv2
import numpy as np

from detectors.measurement.circle_fit import build_shadow_weighted_basis
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray
from models.numerics.least_squares import NormalEquations, SearchOptions, minimize_cost, solve_normal_equations
from models.numerics.statistics import evaluate_huber_loss

# Lengths of the trial displacements, ball radii.
TRIAL_LENGTHS_RADII = np.array([0.0, 0.8, 1.6, 2.6, 3.8, 5.2, 6.8])
# Number of directions of the trial displacements.
TRIAL_DIRECTIONS = 12
# Positions of the middle of a trial streak along it, from the rough position, shares of the length.
TRIAL_ALONG_SHARES = np.array([-0.45, -0.22, 0.0, 0.22, 0.45])
# The same across it, ball radii.
TRIAL_ACROSS_RADII = np.array([-0.35, 0.0, 0.35])
# Reach of the search about the rough position, ball radii.
REACH_RADII = 6.0
# Spacing of the samples of the search, ball radii.
COARSE_SPACING_RADII = 0.3
# Spacing of the samples of the fit, ball radii, but at least one px.
FINE_SPACING_RADII = 0.12
# Margin of cloth about a streak, ball radii.
MARGIN_RADII = 1.0
# Radius within which samples on other balls are excluded, their radii.
OCCLUDER_RADII = 1.15
# Offsets of the radii that are averaged, in units of the blur, and the blur by lens and coding.
BLUR_OFFSETS, BLUR_PX = np.array([-1.0, 0.0, 1.0]), 0.75
# Least number of samples for a search or a fit.
MIN_PIXELS = 60
# Contrast that the best displacement must explain, over that of a ball at rest, for a fit.
MIN_GAIN = 1.1
# Of centre and displacement, px.
SEARCH = SearchOptions(iterations=10, attempts=5, min_step=0.01, damping=1e-2, lowering=1 / 3, raising=4.0)
# Residual, over the root mean square residual, from which a sample is weighted down.
HUBER_THRESHOLD = 2.0
# Share of the contrast that the rough streak may leave unexplained for a fit.
MAX_ROUGH_RESIDUAL_SHARE = 0.5
# Share of the contrast that a streak may leave unexplained: of all, and of that which a ball at rest leaves.
MAX_RESIDUAL_SHARE, MAX_SHARE_OF_REST = 0.15, 0.5
# Limits of the length of a streak, ball radii.
LENGTH_LIMITS_RADII = (0.8, 7.5)


@dataclass(frozen=True, slots=True)
class MotionBlurFit:
    """The motion-blur model fitted to one ball, px."""

    centre: FloatArray
    """(2,) of the ball at mid-exposure."""
    displacement: FloatArray
    """(2,) moved during the exposure, sign unknown."""
    residual_share: float
    """Sum of the squared residuals, over that of bare cloth."""
    residual_share_at_rest: float
    """The same for a ball at rest."""

    def is_streak(self, radius: float) -> bool:
        """Whether a moving ball of a radius, px, explains the image, and one at rest does not."""
        length = float(np.linalg.norm(self.displacement)) / radius
        clear = (
            self.residual_share < MAX_RESIDUAL_SHARE
            and self.residual_share < MAX_SHARE_OF_REST * self.residual_share_at_rest
        )
        return clear and LENGTH_LIMITS_RADII[0] < length < LENGTH_LIMITS_RADII[1]


@dataclass(frozen=True, slots=True)
class _WeightedResiduals:
    """Residuals (n, 3) of centre and displacement (4,), and the weights (n,) of a robust loss."""

    parameters: FloatArray
    residuals: FloatArray
    weights: FloatArray

    @property
    def cost(self) -> float:
        """Weighted sum of squares."""
        return float((self.weights[:, None] * self.residuals**2).sum())


def exposure_share(
    at: FloatArray, centre: FloatArray, displacement: FloatArray, radius: float, blur: float = BLUR_PX
) -> FloatArray:
    """Share of the exposure for which a moving disc covers each place.

    Args:
        at: Places (..., 2) px.
        centre: Centre of the disc at mid-exposure (2,) px.
        displacement: Displacement during the exposure (2,) px.
        radius: Radius of the disc, px.
        blur: Blur of its rim, px.

    Returns:
        Shares (...) in [0, 1].
    """
    length = max(float(np.linalg.norm(displacement)), 1e-6)
    unit = displacement / length
    off = at - centre
    ahead = off @ unit
    beside = off[..., 1] * unit[0] - off[..., 0] * unit[1]
    total = np.zeros(ahead.shape)
    for soft in BLUR_OFFSETS:
        chord = np.sqrt(np.maximum((radius + soft * blur) ** 2 - beside**2, 0))
        low = np.maximum(ahead - chord, -length / 2)
        high = np.minimum(ahead + chord, length / 2)
        total += np.clip(high - low, 0, None) / length
    return np.asarray(total / len(BLUR_OFFSETS))


def fit_motion_blur(
    rgb: ByteArray,
    start: FloatArray,
    radius: float,
    others: FloatArray,
    other_radii: FloatArray,
    basis: FloatArray,
    displacement: FloatArray | None = None,
) -> MotionBlurFit | None:
    """Fit the motion-blur model to the image about a rough position.

    Args:
        rgb: Image (H, W, 3).
        start: Rough position of the ball (2,) px.
        radius: Radius of the ball, px.
        others: Centres (n, 2) px of other balls, whose pixels are excluded.
        other_radii: Their radii (n,) px.
        basis: Basis (3, 3) of the cloth's colours.
        displacement: Rough displacement (2,) px; many are tried if None.

    Returns:
        The fit; None if too few pixels are visible or no displacement explains the image much better than rest.
    """
    rough = (
        _search_displacements(rgb, start, radius, others, other_radii, basis)
        if displacement is None
        else (start, displacement, start)
    )
    if rough is None:
        return None
    centre, displacement, rest = rough
    reach = np.abs(displacement) / 2 + (1 + MARGIN_RADII) * radius
    at = _pixel_grid(rgb, centre - reach, centre + reach, max(1.0, FINE_SPACING_RADII * radius))
    at = at[_is_near_streak(at, centre, displacement, (1 + MARGIN_RADII) * radius)]
    at = at[_is_unoccluded(at, others, other_radii)]
    if len(at) < MIN_PIXELS:
        return None
    colours = _sample_colours(rgb, at, basis)
    parameters = np.concatenate([centre, displacement])
    residuals = _colour_residuals(parameters, at, colours, radius)
    bare_cloth_square = max(float(((colours - np.median(colours, axis=0)) ** 2).sum()), 1e-9)
    if (residuals**2).sum() > MAX_ROUGH_RESIDUAL_SHARE * bare_cloth_square:
        return None
    parameters, residuals = _minimize_residuals(parameters, residuals, at, colours, radius)
    resting_residuals = _colour_residuals(np.append(rest, [1e-3, 0.0]), at, colours, radius)
    residual_share = float((residuals**2).sum()) / bare_cloth_square
    return MotionBlurFit(
        parameters[:2], parameters[2:], residual_share, float((resting_residuals**2).sum()) / bare_cloth_square
    )


def _minimize_residuals(
    parameters: FloatArray, residuals: FloatArray, at: FloatArray, colours: FloatArray, radius: float
) -> tuple[FloatArray, FloatArray]:
    """Refine centre and displacement (4,); return them with their residuals (n, 3), weighted anew after every step."""

    def linearize(now: _WeightedResiduals) -> NormalEquations:
        jacobian = _residual_jacobian(now.parameters, at, colours, radius, now.residuals)
        return NormalEquations(
            np.einsum("n,nci,ncj->ij", now.weights, jacobian, jacobian),
            np.einsum("n,nci,nc->i", now.weights, jacobian, now.residuals),
        )

    def move(now: _WeightedResiduals, step: FloatArray) -> tuple[_WeightedResiduals, float]:
        trial = now.parameters + np.clip(step, -radius, radius)
        moved = replace(now, parameters=trial, residuals=_colour_residuals(trial, at, colours, radius))
        return moved, moved.cost

    def weigh(now: _WeightedResiduals, *_: float) -> tuple[_WeightedResiduals, float]:
        threshold = HUBER_THRESHOLD * float(np.sqrt((np.linalg.norm(now.residuals, axis=1) ** 2).mean()))
        weighted = replace(now, weights=evaluate_huber_loss(now.residuals, threshold)[0])
        return weighted, weighted.cost

    first = weigh(_WeightedResiduals(parameters, residuals, np.ones(len(residuals))))
    best = minimize_cost(*first, linearize, solve_normal_equations, move, SEARCH, refresh=weigh).point
    return best.parameters, best.residuals


def _search_displacements(
    rgb: ByteArray, start: FloatArray, radius: float, others: FloatArray, other_radii: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """Search the best centre and displacement, and centre at rest; None if no displacement explains much more."""
    lattice, trials, shares, squares = _build_templates()
    at = start + radius * lattice
    inside = ((at >= 0) & (at <= np.array(rgb.shape[1::-1]) - 1)).all(axis=1)
    is_free = inside & _is_unoccluded(at, others, other_radii)
    if is_free.sum() < MIN_PIXELS:
        return None
    colours = _sample_colours(rgb, at, basis)
    contrast = np.where(is_free[:, None], colours - np.median(colours[is_free], axis=0), 0.0).astype(np.float32)
    covered = squares @ is_free.astype(np.float32)
    explained = ((shares @ contrast) ** 2).sum(axis=1) / np.maximum(covered, 1.0)
    resting = np.linalg.norm(trials[:, 2:], axis=1) < 1e-3
    best, rest = int(np.argmax(explained)), int(np.argmax(np.where(resting, explained, 0.0)))
    if explained[best] < MIN_GAIN * explained[rest]:
        return None
    return start + radius * trials[best, :2], radius * trials[best, 2:], start + radius * trials[rest, :2]


@lru_cache(maxsize=1)
def _build_templates() -> tuple[FloatArray, FloatArray, Float32Array, Float32Array]:
    """Build samples (n, 2) and trials (m, 4), ball radii, and exposure shares (m, n), plain and squared."""
    side = np.arange(-REACH_RADII, REACH_RADII + 1e-9, COARSE_SPACING_RADII)
    lattice = np.stack(np.meshgrid(side, side), axis=-1).reshape(-1, 2)
    lattice = lattice[np.linalg.norm(lattice, axis=1) <= REACH_RADII]
    angles = np.arange(TRIAL_DIRECTIONS) * np.pi / TRIAL_DIRECTIONS
    rows = [
        _build_trial(np.array([np.cos(angle), np.sin(angle)]), length, along, beside)
        for angle, length, along, beside in product(angles, TRIAL_LENGTHS_RADII, TRIAL_ALONG_SHARES, TRIAL_ACROSS_RADII)
    ]
    trials = np.array(rows)
    shares = np.array([exposure_share(lattice, row[:2], row[2:], 1.0, 0.1) for row in trials], dtype=np.float32)
    return lattice, trials, shares, shares**2


def _build_trial(unit: FloatArray, length: float, along: float, beside: float) -> FloatArray:
    """Build centre and displacement (4,), ball radii, of a trial streak in a direction (2,)."""
    side = np.array([-unit[1], unit[0]])
    return np.concatenate([along * max(length, 1.0) * unit + beside * side, max(length, 1e-4) * unit])


def _colour_residuals(parameters: FloatArray, at: FloatArray, colours: FloatArray, radius: float) -> FloatArray:
    """Residuals (n, 3) of the image with the best colours of cloth and ball."""
    share = exposure_share(at, parameters[:2], parameters[2:], radius)
    unit = parameters[2:] / max(float(np.linalg.norm(parameters[2:])), 1e-9)
    off = at - parameters[:2]
    beside = (off[:, 1] * unit[0] - off[:, 0] * unit[1]) / radius
    # Cloth, ball, and a ball that is lighter on one side.
    design = np.column_stack([np.ones(len(at)), share, share * beside])
    answer = np.linalg.solve(design.T @ design + 1e-6 * np.eye(3), design.T @ colours)
    return np.asarray(colours - design @ answer)


def _residual_jacobian(
    parameters: FloatArray, at: FloatArray, colours: FloatArray, radius: float, residuals: FloatArray
) -> FloatArray:
    """Derivatives (n, 3, 4) of the residuals by centre and displacement, by finite differences."""
    step = 0.25
    return np.stack(
        [(_colour_residuals(parameters + step * e, at, colours, radius) - residuals) / step for e in np.eye(4)], axis=2
    )


def _pixel_grid(rgb: ByteArray, low: FloatArray, high: FloatArray, step: float) -> FloatArray:
    """Samples (n, 2) px of the image between two corners."""
    limit = np.array(rgb.shape[1::-1]) - 1.0
    low, high = np.clip(low, 0, limit), np.clip(high, 0, limit)
    x, y = np.meshgrid(np.arange(low[0], high[0] + 1e-9, step), np.arange(low[1], high[1] + 1e-9, step))
    return np.column_stack([x.ravel(), y.ravel()])


def _is_near_streak(at: FloatArray, centre: FloatArray, displacement: FloatArray, reach: float) -> BoolArray:
    """Which px (n, 2) are within a reach of a streak."""
    share = np.clip((at - centre) @ displacement / max(float(displacement @ displacement), 1e-9), -0.5, 0.5)
    return np.asarray(np.linalg.norm(at - centre - share[:, None] * displacement, axis=1) <= reach)


def _is_unoccluded(at: FloatArray, others: FloatArray, radii: FloatArray) -> BoolArray:
    """Which px (n, 2) are not covered by other balls."""
    if not len(others):
        return np.ones(len(at), dtype=bool)
    apart = np.linalg.norm(at[:, None] - others[None], axis=-1)
    return np.asarray((apart > OCCLUDER_RADII * radii).all(axis=1))


def _sample_colours(rgb: ByteArray, at: FloatArray, basis: FloatArray) -> FloatArray:
    """Sample the colours (n, 3) at px (n, 2), in the cloth's basis with brightness weighted down."""
    place = at[None].astype(np.float32)
    samples = cv2.remap(rgb, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(
        cv2.transform(samples.astype(np.float32), build_shadow_weighted_basis(basis))[0], dtype=np.float64
    )
