"""Every streaked ball's sharper sightings, kept for the pictures in which it is a blur."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray, ImageArray
from video.matting.background_plate import Plate
from video.matting.ball_matting import Sprite, peel
from video.matting.ball_timeline import Sightings
from video.matting.deblur import grown, lit_like, sharpened
from video.matting.frame_store import Gallery

SIGHTINGS = 3
"""Of each ball, spread over the clip: light and what is on the ball change."""
APART_RADII = 3.5
"""Radii to the next ball from which a ball is seen whole, with its shadow."""
FAST_RADII, SLOW_RADII = 1.0, 0.3
"""Radii from picture to picture above which a ball may be a streak, and below which it cannot: no shutter is open for
longer than that."""
FAR, PER_SECOND, MOST_OLD = 0.1, 0.05, 0.3
"""What a sighting from another time costs against the radii of streak of one at hand: at once, per s, at most."""

BORDER_SHARE, BORDER_LEVELS = 0.3, 10.0
"""Step between neighbouring pixels of the ground, share of its brightness and of these levels of 255, that is a border:
of a cushion, a pocket, a line."""
DARK = 16
"""Levels below which the ground is too dark to tell how a ball shades it."""


@dataclass(frozen=True, slots=True)
class SharpBalls:
    """Sightings (time s, sprite, radius px) by ball."""

    sightings: dict[int, tuple[tuple[float, Sprite, float], ...]]

    def of(self, ball: int, t: float, radius: float, near: tuple[Sprite | None, ...]) -> Sprite | None:
        """The ball at its sharpest around time t: from the sprites at hand, or another sighting; made sharp."""
        choices = [(sprite.streak / radius, k, sprite) for k, sprite in enumerate(near) if sprite is not None]
        for k, (when, sprite, size) in enumerate(self.sightings.get(ball, ()), start=len(choices)):
            old = min(PER_SECOND * abs(when - t), MOST_OLD)
            choices.append((sprite.streak / radius + FAR + old, k, grown(sprite, radius / size)))
        return sharpened(min(choices)[2], radius) if choices else None


def sharp_pair(
    balls: SharpBalls, ball: int, t: float, radius: float, sides: tuple[Sprite | None, Sprite | None]
) -> tuple[Sprite | None, Sprite | None]:
    """The ball made sharp, in the light of the sightings before and after; None where there is none."""
    sharp = balls.of(ball, t, radius, sides)
    first, second = (None if sharp is None or side is None else lit_like(sharp, side) for side in sides)
    return first, second


def learn_sharp(sightings: Sightings, gallery: Gallery, plate: Plate) -> SharpBalls:
    """Look through the clip for the sharpest sightings of the balls that may be streaked anywhere."""
    wanted = sharpest_rows(sightings)
    found: dict[int, list[tuple[float, Sprite, float]]] = defaultdict(list)
    for row, picture in gallery.at(wanted):
        motion = sightings.motion(float(sightings.t[row]))
        for index in wanted[row]:
            peeled = peel(picture, [sightings.outline(row, index)], [], plate, motion)
            sprite = peeled.sprites[0]
            if sprite is not None:
                sprite = over_plain_ground(sprite, peeled.behind)
                found[index].append((float(sightings.t[row]), sprite, float(sightings.radius[row, index])))
    return SharpBalls({ball: tuple(sprites) for ball, sprites in found.items()})


def over_plain_ground(sprite: Sprite, behind: ImageArray) -> Sprite:
    """A sprite whose shade goes on evenly over borders and dark parts of the ground `behind` it: they stay there."""
    height, width = sprite.shade.shape[:2]
    ground = cv2.cvtColor(behind[sprite.y : sprite.y + height, sprite.x : sprite.x + width], cv2.COLOR_RGB2GRAY)
    step = cv2.morphologyEx(ground, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).astype(np.float32)
    border = ((step > BORDER_SHARE * (ground + BORDER_LEVELS)) | (ground < DARK)).astype(np.uint8)
    plain = cv2.blur(1 - cv2.dilate(border, np.ones((5, 5), np.uint8)).astype(np.float32), (3, 3))[..., None]
    if plain.min() == 1:
        return sprite
    size = 2 * (min(height, width) // 8) + 1
    about = cv2.blur(sprite.shade * plain, (size, size)) / np.maximum(cv2.blur(plain, (size, size))[..., None], 0.1)
    return replace(sprite, shade=(plain * sprite.shade + (1 - plain) * about).astype(np.float32))


def sharpest_rows(sightings: Sightings) -> dict[int, list[int]]:
    """By row, the balls that may be streaked elsewhere and are likely to be sharp there."""
    wanted: dict[int, list[int]] = defaultdict(list)
    speed = shifts(sightings) / sightings.radius
    for ball in np.flatnonzero(np.nanmax(np.where(np.isfinite(speed), speed, 0), axis=0, initial=0) > FAST_RADII):
        for slow in _slowest(alone(sightings, int(ball)), speed[:, ball]):
            wanted[int(slow)].append(int(ball))
    return dict(wanted)


def shifts(sightings: Sightings) -> FloatArray:
    """(T, N) px that a ball goes from picture to picture, at each the larger of before and after; NaN if unknown."""
    step = np.linalg.norm(np.diff(sightings.centre, axis=0), axis=-1)
    none = np.full((1, step.shape[1]), np.nan)
    return np.asarray(np.fmax(np.concatenate([none, step]), np.concatenate([step, none])), dtype=np.float64)


def _slowest(rows: NDArray[np.intp], speed: FloatArray) -> NDArray[np.intp]:
    """A few of the rows in which a ball cannot be streaked, spread over the clip; else the slowest."""
    slow = rows[speed[rows] < SLOW_RADII]
    if len(slow):
        rows, chosen = slow, np.unique(np.linspace(0, len(slow) - 1, SIGHTINGS).round().astype(int))
    else:
        chosen = np.argsort(speed[rows])[:1]
    return np.asarray(rows[chosen], dtype=np.intp)


def alone(sightings: Sightings, ball: int) -> NDArray[np.intp]:
    """Rows in which a ball is seen away from all others and the border, while or just before or after it moves."""
    centre, radius = sightings.centre, sightings.radius[:, ball]
    apart = np.linalg.norm(np.delete(centre, ball, axis=1) - centre[:, [ball]], axis=-1)
    free = np.nanmin(np.where(np.isfinite(apart), apart, np.inf), axis=1, initial=np.inf) > APART_RADII * radius
    size = np.array([sightings.scene.camera.width_px, sightings.scene.camera.height_px])
    margin = 2 * radius[:, None]
    inside = np.all((centre[:, ball] > margin) & (centre[:, ball] < size - margin), axis=-1)
    moves = sightings.moves[:, ball]
    known = np.concatenate([moves, [False]]) | np.concatenate([[False], moves])
    return np.flatnonzero(free & inside & known & sightings.observed[:, ball])
