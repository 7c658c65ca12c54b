"""Pictures at any time: the real ones with their moving balls set where the motion puts them."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from models.core.trajectory import State
from models.core.typing import FloatArray, ImageArray
from video.flow.moving_regions import Region, coarse, open_regions
from video.flow.optical_flow import Interpolator, OpticalFlow
from video.io.chroma import has_squares, square_colours
from video.io.clip import Clip
from video.io.pixel_kernels import fill_mixed
from video.matting.background_plate import Plate
from video.matting.ball_matting import STREAKED_RADII, Outline, Peeled, Sprite, peel, taps_along
from video.matting.ball_timeline import Sightings
from video.matting.compositing import Layer, Turned, paste
from video.matting.frame_store import Gallery
from video.matting.hidden_background import plate_of
from video.matting.sharp_balls import SharpBalls, learn_sharp, sharp_pair, sharpest_rows
from video.matting.shutter_time import fastest, with_exposure
from video.matting.visible_balls import shown_balls
from video.synthesis.ball_rotation import Spin, halves_apart, spin_between, spins_of
from video.synthesis.marking_rotation import Bends, bends_between

OPTICAL_FLOW, NO_SHARP = OpticalFlow(), SharpBalls({})
MOST_TURNED_RADII = 1.5
"""Radii that a ball may go during an exposure for what is on it to be followed round."""
FLOW_WORTH = 1.5
"""How many times less alike than optical flow, which fits them to each other, the spin may leave two sightings."""
ALIKE_RADII = 0.4
"""Radii by which the ends of two streaks may differ and look alike."""
DISSOLVE = (0.3, 0.7)
"""Share of the time between two pictures in which what is no ball passes from one to the other: short, so that hands
and cues are seen double only briefly."""


@dataclass(frozen=True, slots=True)
class Scenery:
    """What is learnt from a whole clip before pictures are made."""

    sightings: Sightings
    plate: Plate
    sharp: SharpBalls


def scenery_of(sightings: Sightings, clip: Clip) -> Scenery:
    """Learn the table without balls, the balls without streaks, and how long the shutter was open."""
    sharpest = sharpest_rows(sightings)
    streaked = fastest(sightings, {ball for balls in sharpest.values() for ball in balls})
    gallery = Gallery(sightings, clip, frozenset([*sharpest, *(row for _, row, _ in streaked)]))
    plate = plate_of(sightings, gallery)
    sharp = learn_sharp(sightings, gallery, plate)
    return Scenery(with_exposure(sightings, gallery, plate, sharp), plate, sharp)


@dataclass(frozen=True, slots=True)
class Seen:
    """One moving ball in the two pictures."""

    ball: int
    radius: float
    """px"""
    sides: tuple[Sprite | None, Sprite | None]
    """None where it is not in that picture."""
    sharp: tuple[Sprite | None, Sprite | None] | None
    """The ball without its streak, in the light of either side; None where neither is streaked."""
    turn: Spin | Bends | None
    """How what is on the ball goes round."""
    covered: bool = False
    """It is missing from one picture because another ball hides it there: it does not fade."""

    def layers(self, centre: FloatArray, way: FloatArray, share: float, gone: float) -> list[Layer]:
        """What to lay for the ball at `centre` (2,) px that goes `way` (P, 2) px around it.

        At a share of the time, 0 to 1, it has `gone` for another of that in which it moves: as long as it rests it
        looks as it did.
        """
        if not np.isfinite(centre).all():
            return []
        turns = (None, None) if self.turn is None else self.turn.looked_up(share)
        share = float(self.sides[0] is None) if self.covered else gone
        if self.sharp is None:
            return self._mixed(self.sides, centre[None], (1 - share, share), turns)
        way = way if np.isfinite(way).all() else np.zeros((1, 2))
        alike = [sprite if sprite is not None and self._like(sprite.way, way) else None for sprite in self.sides]
        if alike == [None, None]:
            return self._mixed(self.sharp, centre + taps_along(way), (1 - share, share), (None, None))
        # a sighting that is streaked alike is truer than any streak made anew
        weights = (1 - share, share)
        shown = sum(weight for side, weight in zip(self.sides, weights, strict=True) if side is not None)
        told = sum(weight for sprite, weight in zip(alike, weights, strict=True) if sprite is not None)
        # Where the one that is alike counts for nothing at this time, still it is the one to show.
        weights = (weights[0] * shown / told, weights[1] * shown / told) if told > 0 else (shown, shown)
        return self._mixed((alike[0], alike[1]), centre[None], weights, turns)

    def _like(self, way: FloatArray, wanted: FloatArray) -> bool:
        """Whether two streaks look the same."""
        one, other = way[-1] - way[0], wanted[-1] - wanted[0]
        return float(min(np.hypot(*(one - other)), np.hypot(*(one + other)))) < ALIKE_RADII * self.radius

    @staticmethod
    def _mixed(
        sides: tuple[Sprite | None, Sprite | None],
        places: FloatArray,
        weights: tuple[float, float],
        turns: tuple[Turned | None, Turned | None],
    ) -> list[Layer]:
        parts = zip(sides, weights, turns, strict=True)
        return [Layer(sprite, places, weight, turn) for sprite, weight, turn in parts if sprite is not None]


@dataclass(frozen=True, slots=True)
class Interval:
    """Two neighbouring real pictures, taken apart."""

    sightings: Sightings
    row: int
    first: ImageArray
    second: ImageArray
    sides: tuple[Peeled, Peeled]
    """The same, their moving balls taken out."""
    balls: tuple[Seen, ...]
    still: tuple[Outline, ...]
    """Balls that rest near moving ones."""
    regions: tuple[Region, ...] = ()
    """Where something other than balls moves, in pixels of the first picture."""
    small: tuple[ImageArray, ImageArray] | None = None
    """Both sides made `coarse`; None where the camera moves between them."""
    squared: bool = False
    """Whether the pictures have one colour for every two by two pixels, and what is made of them shall have it too."""

    def at(self, t: float, centres: FloatArray, ways: FloatArray | None = None) -> ImageArray:
        """The picture (H, W, 3) at time t with balls at `centres` (N, 2) px; a real one where it falls on one.

        `ways` (P, N, 2) px, relative to the centres, is where the balls go while the shutter is open.
        """
        share = self.sightings.place(t)[1] if t < self.sightings.t[self.row + 1] else 1.0
        if share in (0.0, 1.0):
            return (self.first if share == 0 else self.second).copy()
        picture = self._behind(t, share)
        moved = self.sightings.carry(float(self.sightings.t[self.row]), t) if self.regions else None
        for region in self.regions:
            region.lay(picture, share, moved)
        ways = np.zeros((1, *centres.shape)) if ways is None else ways
        gone = self.sightings.gone_at(t)
        layers = [seen.layers(centres[seen.ball], ways[:, seen.ball], share, gone[seen.ball]) for seen in self.balls]
        changed = paste(picture, layers, self.still)
        if self.squared:
            for box in (*changed, *(region.box for region in self.regions if moved is None)):
                square_colours(picture, box)
        return picture

    def _behind(self, t: float, share: float) -> ImageArray:
        """The two pictures without moving balls, one passing into the other."""
        x = float(np.clip((share - DISSOLVE[0]) / (DISSOLVE[1] - DISSOLVE[0]), 0, 1))
        weight = x * x * (3 - 2 * x)
        if weight in (0.0, 1.0):
            shown, behind = self._carried(0 if weight == 0 else 1, t)
            return behind.copy() if shown else behind
        first, second = self._carried(0, t)[1], self._carried(1, t)[1]
        mixed = np.empty(first.shape, dtype=np.uint8)
        fill_mixed(first.reshape(-1), second.reshape(-1), weight, mixed.reshape(-1))
        return mixed

    def _carried(self, side: int, t: float) -> tuple[bool, ImageArray]:
        """One side without moving balls, as a drifting camera sees it at another time; whether it is the side's own."""
        picture = self.sides[side].behind
        step = self.sightings.carry(float(self.sightings.t[self.row + side]), t)
        return (True, picture) if step is None else (False, _warped(picture, step))


def _warped(picture: ImageArray, step: FloatArray) -> ImageArray:
    """A picture (H, W, 3) as a camera sees it that has moved by a homography (3, 3)."""
    size = (picture.shape[1], picture.shape[0])
    return np.asarray(cv2.warpPerspective(picture, step, size, borderMode=cv2.BORDER_REPLICATE), dtype=np.uint8)


def open_interval(
    sightings: Sightings,
    plate: Plate,
    row: int,
    first: ImageArray,
    second: ImageArray,
    interpolator: Interpolator = OPTICAL_FLOW,
    sharp: SharpBalls = NO_SHARP,
    *,
    anew: bool = False,
    before: Interval | None = None,
) -> Interval:
    """Take the pictures of `row` and `row + 1` apart, to make any picture between them.

    `anew` where streaks are to be made as no picture shows them. What was taken apart for the interval `before` serves
    again where the same balls moved in it.
    """
    balls = sightings.taken_out(row)
    again = before is not None and before.row == row - 1 and sightings.taken_out(row - 1) == balls
    known = before.sides[1] if before is not None and again else _part(sightings, plate, row, first, balls)
    sides = (known, _part(sightings, plate, row + 1, second, balls))
    state = spins_of(sightings, row)
    seen = [
        _seen(sightings, sharp, row, ball, pair, state, anew) for ball, pair in zip(balls, _pairs(sides), strict=True)
    ]
    step = sightings.carry(float(sightings.t[row + 1]), float(sightings.t[row]))
    later = sides[1].behind if step is None else _warped(sides[1].behind, step)
    small: tuple[ImageArray, ImageArray] | None = None
    if step is None:
        kept = before.small if before is not None and again else None
        small = (coarse(known.behind) if kept is None else kept[1], coarse(later))
    regions = open_regions(known.behind, later, interpolator, step is None, small)
    squared = (before is not None and before.squared) or has_squares(first)
    still = _still(sightings, row, balls)
    return Interval(sightings, row, first, second, sides, tuple(seen), still, regions, small, squared)


def _pairs(sides: tuple[Peeled, Peeled]) -> list[tuple[Sprite | None, Sprite | None]]:
    return list(zip(sides[0].sprites, sides[1].sprites, strict=True))


def _seen(
    sightings: Sightings,
    sharp: SharpBalls,
    row: int,
    ball: int,
    sides: tuple[Sprite | None, Sprite | None],
    state: State,
    anew: bool,
) -> Seen:
    """A ball on both pictures: sharp where it was streaked, and what turns on it."""
    radius = float(np.nanmean(sightings.radius[row : row + 2, ball]))
    longest = max((sprite.streak for sprite in sides if sprite is not None), default=0.0)
    first, second = sides
    spin: Spin | None = None
    if first is not None and second is not None and longest < MOST_TURNED_RADII * radius:
        spin = spin_between(sightings, row, ball, state, (first, second), radius)
    if anew or longest > STREAKED_RADII * radius:
        t = float(sightings.t[row])
        return Seen(ball, radius, sides, sharp_pair(sharp, ball, t, radius, sides), spin)
    turn = spin if first is None or second is None else _better(spin, first, second, radius)
    return Seen(ball, radius, sides, None, turn, _covered(sightings, row, ball, sides))


def _better(spin: Spin | None, first: Sprite, second: Sprite, radius: float) -> Spin | Bends | None:
    """How what is on a ball goes round: by its spin, unless optical flow makes the two sightings far more alike."""
    bends = bends_between(first, second, radius)
    if spin is None or bends is None:
        return bends if spin is None else spin
    apart, flowed = (halves_apart((first, second), radius, way.looked_up(0.5)) for way in (spin, bends))
    return spin if apart < FLOW_WORTH * flowed else bends


def _covered(sightings: Sightings, row: int, ball: int, sides: tuple[Sprite | None, Sprite | None]) -> bool:
    """Whether a ball is missing from one picture, and another one stands in front of it there."""
    if (sides[0] is None) == (sides[1] is None):
        return False
    side = row + int(sides[1] is None)
    away = sightings.centre[side] - sightings.centre[side, ball]
    near = np.hypot(away[:, 0], away[:, 1]) < 1.2 * sightings.radius[side]
    near[ball] = False
    return bool((near & (away[:, 1] > 0) & sightings.observed[side]).any())


def _still(sightings: Sightings, row: int, balls: tuple[int, ...]) -> tuple[Outline, ...]:
    """Outlines of the balls that rest in both pictures."""
    resting = [ball for ball in np.flatnonzero(sightings.observed[row]) if ball not in balls]
    return tuple(sightings.outline(row, int(ball)) for ball in resting)


def _part(sightings: Sightings, plate: Plate, row: int, picture: ImageArray, balls: tuple[int, ...]) -> Peeled:
    """Peel those of `balls` that the picture shows out of it."""
    shown = shown_balls(sightings, plate, row, picture)
    mine = [ball for ball in balls if shown[ball]]
    if not mine:
        return Peeled(picture, (None,) * len(balls))
    others = [sightings.outline(row, int(ball)) for ball in np.flatnonzero(shown) if ball not in mine]
    motion = sightings.motion(float(sightings.t[row]))
    peeled = peel(picture, [sightings.outline(row, ball) for ball in mine], others, plate, motion)
    found = dict(zip(mine, peeled.sprites, strict=True))
    return Peeled(peeled.behind, tuple(found.get(ball) for ball in balls))
