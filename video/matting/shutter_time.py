"""How long the shutter was open, by how far the balls are streaked in the pictures themselves."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import cv2
import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import Float32Array, FloatArray, ImageArray
from video.matting.background_plate import Plate
from video.matting.ball_matting import Outline, peel, taps_along
from video.matting.ball_timeline import Sightings
from video.matting.compositing import Layer, paste
from video.matting.deblur import lit_like
from video.matting.frame_store import Gallery
from video.matting.sharp_balls import FAST_RADII, SharpBalls, alone, shifts

SHARES = np.array([0, 0.02, 0.04, 0.06, 0.08, 0.1, 0.13, 0.17, 0.22, 0.3, 0.4, 0.5, 0.7, 0.9])
"""Of the time between two pictures for which the shutter may be open."""
MOST_STREAKS = 10
"""Sightings that are looked at, the fastest ones."""
LEAST_STREAKS = 2
LEAST_GAIN = 0.4
"""Share of the error of sharp balls that may be left for a streak to be believed: balls that turn, or stand in another
light, are a little more alike when blurred (0.5 to 0.8 on clips with a short exposure; 0.25 on one with a long one)."""
LONG_RADII, LONG_GAIN = 1.0, 0.75
"""Radii of streak from which less gain is enough, and that gain: a sharp ball smeared so far looks less like itself."""
SOFT_RADII = (0.05, 0.1, 0.2)
"""Radii by which coding may soften a moving ball all round, besides not at all: that is no streak."""
FINE = 181
"""Shares that are told apart."""
UNLIKE = 3.0
"""Times the usual least error from which a sighting shows something else: a hand, a wrong ball."""


def with_exposure(sightings: Sightings, gallery: Gallery, plate: Plate, balls: SharpBalls) -> Sightings:
    """Sightings with the exposure that makes the sharp balls look most like the fast ones; as they were, if unclear."""
    chosen = fastest(sightings, balls.sightings)
    step = float(np.median(np.diff(sightings.t))) if len(sightings.t) > 1 else 0.0
    measured = [
        (_errors(sightings, plate, balls, row, ball, picture, step), speed)
        for row, picture in gallery.at(row for _, row, _ in chosen)
        for speed, other, ball in chosen
        if other == row
    ]
    errors = [(*found, speed) for found, speed in measured if found is not None]
    share = believed_share(errors) if len(errors) >= LEAST_STREAKS else 0.0
    if share == 0:
        return sightings
    exposure = share * step
    return replace(sightings, exposure=exposure, way=sightings.ways(sightings.t, exposure))


def believed_share(errors: list[tuple[FloatArray, FloatArray, float]]) -> float:
    """The share of the time between two pictures for which the shutter was open; 0 where streaks do not tell.

    For every sighting the errors (S,) with each of `SHARES`, those of a ball that coding may have softened, and the
    radii that the ball goes between two pictures.
    """
    usual = np.median([crisp.min() for crisp, _, _ in errors])
    used = [one for one in errors if one[0].min() <= UNLIKE * usual]
    total = np.sum([crisp for crisp, _, _ in used], axis=0)
    streak = SHARES[int(np.argmin(total))] * float(np.median([speed for *_, speed in used]))
    if total.min() > (LONG_GAIN if streak > LONG_RADII else LEAST_GAIN) * total[0]:
        return 0.0
    return _shortest(np.array([soft for _, soft, _ in used]))


def fastest(sightings: Sightings, balls: Iterable[int]) -> list[tuple[float, int, int]]:
    """(radii from picture to picture, row, ball) of the fastest ones of these balls, seen alone."""
    speed = shifts(sightings) / sightings.radius
    found = [(float(speed[row, ball]), int(row), ball) for ball in balls for row in alone(sightings, ball)]
    return sorted((entry for entry in found if entry[0] > FAST_RADII), reverse=True)[:MOST_STREAKS]


def _errors(
    sightings: Sightings, plate: Plate, balls: SharpBalls, row: int, ball: int, picture: ImageArray, step: float
) -> tuple[FloatArray, FloatArray] | None:
    """Squared errors (S,) around a ball of the picture made with each of `SHARES`, and those when it may be softened as
    well; None where they cannot be told."""
    t, radius = float(sightings.t[row]), float(sightings.radius[row, ball])
    ways = sightings.ways(np.full(len(SHARES), t), SHARES * step)[:, :, ball]
    if not np.isfinite(ways[-1]).all():
        return None
    centre = sightings.centre[row, ball]
    wide = Outline(centre + ways[-1], centre, radius)
    peeled = peel(picture, [wide], [], plate, sightings.motion(t))
    seen = peel(picture, [Outline(centre[None], centre, radius)], [], plate, sightings.motion(t)).sprites[0]
    elsewhere = balls.of(ball, t, radius, ())
    if elsewhere is None or seen is None:
        return None
    sharp = lit_like(elsewhere, seen)
    x0, y0 = np.maximum(wide.way.min(axis=0) - 1.5 * radius, 0).astype(int)
    x1, y1 = (wide.way.max(axis=0) + 1.5 * radius + 1).astype(int)
    here = np.s_[y0:y1, x0:x1]
    empty, errors, made = peeled.behind[here].astype(np.float32), [], peeled.behind.copy()
    for way in ways:
        changed = paste(made, [[Layer(sharp, centre + taps_along(way), 1.0)]])
        errors.append(_misfits(made[here] - empty, picture[here] - empty, radius))
        for left, top, right, bottom in changed:
            made[top:bottom, left:right] = peeled.behind[top:bottom, left:right]
    crisp, soft = np.array(errors).T
    return crisp, soft


def _misfits(made: Float32Array, seen: Float32Array, radius: float) -> tuple[float, float]:
    """Mean squared error of what a ball adds to the empty table (h, w, 3), and the least where it may be softened."""
    ways = [made, *(cv2.GaussianBlur(made, (0, 0), share * radius) for share in SOFT_RADII)]
    errors = [float(((way - seen) ** 2).mean()) for way in ways]
    return errors[0], min(errors)


def _shortest(errors: FloatArray) -> float:
    """The least share that explains sightings (n, S) as well as the best one, but for one standard error.

    A streak that is too long shows a ball where it never was; one that is too short, only a crisper one (the rule is
    that of Breiman, Friedman, Olshen and Stone 1984).
    """
    fine = np.linspace(0, SHARES[-1], FINE)
    curves = CubicSpline(SHARES, errors / errors.min(axis=1, keepdims=True), axis=1)(fine)
    worse = curves - curves[:, [int(np.argmin(curves.mean(axis=0)))]]
    doubt = worse.std(axis=0, ddof=1) / np.sqrt(len(errors)) if len(errors) > 1 else np.zeros(FINE)
    return float(fine[int(np.argmax(worse.mean(axis=0) <= doubt))])
