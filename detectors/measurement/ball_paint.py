"""Paint of balls over a clip: the colour that a person sees, without white, highlights, shade and reflected cloth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from skimage.color import rgb2lab

from detectors.measurement.ball_colour import HIGHLIGHT_SHARE, measure_ball_colours, sample_discs
from models.core.ball_look import BallLook, Colour
from models.core.scene import Game, Scene
from models.core.tracks import Tracks
from models.core.typing import BoolArray, ByteArray, FloatArray, IntArray
from models.tracking.ball_names import LIGHTNESS_WEIGHT, name_balls
from video.io.clip import Clip, read_frames

FRAMES_PER_BALL = 12
"""Frames of a clip in which a ball is sampled: a striped ball shows its band in some of them only."""
MAX_STREAK_RADII = 0.5
"""Length of a motion-blur streak, ball radii, up to which pixels are those of the ball alone."""
CLEARANCE_RADII = 2.2
"""Distance of two centres, ball radii, from which no ball covers, shades or is reflected by much of another."""
LIGHT_SHARE = 0.5
"""Power of the white ball's colour by which colours are corrected: cue balls are cream as often as the light is yellow,
so that half of the tint is attributed to the light (in the logarithm)."""
PAPER_WHITE = 0.95
"""Reflectance of a white ball."""
MIN_WHITE_LIGHTNESS, MAX_WHITE_TINT = 50.0, 18.0
"""L* from which, and distance in a* and b* from a white ball below which, a pixel is white, as number spots are."""
MIN_PAINTED_SHARE = 0.03
"""Share of painted pixels below which a ball is white throughout."""
SHADE_QUANTILE, DULL_QUANTILE = 0.35, 0.75
"""Share of the painted pixels that is in shade, by lightness; and of a stripe, that is mixed with white."""
CLOTH_HUE, MIN_CLOTH_CHROMA = np.radians(25.0), 10.0
"""Hue within which a dull pixel may be cloth that the ball reflects, and least chroma of a cloth that has a hue."""
MIN_STRIPE_WHITE = 0.45
"""White share of the rim and half of that of the disc (as in `ball_classes`) from which a ball is surely striped: the
number spot of a solid reaches 0.40."""
MAX_AMBIGUITY = 12.0
"""CIE L*a*b* distance between the paint with and without pixels of the cloth's hue up to which it is certain: that of
neighbouring colours of a set."""


@dataclass(frozen=True, slots=True)
class BallPaint:
    """Paint of N balls."""

    colour: FloatArray
    """(N, 3) sRGB, 0 to 255, as the clip shows it; NaN for a ball without a clear frame."""
    corrected: FloatArray
    """(N, 3) CIE L*a*b* in neutral light."""
    is_certain: BoolArray
    """(N,) whether neither reflected cloth can be mistaken for paint, nor the number spot of a solid for a stripe."""


def look_at_balls(clip: Clip, scene: Scene, tracks: Tracks) -> tuple[BallLook, ...]:
    """Describe how the balls of a clip look, and name them.

    Args:
        clip: The clip.
        scene: Table, camera and cloth.
        tracks: Tracks of N balls.

    Returns:
        N looks.
    """
    rows = select_clear_frames(tracks, scene.table.ball_radius)
    wanted = np.unique(tracks.frame[np.concatenate([*rows, np.empty(0, np.int64)]).astype(np.int64)])
    paint = measure_paint(read_frames(clip, indices=wanted), tracks, rows, scene.cloth_lab)
    return describe_balls(paint, tracks, scene.table.game)


def describe_balls(paint: BallPaint, tracks: Tracks, game: Game) -> tuple[BallLook, ...]:
    """Describe balls by their paint.

    Args:
        paint: Paint of N balls.
        tracks: Their tracks.
        game: Game that the table is for.

    Returns:
        N looks; a ball without a measured colour keeps the one of its class.
    """
    named = name_balls(tracks.ids, tracks.kinds, paint.corrected, paint.is_certain, game)
    return tuple(
        BallLook(name, _round_colour(rgb) if np.isfinite(rgb).all() else plain.colour, number, kind == "stripe")
        for (name, number), kind, rgb, plain in zip(named, tracks.kinds, paint.colour, tracks.looks, strict=True)
    )


def _round_colour(rgb: FloatArray) -> Colour:
    red, green, blue = (round(float(value)) for value in rgb)
    return red, green, blue


def select_clear_frames(tracks: Tracks, radius: float) -> list[IntArray]:
    """Select frames in which each ball is sharp and apart from the others.

    Args:
        tracks: Tracks of T frames and N balls.
        radius: Radius of the balls, m.

    Returns:
        N arrays of at most `FRAMES_PER_BALL` rows of the tracks, spread over the time in which the ball is detected;
        the sharpest ones of a ball that is never clear.
    """
    chosen = []
    for ball in range(len(tracks.ids)):
        rows = np.flatnonzero(tracks.is_observed[:, ball])
        blur = np.linalg.norm(tracks.streak[rows, ball], axis=1) / radius
        distance = np.linalg.norm(tracks.px[rows] - tracks.px[rows, ball, None], axis=2)
        distance[:, ball] = np.inf
        nearest = np.nan_to_num(distance, nan=np.inf).min(axis=1) / tracks.radius_px[rows, ball]
        clear = rows[(blur < MAX_STREAK_RADII) & (nearest > CLEARANCE_RADII)]
        clear = clear if len(clear) else rows[np.argsort(blur, kind="stable")[:FRAMES_PER_BALL]]
        chosen.append(clear[np.unique(np.linspace(0, len(clear) - 1, min(FRAMES_PER_BALL, len(clear))).astype(int))])
    return chosen


def measure_paint(
    frames: Iterable[tuple[int, ByteArray]], tracks: Tracks, rows: list[IntArray], cloth_lab: FloatArray
) -> BallPaint:
    """Measure the paint of balls.

    Args:
        frames: Numbers and images (H, W, 3) of the frames of `rows`.
        tracks: Tracks of N balls.
        rows: N arrays of rows of the tracks, as `select_clear_frames` returns them.
        cloth_lab: (3,) CIE L*a*b* of the cloth.

    Returns:
        The paint.
    """
    samples: list[list[FloatArray]] = [[] for _ in tracks.ids]
    stripe_white: list[list[float]] = [[] for _ in tracks.ids]
    row_of_frame = {int(frame): row for row, frame in enumerate(tracks.frame)}
    for frame, image in frames:
        row = row_of_frame[frame]
        balls = np.array([k for k, own in enumerate(rows) if row in own], np.int64)
        shown = np.flatnonzero(tracks.is_observed[row])
        colours = measure_ball_colours(image, tracks.px[row, shown], tracks.radius_px[row, shown])
        discs = sample_discs(image, tracks.px[row, balls], tracks.radius_px[row, balls])
        for ball, disc, k in zip(balls, discs, np.searchsorted(shown, balls), strict=True):
            samples[ball].append(np.asarray(disc, np.float64))
            stripe_white[ball].append(float(colours.white_rim[k] + colours.white[k] / 2))
    white = _find_white(tracks, samples)
    light = np.maximum(white, 0.05) ** LIGHT_SHARE / PAPER_WHITE
    white_lab = _to_lab(white / light)
    unknown = (np.full(3, np.nan), np.full(3, np.nan), False)
    paint = [
        _measure_ball(np.array(discs), light, white_lab, kind, cloth_lab) if discs else unknown
        for discs, kind in zip(samples, tracks.kinds, strict=True)
    ]
    colour, corrected = (np.array([one[column] for one in paint]).reshape(-1, 3) for column in (0, 1))
    is_certain = [
        one[2] and (kind != "stripe" or np.median(white) > MIN_STRIPE_WHITE)
        for one, kind, white in zip(paint, tracks.kinds, stripe_white, strict=True)
    ]
    return BallPaint(colour, corrected, np.array(is_certain, np.bool_))


def _find_white(tracks: Tracks, samples: list[list[FloatArray]]) -> FloatArray:
    """Find the colour (3,), linear, of a white ball in the light of the clip; plain white without one."""
    white = next((k for k, kind in enumerate(tracks.kinds) if kind in ("cue", "white") and samples[k]), None)
    if white is None:
        return np.ones(3)
    pixels = _to_linear(np.concatenate(samples[white]))
    brightness = pixels.mean(axis=1)
    low, high = np.quantile(brightness, [SHADE_QUANTILE, 1 - HIGHLIGHT_SHARE])
    return np.asarray(np.median(pixels[(brightness >= low) & (brightness <= high)], axis=0))


def _measure_ball(
    discs: FloatArray, light: FloatArray, white: FloatArray, kind: str, cloth_lab: FloatArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Measure sRGB, and CIE L*a*b* in neutral light, of a ball from discs (F, n, 3) of sRGB; and if it is certain."""
    corrected = _to_lab(_to_linear(discs) / light)
    lightness, tint = corrected[..., 0], np.linalg.norm(corrected[..., 1:] - white[1:], axis=-1)
    painted = lightness <= np.quantile(lightness, 1 - HIGHLIGHT_SHARE, axis=1, keepdims=True)
    if kind not in ("cue", "white"):
        coloured = painted & ((tint > MAX_WHITE_TINT) | (lightness < MIN_WHITE_LIGHTNESS))
        painted = coloured if coloured.mean() > MIN_PAINTED_SHARE else painted
    purity = np.hypot(LIGHTNESS_WEIGHT * (white[0] - lightness), tint)  # a band is seen mixed with white at its edges
    rank, quantile = (purity, DULL_QUANTILE) if kind == "stripe" else (lightness, SHADE_QUANTILE)
    own = painted & ~_is_cloth(_to_lab(_to_linear(discs)), cloth_lab)
    choices = [one & (rank >= np.quantile(rank[one], quantile)) for one in (painted, own) if one.any()]
    first, last = (np.median(corrected[one], axis=0) for one in (choices[0], choices[-1]))
    is_certain = own.mean() <= MIN_PAINTED_SHARE or bool(np.linalg.norm(first - last) < MAX_AMBIGUITY)
    chosen = choices[-1] if is_certain and own.mean() > MIN_PAINTED_SHARE else choices[0]
    return np.median(discs[chosen], axis=0), np.median(corrected[chosen], axis=0), is_certain


def _is_cloth(lab: FloatArray, cloth_lab: FloatArray) -> BoolArray:
    """Return which pixels (F, n) may be reflected cloth: of its hue, and duller than it."""
    cloth = complex(*cloth_lab[1:])
    if abs(cloth) < MIN_CLOTH_CHROMA:
        return np.zeros(lab.shape[:2], np.bool_)
    pixel = lab[..., 1] + 1j * lab[..., 2]
    return np.asarray((np.abs(np.angle(pixel / cloth)) < CLOTH_HUE) & (np.abs(pixel) < abs(cloth)))


def _to_linear(rgb: FloatArray) -> FloatArray:
    """Convert sRGB, 0 to 255, to linear light, 0 to 1 (IEC 61966-2-1)."""
    x = rgb / 255
    return np.where(x <= 0.04045, x / 12.92, ((x + 0.055) / 1.055) ** 2.4)


def _to_lab(linear: FloatArray) -> FloatArray:
    """Convert linear light (..., 3) to CIE L*a*b*."""
    x = np.clip(linear, 0, 1)
    return np.asarray(rgb2lab(np.where(x <= 0.0031308, 12.92 * x, 1.055 * x ** (1 / 2.4) - 0.055)))
