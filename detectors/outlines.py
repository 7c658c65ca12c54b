"""Where balls that a network saw are: circles through their edges, weighed with the network's own word.

A ball that stands behind another shows only part of its outline. Which of two is nearer follows from the camera, so
the hidden one is measured once more without the rays that end on the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.centres import Centres
from detectors.found import Found
from detectors.refine import FARTHEST, Circles, fit_circles
from models.scene import Scene

Floats = NDArray[np.float64]
Bytes = NDArray[np.uint8]
Bools = NDArray[np.bool_]

LEAST_SUPPORT, CLEAR_SUPPORT, WHOLE_SUPPORT = 0.6, 0.8, 0.9
"""Share of a circle's rays that must end at an edge for its centre to count; for the ball to be at rest without a
closer look, and to hide others; and for the outline to be whole, which is word enough against the network's."""
MOST_APART = 4.0
"""Standard deviations by which a circle may miss the network's centre, beyond which it is another thing's outline."""
MOST_APART_RADII = 0.6
"""The same for a whole outline, ball radii: the network errs by more than it says, now and then."""
CIRCLE_WORTH = 2.0
"""How many times sharper than its sigma says a circle counts against the network: its sigma stands for errors that
last from picture to picture. Measured on drawn tables, where centres are then best."""
BROKEN_WORTH, MOST_BROKEN = 7.0, 2.5
"""How much less sharply than its sigma says a circle places a ball of which a share of the outline has no edge: so many
times that share, and so many times at the most. A stripe, a shadow or a neighbour draws such circles aside; measured on
drawn tables, where they missed by two to three sigmas."""
SAME_RADII = 0.3
"""Circles nearer than this are the same ball's."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the outlines of K balls are sought against."""

    expected: Floats
    """(K,) px, radius of a ball of this table there."""
    beneath: Floats
    """(K, 3) RGB of the empty table there."""
    basis: Floats
    """(3, 3) of the cloth's colours."""
    scene: Scene


def outlined(rgb: Bytes, soft: Bytes, seen: Centres, around: Surroundings, frame: int) -> tuple[Found, Floats]:
    """Sharp balls in a picture (H, W, 3) and `softened`, px; support (K,) of their outlines, 0 where there are none."""
    circles = _circles(rgb, soft, seen.centre, around, frame)
    broken = np.minimum(1 + BROKEN_WORTH * (1 - np.minimum(circles.support, 1.0)), MOST_BROKEN)
    circles = replace(circles, sigma=circles.sigma * broken)
    own = np.hypot(seen.across, seen.along) / np.sqrt(2)
    apart = np.linalg.norm(circles.centre - seen.centre, axis=1)
    agree = apart < MOST_APART * np.hypot(own, circles.sigma)
    agree |= (circles.support > WHOLE_SUPPORT) & (apart < MOST_APART_RADII * around.expected)
    good = agree & (circles.support > LEAST_SUPPORT)
    counted = circles.sigma / CIRCLE_WORTH
    share = np.where(good, own**2 / (own**2 + counted**2), 0.0)
    centre = seen.centre + share[:, None] * (circles.centre - seen.centre)
    radius = np.where(good, circles.radius, seen.radius)
    sigma = np.hypot(share * circles.sigma, (1 - share) * own)
    return Found(centre, radius, np.zeros_like(centre), seen.score, sigma, sigma), np.where(good, circles.support, 0.0)


def _circles(rgb: Bytes, soft: Bytes, guessed: Floats, around: Surroundings, frame: int) -> Circles:
    """Circles (K,) near guesses (K, 2) px, those of hidden balls through the open part of their outlines."""
    circles = fit_circles(rgb, soft, guessed, around.expected, around.beneath, around.basis)
    before = _before(circles, around.scene, frame)
    behind = ~np.isnan(before[..., 2]).all(axis=1)
    if not behind.any():
        return circles
    expected, beneath = around.expected[behind], around.beneath[behind]
    again = fit_circles(rgb, soft, guessed[behind], expected, beneath, around.basis, before[behind])
    columns = {name: getattr(circles, name).copy() for name in Circles.__slots__}
    for name, column in columns.items():
        column[behind] = getattr(again, name)
    return Circles(**columns)


def _before(circles: Circles, scene: Scene, frame: int) -> Floats:
    """Centre and radius (K, M, 3) px, NaN for none, of those circles that stand before each and may hide part of it."""
    height = scene.table.ball_radius
    xy = scene.camera.to_table(circles.centre, height, frame)
    away = np.linalg.norm(np.column_stack([xy, np.full(len(xy), height)]) - scene.camera.eye, axis=1)
    apart = np.linalg.norm(circles.centre[:, None] - circles.centre[None], axis=-1)
    touch = apart < FARTHEST * circles.radius[:, None] + circles.radius
    other = apart > SAME_RADII * circles.radius
    hides = touch & other & (away < away[:, None]) & (circles.support > CLEAR_SUPPORT)
    before = np.full((len(xy), max(1, int(hides.sum(axis=1).max(initial=0))), 3), np.nan)
    discs = np.column_stack([circles.centre, circles.radius])
    for row, hiding in zip(before, hides, strict=True):
        row[: hiding.sum()] = discs[hiding]
    return before
