"""Fusion of the ball network's positions with circles fitted to the outlines of the balls.

A ball behind another shows only part of its outline. Which of two balls is nearer follows from the camera, so the
hidden one is fitted once more without the rays that end on the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from detectors.measurement.circle_fit import MAX_RAY_RADII, Circles, fit_circles
from detectors.measurement.frame_detections import FrameDetections
from detectors.network.offset_regressor import OffsetRegressor, measure_discs
from detectors.network.peak_decoding import CandidateDetections
from models.core.array_columns import replace_rows
from models.core.scene import Scene
from models.core.typing import BoolArray, ByteArray, FloatArray, IntArray

# Share of a circle's rays that end at an edge, for its centre to count; for the ball to be at rest without a
# measurement by a regressor, and to hide others; and for the outline to be complete, which outweighs the network.
MIN_SUPPORT, CLEAR_SUPPORT, WHOLE_SUPPORT = 0.6, 0.8, 0.9
# Standard deviations by which a circle may differ from the network's centre; beyond, it is another object's outline.
MAX_OFFSET_SIGMAS = 4.0
# The same for a complete outline, ball radii: the network's errors occasionally exceed its sigmas.
MAX_OFFSET_RADII = 0.6
# Factor by which the sigma of a circle is divided against the network's: it covers errors that persist from frame to
# frame. Measured on rendered tables, where centres are then best.
CIRCLE_WEIGHT = 2.0
# Growth of a circle's sigma with the share of the outline that has no edge: this many times that share, up to this
# factor. A stripe, a shadow or a neighbour shifts such circles; measured on rendered tables, where they were off by two
# to three sigmas.
GAP_SIGMA_GROWTH, MAX_GAP_SIGMA_FACTOR = 7.0, 2.5
# Sigma of a centre from which the ball is measured by the regressor.
DOUBTFUL_SIGMA_PX = 0.25
# Factor of the regressor's sigmas, which were learnt from rendered images. On the annotated stills and the boxes of
# broadcasts its errors are 1.6 to 2.3 of its sigmas, the errors of the annotations included.
REAL_FOOTAGE_SIGMA_FACTOR = 2.0
# Sigma of the regressor over the sigma before, beyond which there is no ball for it. Below, its result replaces the
# ball network's even where its sigma is the larger one: its sigmas are the calibrated ones. On four rendered sets
# (1,237 balls) the error of centres is 0.25 px so, 0.27 px with the mean of both, 0.28 px with the one of the smaller
# sigma, and 0.41 px without the regressor.
MAX_SIGMA_RATIO = 3.0
# As CIRCLE_WEIGHT, against the regressor.
REGRESSOR_CIRCLE_WEIGHT = 1.0
# A circle nearer than this, ball radii, to the regressor's centre would be found again from there.
SAME_OUTLINE_RADII = 0.05
# Circles nearer than this, radii, belong to the same ball.
SAME_BALL_RADII = 0.3


@dataclass(frozen=True, slots=True)
class Surroundings:
    """Table and cloth at K balls, for locating their outlines."""

    expected: FloatArray
    """(K,) px, radius of a ball of this table there."""
    cloth_colour: FloatArray
    """(K, 3) RGB of the empty table there."""
    basis: FloatArray
    """(3, 3) of the cloth's colours."""
    scene: Scene

    def take(self, rows: IntArray) -> Surroundings:
        """Select rows."""
        return replace(self, expected=self.expected[rows], cloth_colour=self.cloth_colour[rows])


def locate_outlines(
    rgb: ByteArray, smooth: ByteArray, candidates: CandidateDetections, surroundings: Surroundings, frame: int
) -> tuple[FrameDetections, Circles]:
    """Locate sharp balls by their outlines and the network's positions.

    Args:
        rgb: Image (H, W, 3).
        smooth: The same from `smooth_image`.
        candidates: K candidates, px of the frame.
        surroundings: Their surroundings.
        frame: Number of the frame.

    Returns:
        The K balls, px of the frame, and their outlines; of support 0 where no outline fits.
    """
    expected, cloth_colour, basis = surroundings.expected, surroundings.cloth_colour, surroundings.basis
    circles = fit_circles(rgb, smooth, candidates.centre, expected, cloth_colour, basis)
    circles = _refit_occluded(rgb, smooth, candidates.centre, circles, surroundings, frame)
    network_sigma = np.hypot(candidates.sigma_across, candidates.sigma_along) / np.sqrt(2)
    centre, sigma, is_good = _fuse_centres(candidates.centre, network_sigma, circles, expected, CIRCLE_WEIGHT)
    radius = np.where(is_good, circles.radius, candidates.radius)
    detections = FrameDetections(centre, radius, np.zeros_like(centre), candidates.score, sigma, sigma)
    return detections, replace(circles, support=np.where(is_good, circles.support, 0.0))


def refine_doubtful_discs(
    rgb: ByteArray,
    smooth: ByteArray,
    detections: FrameDetections,
    outlines: Circles,
    surroundings: Surroundings,
    regressor: OffsetRegressor,
    frame: int,
) -> FrameDetections:
    """Measure balls whose outlines leave doubt with the regressor, and fit their outlines again from there.

    The decision which candidates are balls was made by the first outlines; only the positions change.

    Args:
        rgb: Image (H, W, 3).
        smooth: The same from `smooth_image`.
        detections: K balls at rest, px of the frame.
        outlines: Their outlines.
        surroundings: Their surroundings.
        regressor: Regressor of kind `DISC`.
        frame: Number of the frame.

    Returns:
        The K balls.
    """
    rows = np.flatnonzero(detections.sigma > DOUBTFUL_SIGMA_PX)
    centre, sigma = measure_discs(regressor, rgb, detections.centre[rows], surroundings.expected[rows])
    sigma = REAL_FOOTAGE_SIGMA_FACTOR * sigma
    is_consistent = sigma < MAX_SIGMA_RATIO * detections.sigma[rows]
    if not is_consistent.any():
        return detections
    rows = rows[is_consistent]
    regressed = replace(detections.take(rows), centre=centre[is_consistent], sigma=sigma[is_consistent])
    expected, circles = surroundings.expected[rows], outlines.take(rows)
    is_same_outline = np.linalg.norm(circles.centre - regressed.centre, axis=1) < SAME_OUTLINE_RADII * expected
    again = np.flatnonzero(~is_same_outline | (circles.support < MIN_SUPPORT))
    if len(again):
        others = replace_rows(detections, rows, regressed)
        occluding_circles = Circles(others.centre, others.radius, others.sigma, outlines.support)
        near = surroundings.take(rows[again])
        occluders = _find_occluders(occluding_circles, surroundings.scene, frame)[rows[again]]
        refitted = fit_circles(
            rgb, smooth, regressed.centre[again], near.expected, near.cloth_colour, near.basis, occluders
        )
        circles = replace_rows(circles, again, refitted)
    centre, sigma, _ = _fuse_centres(regressed.centre, regressed.sigma, circles, expected, REGRESSOR_CIRCLE_WEIGHT)
    return replace_rows(detections, rows, replace(regressed, centre=centre, sigma=sigma, sigma_along=sigma))


def _fuse_centres(
    network_centre: FloatArray, network_sigma: FloatArray, circles: Circles, expected: FloatArray, circle_weight: float
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Fuse centres (K, 2) of sigmas (K,) with circles; the means, their sigmas, and which circles were used.

    The sigmas of the circles are divided by `circle_weight` for the weights of the mean.
    """
    gap_factor = np.minimum(1 + GAP_SIGMA_GROWTH * (1 - np.minimum(circles.support, 1.0)), MAX_GAP_SIGMA_FACTOR)
    circle_sigma = circles.sigma * gap_factor
    distance = np.linalg.norm(circles.centre - network_centre, axis=1)
    agrees = distance < MAX_OFFSET_SIGMAS * np.hypot(network_sigma, circle_sigma)
    agrees |= (circles.support > WHOLE_SUPPORT) & (distance < MAX_OFFSET_RADII * expected)
    is_good = agrees & (circles.support > MIN_SUPPORT)
    weighting_sigma = circle_sigma / circle_weight
    share = np.where(is_good, network_sigma**2 / (network_sigma**2 + weighting_sigma**2), 0.0)
    centre = network_centre + share[:, None] * (circles.centre - network_centre)
    return centre, np.hypot(share * circle_sigma, (1 - share) * network_sigma), is_good


def _refit_occluded(
    rgb: ByteArray, smooth: ByteArray, start: FloatArray, circles: Circles, surroundings: Surroundings, frame: int
) -> Circles:
    """Fit the circles (K,) of occluded balls again, from starts (K, 2) px, to the visible part of their outlines."""
    occluders = _find_occluders(circles, surroundings.scene, frame)
    rows = np.flatnonzero(~np.isnan(occluders[..., 2]).all(axis=1))
    if not len(rows):
        return circles
    near = surroundings.take(rows)
    refitted = fit_circles(rgb, smooth, start[rows], near.expected, near.cloth_colour, near.basis, occluders[rows])
    return replace_rows(circles, rows, refitted)


def _find_occluders(circles: Circles, scene: Scene, frame: int) -> FloatArray:
    """Find the circles in front of each that may hide part of it: centre and radius (K, M, 3) px, NaN for none."""
    distance = np.linalg.norm(circles.centre[:, None] - circles.centre[None], axis=-1)
    is_near = distance < MAX_RAY_RADII * circles.radius[:, None] + circles.radius
    hides = is_near & (distance > SAME_BALL_RADII * circles.radius) & (circles.support > CLEAR_SUPPORT)
    if hides.any():
        height = scene.table.ball_radius
        xy = scene.camera.to_table(circles.centre, height, frame)
        from_eye = np.linalg.norm(np.column_stack([xy, np.full(len(xy), height)]) - scene.camera.position, axis=1)
        hides &= from_eye < from_eye[:, None]
    occluders = np.full((len(hides), max(1, int(hides.sum(axis=1).max(initial=0))), 3), np.nan)
    discs = np.column_stack([circles.centre, circles.radius])
    for row, hiding in zip(occluders, hides, strict=True):
        row[: hiding.sum()] = discs[hiding]
    return occluders
