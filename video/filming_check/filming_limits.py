"""Limits of good filming: up to where a measured value is good, and from where a clip should not be used."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

Level = Literal["good", "doubt", "bad", "unknown"]


@dataclass(frozen=True, slots=True)
class Limit:
    """The last good value, and the last one that is not bad; where `good` is the larger one, more is better."""

    good: float
    bad: float

    def grade(self, value: float) -> Level:
        """Grade a value; NaN is unknown."""
        if np.isnan(value):
            return "unknown"
        sign = 1.0 if self.bad > self.good else -1.0
        if sign * (value - self.good) <= 0:
            return "good"
        return "doubt" if sign * (value - self.bad) <= 0 else "bad"


@dataclass(frozen=True, slots=True)
class FilmingLimits:
    """Limits of all measurements, named as they are; the unit, the source and the reason stand below each."""

    exposure: Limit = Limit(38.0, 20.0)
    """Grey levels of 255, median over the table. Below 38 (2 % of the light that makes white, by the sRGB curve),
    noise of two levels changes the light by a tenth; below 20 dark balls cannot be told from their shadows."""
    clipping: Limit = Limit(4.0, 20.0)
    """% of the table's pixels with a colour at its maximum. Highlights and white balls cover 1 to 3 %; where a fifth
    of the table is white, balls have no outline there."""
    flicker: Limit = Limit(2.0, 10.0)
    """%, half the range of the brightness over the clip. The detectors take 10 to 15 grey levels for a ball: a tenth of
    a cloth of 100 levels; a fifth of that leaves them a margin."""
    glare: Limit = Limit(1.0, 8.0)
    """% of the cloth in bright spots larger than a ball. One ball covers 0.1 %; a lamp's reflection hides about ten."""
    motion_blur: Limit = Limit(8.0, 23.0)
    """ms of exposure. At the 5 m/s of a firm shot a ball moves 40 mm in 8 ms, so its streak overlaps its own disc; in
    23 ms it moves 115 mm: two diameters, the longest streak whose ends are measured well (how-to/film-a-shot.md)."""
    frame_rate: Limit = Limit(45.0, 14.0)
    """Distinct frames per second. A segment of a path should span three frames: at 3 m/s they span 20 cm at 45 fps; at
    14 fps the same length is reached at 1 m/s, so that only slow shots are resolved."""
    duplicates: Limit = Limit(2.0, 75.0)
    """% of the frames that show the one before again. They are recognised where something moves, not always, so none
    are better; above 75 % the container has four times the rate of the camera. The rate itself is `frame_rate`."""
    irregular_times: Limit = Limit(5.0, 50.0)
    """% of the steps between frames that differ by more than a quarter from the usual one: a variable frame rate."""
    corners: Limit = Limit(4.0, 3.0)
    """Corners of the playing surface inside the image. A fourth corner follows from three; two leave the scale open."""
    ball_size: Limit = Limit(12.0, 8.0)
    """px, diameter of a ball at the far end of the table. A circle of 12 px has some 38 px of outline, enough for a
    tenth of a pixel; the networks are trained on balls of 8 px and more (docs/explanation/detection.md)."""
    camera_drift: Limit = Limit(1.0, 100.0)
    """px that the table moves in the image. Below one pixel the camera counts as still. trueroll follows slow motion of
    the camera, and states less certain positions; 100 px are a twelfth of the width of 720p: rails leave the image."""
    compression: Limit = Limit(22.0, 70.0)
    """Grey levels, mean step of the quantiser (0.625 x 2^(QP / 6) for H.264). QP 31 (22 levels) is the default
    quality of phones and players; at QP 41 (70 levels) dark balls on dark cloth vanish."""
    focus: Limit = Limit(0.22, 0.45)
    """Ball radii, standard deviation of the blur of sharp edges. Edges are located to a tenth of their width; at half a
    radius the outlines of both sides of a ball overlap."""

    def find_limit(self, code: str) -> Limit:
        """Find the limit of a measurement."""
        limit: Limit = getattr(self, code)
        return limit


# Names of all measurements.
CODES = tuple(one.name for one in fields(FilmingLimits))
