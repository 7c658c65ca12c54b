"""Paint of balls over a clip: the colour that a person sees, without white, highlights, shade and reflected cloth."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from skimage.color import rgb2lab

from detectors.measurement.ball_colour import (
    DISC_SAMPLES,
    HIGHLIGHT_SHARE,
    SAMPLED_RADII,
    measure_ball_colours,
    sample_discs,
)  # fmt: skip
from models.core.ball_look import BallLook, Colour
from models.core.scene import Game, Scene
from models.core.srgb import decode_srgb, encode_srgb
from models.core.tracks import Tracks
from models.core.typing import BoolArray, ByteArray, FloatArray, IntArray
from models.tracking.ball_names import FIRST_NUMBERS, LIGHTNESS_WEIGHT, name_balls
from video.io.clip import Clip, read_frames

# Frames of a clip in which a ball is sampled: a striped ball shows its band in some of them only.
FRAMES_PER_BALL = 12
# Length of a motion-blur streak, ball radii, up to which pixels are those of the ball alone.
MAX_STREAK_RADII = 0.5
# Distance of two centres, ball radii, from which no ball covers, shades or is reflected by much of another.
CLEARANCE_RADII = 2.2
# Power of the white ball's colour by which colours are corrected: cue balls are cream as often as the light is yellow,
# so that half of the tint is attributed to the light (in the logarithm).
LIGHT_SHARE = 0.5
# Reflectance of a white ball.
PAPER_WHITE = 0.95
# L* from which, and distance in a* and b* from a white ball below which, a pixel is white, as number spots are.
MIN_WHITE_LIGHTNESS, MAX_WHITE_TINT = 50.0, 18.0
# Share of the lit pixels that must be painted for a colour to be seen: in some clips a stripe shows its white side.
MIN_PAINTED_SHARE = 0.1
# Purity and distance from white, as shares of those of the purest pixels, from which a pixel is paint alone: the rest
# is mixed with white, with a highlight or with cloth; and the quantile that stands for the purest, above it is noise.
MIN_PURE_SHARE, PUREST_QUANTILE = 0.85, 0.97
# Level, of 255, that is added to the brightest channel where purity is a ratio: noise gives dark pixels any.
DARK_LEVEL = 25.0
# Shares of the pixels of pure paint, by lightness, up to which they are in shade, and from which in a lamp's glare.
SHADE_QUANTILE, GLARE_QUANTILE = 0.5, 0.9
# Level from which two channels of a pixel no longer show its hue, and least share of pixels below it that do.
OVEREXPOSED, MIN_EXPOSED_SHARE = 250.0, 0.15
# Hue within which a dull pixel may be cloth that the ball reflects, and least chroma of a cloth that has a hue.
CLOTH_HUE, MIN_CLOTH_CHROMA = np.radians(25.0), 10.0
# Share of the painted pixels that do not have the hue of the cloth, from which these alone may be the paint.
MIN_OWN_SHARE = 0.25
# Least distance of these from white to be the paint, as a share of the distance of all painted pixels.
MIN_OWN_PURITY = 0.75
# White share of the rim and half of that of the disc (as in `ball_classes`) up to which a ball is surely a solid, and
# from which it is surely a stripe; medians over frames.
MAX_SOLID_WHITE, MIN_STRIPE_WHITE = 0.24, 0.4
# Median distance in a* and b* from the paint up to which its pixels are of one paint.
MAX_SPREAD = 8.0
# CIE L*a*b* distance between the paint with and without pixels of the cloth's hue up to which it is certain: that of
# neighbouring colours of a set.
MAX_AMBIGUITY = 12.0


@dataclass(frozen=True, slots=True)
class BallPaint:
    """Paint of N balls."""

    colour: FloatArray
    """(N, 3) sRGB, 0 to 255, as the clip shows it; NaN for a ball without a clear frame."""
    corrected: FloatArray
    """(N, 3) CIE L*a*b* in neutral light."""
    is_certain: BoolArray
    """(N,) whether the pixels are of one paint, and none that the cloth reflects can be mistaken for it."""
    shows_class: BoolArray
    """(N,) whether the white of a solid or stripe leaves no doubt that it is one."""


def look_at_balls(clip: Clip, scene: Scene, tracks: Tracks, classified: Sequence[int] = ()) -> tuple[BallLook, ...]:
    """Describe how the balls of a clip look, and name them.

    Args:
        scene: Table, camera and cloth.
        tracks: Tracks of N balls.
        classified: Numbers of the balls whose class a person set.

    Returns:
        N looks.
    """
    rows = select_clear_frames(tracks, scene.table.ball_radius)
    wanted = np.unique(tracks.frame[np.concatenate([*rows, np.empty(0, np.int64)]).astype(np.int64)])
    paint = measure_paint(read_frames(clip, indices=wanted), tracks, rows, scene)
    paint.shows_class[list(classified)] = True
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
    named = name_balls(tracks.ids, tracks.kinds, paint.corrected, paint.is_certain, paint.shows_class, game)
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
    frames: Iterable[tuple[int, ByteArray]], tracks: Tracks, rows: list[IntArray], scene: Scene
) -> BallPaint:
    """Measure the paint of balls.

    Args:
        frames: Numbers and images (H, W, 3) of the frames of `rows`.
        tracks: Tracks of N balls.
        rows: N arrays of rows of the tracks, as `select_clear_frames` returns them.
        scene: Table and camera.

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
        discs = sample_discs(image, tracks.px[row, balls], tracks.radius_px[row, balls]).astype(np.float64)
        discs[~_find_lit_samples(scene, tracks, row, balls)] = np.nan
        for ball, disc, k in zip(balls, discs, np.searchsorted(shown, balls), strict=True):
            samples[ball].append(disc)
            stripe_white[ball].append(float(colours.white_rim[k] + colours.white[k] / 2))
    white = _find_white(tracks, samples)
    paint = [
        _measure_ball(np.array(discs), white, kind, scene.cloth_lab) if discs else _UNKNOWN
        for discs, kind in zip(samples, tracks.kinds, strict=True)
    ]
    colour, corrected = (np.array([one[column] for one in paint]).reshape(-1, 3) for column in (0, 1))
    whiteness = np.array([np.median(shares) if shares else np.nan for shares in stripe_white])
    is_stripe = np.array(tracks.kinds) == "stripe"
    shows_class = np.where(is_stripe, whiteness >= MIN_STRIPE_WHITE, whiteness <= MAX_SOLID_WHITE)
    return BallPaint(colour, corrected, np.array([one[2] for one in paint], np.bool_), shows_class)


def _find_lit_samples(scene: Scene, tracks: Tracks, row: int, balls: IntArray) -> BoolArray:
    """Find which samples (K, n) of balls in a frame mirror what is above the horizon: lamps light them, the cloth not.

    A sample mirrors the direction r = 2 (n c) n - c for the normal n of the ball and the direction c to the camera.
    """
    xy, radius = tracks.xy[row, balls], scene.table.ball_radius
    low, high = (scene.camera.to_pixels(xy, z, tracks.frame[row]) for z in (radius, 2 * radius))
    to_camera = scene.camera.position - np.column_stack([xy, np.full(len(balls), radius)])
    camera_height = to_camera[:, 2:] / np.linalg.norm(to_camera, axis=1, keepdims=True)
    up = (high - low) / np.maximum(np.linalg.norm(high - low, axis=1, keepdims=True), 1e-9)
    disc = SAMPLED_RADII * DISC_SAMPLES
    facing = np.sqrt(1 - np.sum(disc**2, axis=1))
    normal_height = np.sqrt(1 - camera_height**2) * (up @ disc.T) + camera_height * facing
    return np.asarray(2 * facing * normal_height > camera_height)


def _find_white(tracks: Tracks, samples: list[list[FloatArray]]) -> FloatArray:
    """Find the colour (3,), linear, of a white ball in the light of the clip; plain white without one."""
    white = next((k for k, kind in enumerate(tracks.kinds) if kind in ("cue", "white") and samples[k]), None)
    if white is None:
        return np.ones(3)
    pixels = decode_srgb(np.concatenate(samples[white]) / 255)
    brightness = pixels.mean(axis=1)
    low, high = np.nanquantile(brightness, [SHADE_QUANTILE, GLARE_QUANTILE])
    return np.asarray(np.maximum(np.median(pixels[(brightness >= low) & (brightness <= high)], axis=0), 0.05))


# Paint of a ball that no frame shows.
_UNKNOWN = (np.full(3, np.nan), np.full(3, np.nan), False)


def _measure_ball(
    discs: FloatArray, white: FloatArray, kind: str, cloth_lab: FloatArray
) -> tuple[FloatArray, FloatArray, bool]:
    """Measure sRGB, and CIE L*a*b* in neutral light, of a ball from lit discs (F, n, 3) of sRGB; and if certain.

    Paint is the purest colour of a ball: white, highlights and the chroma of neighbours in coded video only dilute it,
    and shade leaves the ratio of the channels as it is.
    """
    shown, light = decode_srgb(discs / 255), white**LIGHT_SHARE / PAPER_WHITE
    corrected, white_lab = _to_lab(shown / light), _to_lab(white / light)
    lightness, tint = corrected[..., 0], np.linalg.norm(corrected[..., 1:] - white_lab[1:], axis=-1)
    painted = lightness <= np.nanquantile(lightness, 1 - HIGHLIGHT_SHARE, axis=1, keepdims=True)
    is_white, is_black = kind in ("cue", "white"), kind in ("eight", "black")
    coloured = painted & ((tint > MAX_WHITE_TINT) | (lightness < MIN_WHITE_LIGHTNESS))
    if kind in FIRST_NUMBERS and coloured.sum() < MIN_PAINTED_SHARE * painted.sum():
        return _UNKNOWN
    painted = painted if is_white or not coloured.any() else coloured
    exposed = painted & (np.sum(discs >= OVEREXPOSED, axis=-1) < 2)
    painted = exposed if not is_white and exposed.sum() > MIN_EXPOSED_SHARE * painted.sum() else painted
    balanced = 255 * encode_srgb(np.clip(shown / white, 0, 1))
    purity = np.ptp(balanced, axis=-1) / (balanced.max(axis=-1) + DARK_LEVEL)
    distance = np.hypot(LIGHTNESS_WEIGHT * (white_lab[0] - lightness), tint)
    measures = () if is_white else (distance,) if is_black else (purity, distance)  # black has no hue

    def select(pixels: BoolArray) -> BoolArray:
        for measure in measures:  # one after the other, and bounds that are pixels: some are left in any case
            pixels = pixels & (measure >= MIN_PURE_SHARE * np.quantile(measure[pixels], PUREST_QUANTILE))
        low = np.quantile(lightness[pixels], 0.0 if is_black else SHADE_QUANTILE, method="lower")
        high = np.quantile(lightness[pixels], GLARE_QUANTILE, method="higher")
        return np.asarray(pixels & (lightness >= low) & (lightness <= high))

    own = painted & ~_is_cloth(rgb2lab(discs / 255), cloth_lab)
    sets = (painted, own) if own.sum() > MIN_OWN_SHARE * painted.sum() else (painted,)
    choices = [select(one) for one in sets]
    colours = [np.median(corrected[one], axis=0) for one in choices]
    is_own = np.median(distance[choices[-1]]) > MIN_OWN_PURITY * np.median(distance[choices[0]])
    chosen, colour = choices[-int(is_own)], colours[-int(is_own)]
    spread = np.median(np.linalg.norm(corrected[chosen][:, 1:] - colour[1:], axis=1))
    is_certain = np.linalg.norm(colours[0] - colours[-1]) < MAX_AMBIGUITY and spread < MAX_SPREAD
    return np.median(discs[chosen], axis=0), colour, bool(is_certain)


def _is_cloth(lab: FloatArray, cloth_lab: FloatArray) -> BoolArray:
    """Return which pixels (F, n) may be reflected cloth: of its hue, and duller than it."""
    cloth = complex(*cloth_lab[1:])
    if abs(cloth) < MIN_CLOTH_CHROMA:
        return np.zeros(lab.shape[:2], np.bool_)
    pixel = lab[..., 1] + 1j * lab[..., 2]
    return np.asarray((np.abs(np.angle(pixel / cloth)) < CLOTH_HUE) & (np.abs(pixel) < abs(cloth)))


def _to_lab(light: FloatArray) -> FloatArray:
    """Convert linear light (..., 3) to CIE L*a*b*."""
    return np.asarray(rgb2lab(encode_srgb(np.clip(light, 0, 1))))
