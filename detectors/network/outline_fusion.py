"""Where balls that a network saw are: circles through their edges, weighed with the network's own word.

A ball that stands behind another shows only part of its outline. Which of two is nearer follows from the camera, so
the hidden one is measured once more without the rays that end on the other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from detectors.measurement.circle_fit import FARTHEST, Circles, fit_circles
from detectors.measurement.columns import with_rows
from detectors.measurement.frame_detections import Found
from detectors.network.disc_regressor import DiscModel
from detectors.network.peak_decoding import Centres
from models.core.scene import Scene
from models.core.typing import ByteArray, FloatArray, IntArray

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
DOUBTED_PX = 0.25
"""Error of a centre from which a ball is looked at closer, by itself."""
FILMED_FACTOR = 2.0
"""Error of what looks closer over what it says: it learnt it from drawn pictures. On the marked stills and the boxes of
broadcasts it misses by 1.6 to 2.3 times its sigmas, the marks' own errors included."""
MOST_UNSURE = 3.0
"""Its error over that of what is known, beyond which it sees no ball there. Below, its word counts in place of the ball
network's even where it is the less sure: its sigmas are the honest ones. On four drawn sets (1,237 balls) centres are
good to 0.25 px so, to 0.27 with the mean of both words, to 0.28 with the surer of the two, and to 0.41 without it."""
CLOSER_WORTH = 1.0
"""As CIRCLE_WORTH, against a network that looked closer."""
SAME_OUTLINE_RADII = 0.05
"""A circle nearer than this to where a closer look places its ball would be found again from there."""
SAME_RADII = 0.3
"""Circles nearer than this are the same ball's."""


@dataclass(frozen=True, slots=True)
class Surroundings:
    """What the outlines of K balls are sought against."""

    expected: FloatArray
    """(K,) px, radius of a ball of this table there."""
    beneath: FloatArray
    """(K, 3) RGB of the empty table there."""
    basis: FloatArray
    """(3, 3) of the cloth's colours."""
    scene: Scene

    def take(self, rows: IntArray) -> Surroundings:
        """Those of some of the balls."""
        return replace(self, expected=self.expected[rows], beneath=self.beneath[rows])


def outlined(rgb: ByteArray, soft: ByteArray, seen: Centres, around: Surroundings, frame: int) -> tuple[Found, Circles]:
    """Sharp balls in a picture (H, W, 3) and `softened`, px; their outlines, of support 0 where there are none."""
    circles = fit_circles(rgb, soft, seen.centre, around.expected, around.beneath, around.basis)
    circles = _behind_others(rgb, soft, seen.centre, circles, around, frame)
    return _weighed(seen, circles, around.expected, CIRCLE_WORTH)


def measured_closer(
    rgb: ByteArray,
    soft: ByteArray,
    found: Found,
    outlines: Circles,
    around: Surroundings,
    closer: DiscModel,
    frame: int,
) -> Found:
    """The same balls, those that their outlines leave in doubt looked at closer, and other outlines sought from there.

    What is a ball was said by its first outline; only where it is, is said better.
    """
    doubted = np.flatnonzero(found.sigma > DOUBTED_PX)
    centre, sigma = closer.measured(rgb, found.centre[doubted], around.expected[doubted])
    sigma = FILMED_FACTOR * sigma
    sees = sigma < MOST_UNSURE * found.sigma[doubted]
    if not sees.any():
        return found
    doubted, word = doubted[sees], replace(found.take(doubted[sees]), centre=centre[sees], sigma=sigma[sees])
    expected, circles = around.expected[doubted], outlines.take(doubted)
    there = np.linalg.norm(circles.centre - word.centre, axis=1) < SAME_OUTLINE_RADII * expected
    anew = np.flatnonzero(~there | (circles.support < LEAST_SUPPORT))
    if len(anew):
        others = with_rows(found, doubted, word)
        known = Circles(others.centre, others.radius, others.sigma, outlines.support)
        rows = doubted[anew]
        near, before = around.take(rows), _before(known, around.scene, frame)[rows]
        sought = fit_circles(rgb, soft, word.centre[anew], near.expected, near.beneath, near.basis, before)
        circles = with_rows(circles, anew, sought)
    centre, sigma, _ = _between(word.centre, word.sigma, circles, expected, CLOSER_WORTH)
    return with_rows(found, doubted, replace(word, centre=centre, sigma=sigma, sigma_along=sigma))


def _weighed(seen: Centres, circles: Circles, expected: FloatArray, worth: float) -> tuple[Found, Circles]:
    """Balls between what a network saw and their circles; these, of support 0 where they are another thing's."""
    own = np.hypot(seen.across, seen.along) / np.sqrt(2)
    centre, sigma, good = _between(seen.centre, own, circles, expected, worth)
    radius = np.where(good, circles.radius, seen.radius)
    found = Found(centre, radius, np.zeros_like(centre), seen.score, sigma, sigma)
    return found, replace(circles, support=np.where(good, circles.support, 0.0))


def _between(
    place: FloatArray, own: FloatArray, circles: Circles, expected: FloatArray, worth: float
) -> tuple[FloatArray, FloatArray, NDArray[np.bool_]]:
    """Centres (K, 2) between places with errors (K,) and circles, their errors, and which circles are good for one.

    Circles count `worth` times sharper than their sigmas say.
    """
    broken = np.minimum(1 + BROKEN_WORTH * (1 - np.minimum(circles.support, 1.0)), MOST_BROKEN)
    theirs = circles.sigma * broken
    apart = np.linalg.norm(circles.centre - place, axis=1)
    agree = apart < MOST_APART * np.hypot(own, theirs)
    agree |= (circles.support > WHOLE_SUPPORT) & (apart < MOST_APART_RADII * expected)
    good = agree & (circles.support > LEAST_SUPPORT)
    counted = theirs / worth
    share = np.where(good, own**2 / (own**2 + counted**2), 0.0)
    centre = place + share[:, None] * (circles.centre - place)
    return centre, np.hypot(share * theirs, (1 - share) * own), good


def _behind_others(
    rgb: ByteArray, soft: ByteArray, guessed: FloatArray, circles: Circles, around: Surroundings, frame: int
) -> Circles:
    """Circles (K,) near guesses (K, 2) px, those of hidden balls through the open part of their outlines."""
    before = _before(circles, around.scene, frame)
    behind = np.flatnonzero(~np.isnan(before[..., 2]).all(axis=1))
    if not len(behind):
        return circles
    near = around.take(behind)
    again = fit_circles(rgb, soft, guessed[behind], near.expected, near.beneath, near.basis, before[behind])
    return with_rows(circles, behind, again)


def _before(circles: Circles, scene: Scene, frame: int) -> FloatArray:
    """Centre and radius (K, M, 3) px, NaN for none, of those circles that stand before each and may hide part of it."""
    apart = np.linalg.norm(circles.centre[:, None] - circles.centre[None], axis=-1)
    touch = apart < FARTHEST * circles.radius[:, None] + circles.radius
    hides = touch & (apart > SAME_RADII * circles.radius) & (circles.support > CLEAR_SUPPORT)
    if hides.any():
        height = scene.table.ball_radius
        xy = scene.camera.to_table(circles.centre, height, frame)
        away = np.linalg.norm(np.column_stack([xy, np.full(len(xy), height)]) - scene.camera.eye, axis=1)
        hides &= away < away[:, None]
    before = np.full((len(hides), max(1, int(hides.sum(axis=1).max(initial=0))), 3), np.nan)
    discs = np.column_stack([circles.centre, circles.radius])
    for row, hiding in zip(before, hides, strict=True):
        row[: hiding.sum()] = discs[hiding]
    return before
