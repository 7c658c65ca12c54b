"""The sharpest views of every streaked ball, deblurred and adjusted to another light and size."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from models.core.typing import Float32Array, FloatArray, ImageArray
from video.io.clip import Clip
from video.matting.background_plate import BackgroundPlate
from video.matting.ball_matting import MattedSprite, matte_balls, sample_path
from video.matting.ball_timeline import BallTimeline, read_rows

# Views of each ball, spread over the clip because light and visible markings change.
VIEWS_PER_BALL = 3
# Radii to the next ball from which a ball is visible as a whole with its shadow.
ISOLATED_RADII = 3.5
# Radii of motion per frame above which a ball may be streaked, and below which it cannot: no shutter is open for
# longer.
FAST_RADII, SLOW_RADII = 1.0, 0.3
# Cost of a view from another time, in radii of streak of a view at hand: constant, per s, and at most.
OTHER_TIME_COST, COST_PER_SECOND, MAX_AGE_COST = 0.1, 0.05, 0.3

# Step between neighbouring pixels of the background, relative to its brightness plus these levels of 255, that is the
# border of a cushion, a pocket or a line.
BORDER_STEP_SHARE, BORDER_OFFSET_LEVELS = 0.3, 10.0
# Levels below which the background is too dark to measure shading.
DARK_LEVEL = 16


@dataclass(frozen=True, slots=True)
class SharpBalls:
    """The sharpest views (time s, sprite, radius px) of each ball."""

    views: dict[int, tuple[tuple[float, MattedSprite, float], ...]]

    def select_sharpest(
        self, ball: int, t: float, radius: float, nearby: tuple[MattedSprite | None, ...]
    ) -> MattedSprite | None:
        """Select the sharpest sprite of a ball around time t, from nearby frames or stored views, and deblur it."""
        choices = [(sprite.streak_length / radius, k, sprite) for k, sprite in enumerate(nearby) if sprite is not None]
        for k, (when, sprite, size) in enumerate(self.views.get(ball, ()), start=len(choices)):
            old = min(COST_PER_SECOND * abs(when - t), MAX_AGE_COST)
            choices.append(
                (sprite.streak_length / radius + OTHER_TIME_COST + old, k, scale_sprite(sprite, radius / size))
            )
        return deblur_sprite(min(choices)[2], radius) if choices else None


def deblur_pair(
    balls: SharpBalls, ball: int, t: float, radius: float, sides: tuple[MattedSprite | None, MattedSprite | None]
) -> tuple[MattedSprite | None, MattedSprite | None]:
    """Return the sharp ball in the light of the frames before and after.

    Args:
        balls: Stored views.
        ball: Index of the ball.
        t: Time, s.
        radius: Radius of the ball, px.
        sides: Sprites in the frame before and in the one after; None where the ball is absent.

    Returns:
        Sharp sprites for both frames; None where the ball is absent or has no view.
    """
    sharp = balls.select_sharpest(ball, t, radius, sides)
    first, second = (None if sharp is None or side is None else match_brightness(sharp, side) for side in sides)
    return first, second


def collect_sharp_balls(timeline: BallTimeline, clip: Clip, plate: BackgroundPlate) -> SharpBalls:
    """Search the clip for the sharpest views of the balls that may be streaked in any frame.

    Args:
        timeline: Positions of the balls.
        plate: Background plate.

    Returns:
        The views by ball.
    """
    wanted = find_sharpest_rows(timeline)
    views: dict[int, list[tuple[float, MattedSprite, float]]] = defaultdict(list)
    for row, image in read_rows(clip, timeline, wanted):
        motion = timeline.camera_motion_at(float(timeline.t[row]))
        for index in wanted[row]:
            matted = matte_balls(image, [timeline.outline(row, index)], [], plate, motion)
            sprite = matted.sprites[0]
            if sprite is not None:
                sprite = smooth_shading_over_borders(sprite, matted.background)
                views[index].append((float(timeline.t[row]), sprite, float(timeline.radius[row, index])))
    return SharpBalls({ball: tuple(sprites) for ball, sprites in views.items()})


def smooth_shading_over_borders(sprite: MattedSprite, background: ImageArray) -> MattedSprite:
    """Smooth the shading of a sprite over borders and dark parts of its background.

    The shading measured there does not transfer to other places.
    """
    height, width = sprite.shading.shape[:2]
    ground = cv2.cvtColor(background[sprite.y : sprite.y + height, sprite.x : sprite.x + width], cv2.COLOR_RGB2GRAY)
    step = cv2.morphologyEx(ground, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8)).astype(np.float32)
    border = ((step > BORDER_STEP_SHARE * (ground + BORDER_OFFSET_LEVELS)) | (ground < DARK_LEVEL)).astype(np.uint8)
    plain = cv2.blur(1 - cv2.dilate(border, np.ones((5, 5), np.uint8)).astype(np.float32), (3, 3))[..., None]
    if plain.min() == 1:
        return sprite
    size = 2 * (min(height, width) // 8) + 1
    about = cv2.blur(sprite.shading * plain, (size, size)) / np.maximum(cv2.blur(plain, (size, size))[..., None], 0.1)
    return replace(sprite, shading=(plain * sprite.shading + (1 - plain) * about).astype(np.float32))


def find_sharpest_rows(timeline: BallTimeline) -> dict[int, list[int]]:
    """Select for each ball that may be streaked the rows in which it is likely to be sharp.

    Args:
        timeline: Positions of the balls.

    Returns:
        Indices of the balls by row.
    """
    wanted: dict[int, list[int]] = defaultdict(list)
    speed = frame_to_frame_shifts(timeline) / timeline.radius
    for ball in np.flatnonzero(np.nanmax(np.where(np.isfinite(speed), speed, 0), axis=0, initial=0) > FAST_RADII):
        for slow in _select_slowest_rows(find_isolated_rows(timeline, int(ball)), speed[:, ball]):
            wanted[int(slow)].append(int(ball))
    return dict(wanted)


def frame_to_frame_shifts(timeline: BallTimeline) -> FloatArray:
    """Return the px (T, N) that a ball moves to the next frame or from the last, the larger one; NaN if unknown."""
    step = np.linalg.norm(np.diff(timeline.centre, axis=0), axis=-1)
    none = np.full((1, step.shape[1]), np.nan)
    return np.asarray(np.fmax(np.concatenate([none, step]), np.concatenate([step, none])), dtype=np.float64)


def _select_slowest_rows(rows: NDArray[np.intp], speed: FloatArray) -> NDArray[np.intp]:
    """Select some rows, spread over the clip, in which a ball is too slow to be streaked; else the slowest row."""
    slow = rows[speed[rows] < SLOW_RADII]
    if len(slow):
        rows, selected = slow, np.unique(np.linspace(0, len(slow) - 1, VIEWS_PER_BALL).round().astype(int))
    else:
        selected = np.argsort(speed[rows])[:1]
    return np.asarray(rows[selected], dtype=np.intp)


def find_isolated_rows(timeline: BallTimeline, ball: int) -> NDArray[np.intp]:
    """Return the rows in which a ball is visible away from other balls and the border, during or next to its motion."""
    centre, radius = timeline.centre, timeline.radius[:, ball]
    distance = np.linalg.norm(np.delete(centre, ball, axis=1) - centre[:, [ball]], axis=-1)
    isolated = (
        np.nanmin(np.where(np.isfinite(distance), distance, np.inf), axis=1, initial=np.inf) > ISOLATED_RADII * radius
    )
    size = np.array([timeline.scene.camera.width_px, timeline.scene.camera.height_px])
    margin = 2 * radius[:, None]
    inside = np.all((centre[:, ball] > margin) & (centre[:, ball] < size - margin), axis=-1)
    moving = timeline.moving[:, ball]
    around_motion = np.concatenate([moving, [False]]) | np.concatenate([[False], moving])
    return np.flatnonzero(isolated & inside & around_motion & timeline.observed[:, ball])


# Richardson-Lucy iterations; more amplify coding noise.
ITERATIONS = 12
# Limits of the brightness ratio of a ball between two places on the table.
GAIN_LIMITS = (0.6, 1.6)
# Relative change of the radius below which a sprite is not scaled.
MIN_SCALE_CHANGE = 0.02
# px of streak below which a sprite is sharp.
MAX_SHARP_STREAK_PX = 1.0


def blur_along_path(patch: Float32Array, places: FloatArray) -> Float32Array:
    """Average a patch (h, w, C) over places (K, 2) px, keeping its size."""
    blurred = cv2.filter2D(patch, cv2.CV_32F, _path_kernel(places), borderType=cv2.BORDER_CONSTANT)
    return np.asarray(blurred, dtype=np.float32).reshape(patch.shape)


def _path_kernel(places: FloatArray) -> Float32Array:
    """Return the image of a point moving along the places, mirrored because filter2D correlates."""
    half = int(np.ceil(np.abs(places).max())) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1), dtype=np.float32)
    whole = np.floor(-places).astype(int)
    rest = -places - whole
    for dy in (0, 1):
        for dx in (0, 1):
            weight = np.abs(1 - dx - rest[:, 0]) * np.abs(1 - dy - rest[:, 1])
            np.add.at(kernel, (whole[:, 1] + half + dy, whole[:, 0] + half + dx), weight)
    return kernel / np.float32(len(places))


def deblur_sprite(sprite: MattedSprite, radius: float) -> MattedSprite:
    """Estimate the ball at a short shutter time (Richardson 1972, doi:10.1364/JOSA.62.000055; Lucy 1974).

    The shutter sums premultiplied colours, so these are deconvolved. The ball is constrained to lie within its radius
    around the middle of its path.
    """
    if sprite.streak_length < MAX_SHARP_STREAK_PX:
        return sprite
    places = sample_path(sprite.path)
    observed = np.maximum(sprite.rgba, 0)
    disc = _ball_disc(sprite, radius)
    level = np.maximum(observed.sum(axis=(0, 1)), 1e-3) / np.float32(max(float(disc.sum()), 1.0))
    guess: Float32Array = disc * level.astype(np.float32)
    for _ in range(ITERATIONS):
        ratio = np.asarray(observed / np.maximum(blur_along_path(guess, places), 1e-3), dtype=np.float32)
        guess = np.asarray(guess * np.clip(blur_along_path(ratio, -places), 0.2, 5.0), dtype=np.float32)
    guess[..., 3] = np.minimum(disc[..., 0], 1)
    mask, ceiling = guess[..., 3:], 255 * guess[..., 3:]
    rgba = np.concatenate([np.clip(guess[..., :3], 0, ceiling), mask], axis=2).astype(np.float32)
    return replace(
        sprite, rgba=rgba, visibility=np.ones_like(sprite.visibility), path=sprite.path[[len(sprite.path) // 2]] * 0
    )


def _ball_disc(sprite: MattedSprite, radius: float) -> Float32Array:
    """Return the soft disc (k, l, 1) of the ball at the middle of its path."""
    height, width = sprite.rgba.shape[:2]
    centre = sprite.centre - np.array([sprite.x, sprite.y]) - sprite.rgba_offset
    distance = np.hypot(np.arange(width)[None] - centre[0], np.arange(height)[:, None] - centre[1])
    edge = max(1.0, 0.1 * radius)
    return np.asarray(np.clip((radius + 1.5 * edge - distance) / edge, 0, 1)[..., None], dtype=np.float32)


def match_brightness(sharp: MattedSprite, reference: MattedSprite) -> MattedSprite:
    """Scale each colour channel of a sharp sprite to the mean colour of another view, which may be streaked."""
    own, target = (_mean_colour(sprite) for sprite in (sharp, reference))
    gain = np.clip(target / np.maximum(own, 1e-3), *GAIN_LIMITS)
    rgba = sharp.rgba.copy()
    rgba[..., :3] = np.minimum(rgba[..., :3] * gain.astype(np.float32), 255 * np.clip(rgba[..., 3:], 0, 1))
    return replace(sharp, rgba=rgba)


def _mean_colour(sprite: MattedSprite) -> FloatArray:
    """Return the mean colour (3,) of the visible part of a ball."""
    rgba = sprite.rgba * (sprite.visibility > 0.5)[..., None]
    return np.asarray(rgba[..., :3].sum(axis=(0, 1)) / max(float(rgba[..., 3].sum()), 1e-3), dtype=np.float64)


def scale_sprite(sprite: MattedSprite, ratio: float) -> MattedSprite:
    """Scale a ball by a ratio, for a view from another distance."""
    if abs(ratio - 1) < MIN_SCALE_CHANGE:
        return sprite
    corner = (sprite.centre - np.array([sprite.x, sprite.y])) * ratio
    shading = _scale_patch(sprite.shading, ratio)
    offset = np.rint(np.array(sprite.rgba_offset) * ratio)
    # Whole-pixel offsets keep both patches aligned; the fraction shifts the colours.
    rest = np.array(sprite.rgba_offset) * ratio - offset
    rgba, visibility = (_scale_patch(patch, ratio, rest) for patch in (sprite.rgba, sprite.visibility))
    return replace(
        sprite, x=0, y=0, centre=corner, shading=shading, rgba=rgba, visibility=visibility,
        rgba_offset=(int(offset[0]), int(offset[1])),
    )  # fmt: skip


def _scale_patch(patch: Float32Array, ratio: float, shift: FloatArray | None = None) -> Float32Array:
    """Scale a patch by a ratio, shifted by a fraction of a pixel."""
    off = np.zeros(2) if shift is None else shift
    size = tuple(int(np.ceil(side * ratio)) + 1 for side in patch.shape[1::-1])
    grow = np.array([[ratio, 0, off[0]], [0, ratio, off[1]]])
    return np.asarray(cv2.warpAffine(patch, grow, size, flags=cv2.INTER_LINEAR), dtype=np.float32)
