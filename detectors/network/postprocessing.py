"""What a network saw, judged by the whole picture: which of it are balls, where they are, and how they move.

The network says what is a ball, roughly where, and how sure it is of that; edges in the whole picture say it finer
where they are clear, and networks that are shown one ball or one streak each say it where they are not, or it moves.
All errors are known, so a centre is their weighted mean. What the network is not sure of is a ball if the picture alone
says so: by its outline, or by what an exposure adds up to.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from detectors.measurement.ball_colour import ball_coats
from detectors.measurement.circle_fit import Circles, softened
from detectors.measurement.cloth_background import Cloth
from detectors.measurement.columns import with_rows
from detectors.measurement.frame_detections import NO_BALLS, Found, inside
from detectors.measurement.frame_detections import chained as found_chained
from detectors.measurement.motion_blur import fitted_sweep
from detectors.measurement.overlap_resolution import stood_apart
from detectors.measurement.working_view import View, value_at
from detectors.network.disc_regressor import DiscModel
from detectors.network.outline_fusion import (
    CLEAR_SUPPORT,
    LEAST_SUPPORT,
    WHOLE_SUPPORT,
    Surroundings,
    measured_closer,
    outlined,
)
from detectors.network.peak_decoding import Centres
from detectors.network.streak_regressor import LEAST_WAY_RADII, MeasuredStreak, StreakModel
from models.core.detections import Detections
from models.core.scene import apply_homography
from models.core.typing import BoolArray, ByteArray, FloatArray

LEAST_SCORE = 0.5
"""Probability from which a ball is reported."""
SIZE_BAND = (0.76, 1.4)
"""Seen over predicted radius of what can be a ball of this table: spots are seen with .7."""
DOUBTFUL_SCORE, DOUBTFUL_BAND = 0.25, (0.5, 1.6)
"""The same for what is a ball only if its outline is whole: what the network half sees, or sees in the wrong size."""
LEAST_CLEAR_SIZE = 0.8
"""Radius of a clear outline, over a ball's, below which it is that of a spot: the marks of a table look like balls, but
of 1,750 balls, drawn and real, three in a thousand measure less than 0.86."""
FAINT_SCORE = 0.12
"""The same for what moves: a ball only if what an exposure adds up to explains the picture. The network cannot say well
where the middle of a streak is, so that many cells share what one would say of a ball at rest."""
STREAK_RADII = 1.0
"""Way during the exposure, ball radii, from which the network's word alone makes a streak of a ball."""
MOVED_RADII = 0.5
"""Way that is seen, where a ball that may be one is looked at as a streak, from which it is one: the outline of a ball
that moved less is nearly a circle, and places it better."""
MARK_STARTS = np.array([[np.cos(angle), np.sin(angle)] for angle in np.arange(6) * np.pi / 3])
"""Where the centre of a ball may be whose mark the network sees: so far off, in what the ball is larger."""
CLEAR_SCORE = 0.7
"""Probability from which the network is sure that something is there, be it of the wrong size."""


@dataclass(frozen=True, slots=True)
class Judged:
    """What the whole picture says of K things that a network saw."""

    balls: Detections
    unclear: FloatArray
    """(n, 2) working px where the network's word alone counts."""
    refuted: BoolArray
    """(K,) which of them are none by the picture: to look again is worth it only after something has changed there."""


@dataclass(frozen=True, slots=True)
class Judge:
    """Makes balls of what a network saw, px of the working picture."""

    view: View
    cloth: Cloth
    streaks: StreakModel
    discs: DiscModel

    def likely(self, seen: Centres) -> BoolArray:
        """What (K,) is a ball by the network's word, or may prove one."""
        known = self._within(seen, DOUBTFUL_SCORE, DOUBTFUL_BAND)
        return np.asarray(known | (streaked(seen) & self._within(seen, FAINT_SCORE, DOUBTFUL_BAND)))

    def sure(self, seen: Centres) -> BoolArray:
        """What (K,) is a ball by the network's word alone."""
        return self._within(seen, LEAST_SCORE, SIZE_BAND)

    def _within(self, seen: Centres, score: float, band: tuple[float, float]) -> BoolArray:
        ratio = seen.radius / value_at(self.view.radius, seen.centre)
        return np.asarray((seen.score > score) & (ratio > band[0]) & (ratio < band[1]))

    def there(self, home: FloatArray, frame: int) -> FloatArray:
        """Working px (n, 2) to px of a frame."""
        motion, reference = self.view.scene.camera.motion, self.view.to_picture(home)
        return reference if motion is None else apply_homography(motion[frame], reference)

    def measured(self, rgb: ByteArray, seen: Centres, frame: int) -> Judged:
        """Balls at rest and streaks among what was seen in the working picture of a picture (H, W, 3)."""
        told, moves = self._closer(rgb, seen, frame)
        sure = self.sure(seen)
        rows = np.flatnonzero(~moves | ~sure)
        resting, doubted = seen.take(rows), moves[rows]
        soft = softened(rgb)
        sharp, outlines = self._outlined(rgb, soft, resting, frame)
        sharp, outlines = self._around_marks(rgb, soft, resting, sharp, outlines, frame)
        believed = (self.sure(resting) & ~doubted) | (outlines.support > _needed(resting))
        believed &= ~self._spots(resting, sharp, outlines.support)
        refuted = np.zeros(len(seen), dtype=bool)
        refuted[rows[~believed & ~doubted]] = True
        resting, sharp, outlines = resting.take(believed), sharp.take(believed), outlines.take(believed)
        sharp = measured_closer(rgb, soft, sharp, outlines, self._around(resting), self.discs, frame)
        support = outlines.support
        by_light, swept_too = self._swept_by_light(rgb, resting, sharp, support, told.take(moves & sure))
        at_rest = sharp.take((support > CLEAR_SUPPORT) & ~swept_too)
        swept = found_chained(self._borne_out(rgb, told.take(moves), sure[moves], at_rest), by_light)
        within = inside(sharp.centre, swept) & (swept.score[:, None] >= sharp.score) & (sharp.score < CLEAR_SCORE)
        kept = ~swept_too & ((support > CLEAR_SUPPORT) | ~within.any(axis=0))
        found = stood_apart(found_chained(swept, sharp.take(kept)), self.view.scene, frame)
        coats = ball_coats(rgb, found.centre, found.radius)
        frames = np.full(len(found.score), frame, dtype=np.int64)
        unclear = np.concatenate([seen.centre[moves & sure], resting.centre[support <= LEAST_SUPPORT]])
        balls = Detections(
            frames, found.centre, found.radius, found.streak, coats.colour, coats.white, coats.white_rim, coats.value,
            found.score, found.sigma, found.sigma_along,
        )  # fmt: skip
        return Judged(balls, unclear, refuted)

    def _spots(self, home: Centres, sharp: Found, support: FloatArray) -> BoolArray:
        """Which (n,) have a clear outline that is too small for a ball: spots on the cloth."""
        return np.asarray((support > CLEAR_SUPPORT) & (sharp.radius < LEAST_CLEAR_SIZE * self._size(home)))

    def _swept_by_light(
        self, rgb: ByteArray, home: Centres, sharp: Found, support: FloatArray, told: Found
    ) -> tuple[Found, BoolArray]:
        """Streaks among balls without a whole outline, by what an exposure adds up to; which (n,) of them are some.

        None of them goes over a ball of which the network is sure: a row of balls adds up to a streak as well. None is
        one of those that the network told already: what stands before a streak is not the streak.
        """
        radius = self._size(home)
        moves, found = np.zeros(len(support), dtype=bool), NO_BALLS
        for row in np.flatnonzero(support < CLEAR_SUPPORT).tolist():
            clear = support > CLEAR_SUPPORT
            clear[row] = False
            others, size = sharp.take(clear), float(radius[row])
            sweep = fitted_sweep(rgb, sharp.centre[row], size, others.centre, others.radius, self.cloth.basis)
            if sweep is None or not sweep.believed(size):
                continue
            at = self.streaks.measured(rgb, sweep.centre, size, sweep.way)
            swept = _streak(at, size, float(sharp.score[row]))
            known = inside(swept.centre, told).any()
            if not known and not inside(sharp.centre[_other_balls(home, row)], swept).any():
                moves[row] = True
                found = found_chained(found, swept)
        return found, moves

    def _closer(self, rgb: ByteArray, home: Centres, frame: int) -> tuple[Found, BoolArray]:
        """What the network saw, px of the frame, what may be streaks measured closer; which (K,) of it are some."""
        radius = self._size(home)
        told, moves = _swept(self._placed(home, frame)), np.zeros(len(home), dtype=bool)
        way = np.linalg.norm(home.streak, axis=1) / home.radius
        for row in np.flatnonzero(way > np.where(self.sure(home), LEAST_WAY_RADII, STREAK_RADII)).tolist():
            at = self.streaks.measured(rgb, told.centre[row], float(radius[row]), told.streak[row])
            moves[row] = float(np.linalg.norm(at.way)) > MOVED_RADII * radius[row]
            told.centre[row], told.streak[row], told.radius[row] = at.centre, at.way, radius[row]
            told.sigma[row], told.sigma_along[row] = at.across, max(at.along, at.across)
        return told, moves

    def _borne_out(self, rgb: ByteArray, told: Found, sure: BoolArray, at_rest: Found) -> Found:
        """Those streaks of which the network is sure, and those to which an exposure adds up."""
        others = at_rest.take(~np.asarray(inside(at_rest.centre, told).any(axis=0)))
        borne = sure.copy()
        for row in np.flatnonzero(~sure).tolist():
            place, size, way = told.centre[row], float(told.radius[row]), told.streak[row]
            sweep = fitted_sweep(rgb, place, size, others.centre, others.radius, self.cloth.basis, way)
            borne[row] = sweep is not None and sweep.believed(size)
        return told.take(borne)

    def _outlined(self, rgb: ByteArray, soft: ByteArray, seen: Centres, frame: int) -> tuple[Found, Circles]:
        """Balls at rest where their outlines are, and these."""
        found, outlines = outlined(rgb, soft, self._placed(seen, frame), self._around(seen), frame)
        # What only its outline makes a ball is as likely one as the least that is reported.
        return replace(found, score=np.maximum(found.score, LEAST_SCORE)), outlines

    def _around(self, seen: Centres) -> Surroundings:
        """What the outlines of what was seen, working px, are sought against."""
        beneath = np.asarray(value_at(self.cloth.colour, seen.centre), dtype=np.float64)
        return Surroundings(self._size(seen), beneath, self.cloth.basis, self.view.scene)

    def _around_marks(
        self, rgb: ByteArray, soft: ByteArray, seen: Centres, sharp: Found, outlines: Circles, frame: int
    ) -> tuple[Found, Circles]:
        """The same with what is too small for a ball taken for a mark on one: the outline about it that is whole."""
        expected = value_at(self.view.radius, seen.centre).astype(np.float64)
        room = expected - seen.radius
        small = (seen.radius < SIZE_BAND[0] * expected) & (seen.score > CLEAR_SCORE)
        marks = np.flatnonzero(small & (outlines.support < _needed(seen)))
        if not len(marks):
            return sharp, outlines
        starts = seen.take(np.repeat(marks, len(MARK_STARTS)))
        away = np.repeat(room[marks], len(MARK_STARTS))
        wide = np.maximum(starts.across, away)
        at = starts.centre + away[:, None] * np.tile(MARK_STARTS, (len(marks), 1))
        tried, held = self._outlined(rgb, soft, replace(starts, centre=at, across=wide, along=wide), frame)
        best = held.support.reshape(len(marks), -1).argmax(axis=1) + np.arange(len(marks)) * len(MARK_STARTS)
        better = held.support[best] > outlines.support[marks]
        best, marks = best[better], marks[better]
        return with_rows(sharp, marks, tried.take(best)), with_rows(outlines, marks, held.take(best))

    def _size(self, home: Centres) -> FloatArray:
        """Radius (K,) that a ball of this table has where each was seen, px of a frame."""
        return np.asarray(value_at(self.view.radius, home.centre).astype(np.float64) / self.view.scale)

    def _placed(self, seen: Centres, frame: int) -> Centres:
        """What was seen in the working picture, in px of the frame."""
        return seen.placed(lambda px: self.there(px, frame), 1 / self.view.scale)


def _needed(seen: Centres) -> FloatArray:
    """Support (K,) of its outline that makes a ball of what the network is not sure of, or sees in the wrong size."""
    return np.where(seen.score > CLEAR_SCORE, CLEAR_SUPPORT, WHOLE_SUPPORT)


def streaked(seen: Centres) -> BoolArray:
    """Which balls (K,) the network sees move."""
    return np.asarray(np.linalg.norm(seen.streak, axis=1) > STREAK_RADII * seen.radius)


def _other_balls(seen: Centres, row: int) -> BoolArray:
    """Which balls (K,) besides one the network is sure of."""
    other = seen.score > CLEAR_SCORE
    other[row] = False
    return other


def _streak(at: MeasuredStreak, radius: float, score: float) -> Found:
    """One streak of a ball of a radius, px."""
    numbers = (np.array([number]) for number in (score, at.across, max(at.along, at.across)))
    return Found(at.centre[None], np.array([radius]), at.way[None], *numbers)


def _swept(seen: Centres) -> Found:
    """Streaks, as the network sees them."""
    columns = seen.centre, seen.radius, seen.streak, seen.score, seen.across, np.maximum(seen.along, seen.across)
    return Found(*(column.copy() for column in columns))
