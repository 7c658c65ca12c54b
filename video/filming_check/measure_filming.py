"""All measurements of how a clip is filmed, except those that need a ball detector, and the limits of good filming."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, fields
from typing import Literal

import cv2
import numpy as np

from models.core.errors import TableNotFound
from models.core.scene import Scene
from models.core.typing import BoolArray, ByteArray, FloatArray, ImageArray
from video.calibration.table_finder import calibrate_clip, calibrate_image, compute_median_image
from video.filming_check.clip_sample import ClipSample
from video.filming_check.motion_measurements import measure_drift
from video.io.clip import Clip
from video.io.video_options import CalibrateOptions

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


# Radius of a ball, share of the image width, where no table was located: a table of 2.54 m that fills the image.
UNKNOWN_RADIUS_SHARE = 0.012
# Share of the image on each side outside the assumed table, where none was located.
UNKNOWN_INSET = 0.2
# Share of the table's size around it in which edges count for the focus: the rails.
RAIL_SHARE = 0.06
# Deviation of a step between frames from the usual one from which it is irregular.
IRREGULAR_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class FilmingMeasurement:
    """One property of a clip."""

    code: str
    """One of `CODES`, where unit and limits are stated."""
    value: float
    """NaN where it could not be measured."""
    level: Level


@dataclass(frozen=True, slots=True)
class FilmedView:
    """The view of a clip: the table in it, and where its light does harm."""

    background: ImageArray
    """(H, W, 3) what stands still in the clip."""
    scene: Scene | None
    """Table and camera, of the first still where the clip as a whole is refused; None where no table was located."""
    refusal: str
    """Why a run refuses the clip, one sentence; empty otherwise."""
    corners: FloatArray
    """(4, 2) px of the playing surface; of the assumed one where no table was located."""
    mask: BoolArray
    """(H, W) of the playing surface."""
    thumbnail_mask: BoolArray
    """(h, w) the same in the small grey frames of the sample."""
    ball_radius: float
    """px, of a ball at the far end of the table."""
    drift: float
    """px."""
    glare: BoolArray
    """(H, W) bright spots on the cloth."""


def locate_view(sample: ClipSample, clip: Clip, options: CalibrateOptions) -> FilmedView:
    """Locate the table in a clip, as a run does.

    Args:
        sample: A sample of the clip.
        clip: The clip, or the part of it that the sample shows.
        options: Corners, table and ball radius if the user gave them.

    Returns:
        The view, with or without a table.

    Raises:
        OptionError: An option is not meaningful.
    """
    height, width = sample.stills[0].shape[:2]
    margin = UNKNOWN_INSET * np.array([width, height])
    inset = np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * (np.array([width, height]) - 2 * margin) + margin
    greys = [_convert_to_grey(image) for image in sample.stills]
    scene: Scene | None = None
    refusal = ""
    try:
        scene = calibrate_clip(clip, options)
    except TableNotFound as missing:
        refusal = str(missing.args[0])  # what else a run could be told does not change how the clip is filmed
        with suppress(
            TableNotFound
        ):  # a moving camera may have been the reason; light and focus are measured all the same
            scene = calibrate_image(sample.stills[0], options, sample.clip.path.name)
    is_still = scene is not None and scene.camera.motion is None and not refusal
    background = compute_median_image(list(sample.stills)) if is_still else sample.stills[0]
    corners = inset if scene is None else scene.camera.corners_px
    radius = UNKNOWN_RADIUS_SHARE * width if scene is None else _find_least_radius(scene)
    mask = draw_table_mask((width, height), corners)
    small = sample.thumbnails.shape[2], sample.thumbnails.shape[1]
    drift = measure_drift(greys, corners)
    if is_still and np.isinf(drift):
        drift = float("nan")  # the whole clip shows one view; these few frames have too little detail in common
    return FilmedView(
        background, scene, refusal, corners, mask, draw_table_mask(small, corners, small[0] / width), radius, drift,
        find_glare(background, mask, radius),
    )  # fmt: skip


def measure_filming(sample: ClipSample, view: FilmedView, exposure_ms: float) -> dict[str, float]:
    """Measure all properties of a clip.

    Args:
        sample: Sample of the clip.
        view: The table in it.
        exposure_ms: Exposure time, ms; NaN if unknown.

    Returns:
        Values by code, in the units that `FilmingLimits` states; NaN where a property could not be measured.
    """
    height, width = view.background.shape[:2]
    steps = np.diff(sample.times)
    usual = float(np.median(steps))
    distinct = float((~sample.clip.is_duplicate).mean())
    inside = ((view.corners >= 0) & (view.corners <= (width - 1, height - 1))).all(axis=1)
    blur = measure_edge_blur(_convert_to_grey(sample.stills[0]), _draw_mask_with_rails(view))
    return {
        "exposure": measure_exposure(view.background, view.mask),
        "clipping": measure_clipping(view.background, view.mask & ~view.glare),
        "flicker": measure_flicker(sample.thumbnails, view.thumbnail_mask),
        "glare": 100 * float(view.glare.sum() / max(view.mask.sum(), 1)),
        "motion_blur": exposure_ms,
        "frame_rate": distinct / usual,
        "duplicates": 100 * (1 - distinct),
        "irregular_times": 100 * float((np.abs(steps / usual - 1) > IRREGULAR_SHARE).mean()),
        "corners": 0.0 if view.scene is None else float(inside.sum()),
        "ball_size": float("nan") if view.scene is None else 2 * view.ball_radius,
        "camera_drift": view.drift,
        "compression": sample.quantiser_step,
        "focus": blur / view.ball_radius,
    }


def grade_measurements(values: dict[str, float], limits: FilmingLimits) -> tuple[FilmingMeasurement, ...]:
    """Grade measurements.

    Args:
        values: Values by code; NaN is unknown.
        limits: Limits of good filming.

    Returns:
        The graded measurements in the order of the values.
    """
    return tuple(
        FilmingMeasurement(code, value, limits.find_limit(code).grade(value)) for code, value in values.items()
    )


def _convert_to_grey(image: ImageArray) -> ByteArray:
    """Convert an image (H, W, 3) to grey levels (H, W)."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def _find_least_radius(scene: Scene) -> float:
    """Return the least radius of a ball anywhere on the table, px."""
    table = scene.table
    return float(min(scene.camera.radius_px(corner, table.ball_radius) for corner in table.corners))


def _draw_mask_with_rails(view: FilmedView) -> BoolArray:
    """Draw the playing surface and the rails around it, (H, W)."""
    centre = view.corners.mean(axis=0)
    outer = centre + (1 + 2 * RAIL_SHARE) * (view.corners - centre)
    height, width = view.mask.shape
    return draw_table_mask((width, height), outer)


# Level of 255 from which a colour counts as clipped; video rarely reaches 255.
CLIPPED_LEVEL = 250
# A pixel of glare is so many times brighter than the median of the cloth, and has at most this share of its saturation.
GLARE_RATIO, GLARE_GREY = 1.6, 0.5
# Limits of the level of 255 from which a pixel is glare: no dark grey is, and nearly white always is.
GLARE_LEVELS = (150, 240)
# Radius of the smallest spot that is no ball, ball radii.
SPOT_RADII = 1.6
# px around an edge within which both sides are seen, and the least step of a strong edge, grey levels.
EDGE_WINDOW, STRONG_EDGE = 21, 40.0
# Quantile of the blur over strong edges: many edges are soft by themselves, the sharpest show the focus.
SHARPEST_SHARE = 0.2
# px^2 that a slope over two pixels (4 / 12) and the pixels themselves (1 / 12) add to the variance of the blur.
SLOPE_VARIANCE = 5 / 12
# Pixels of strong edges below which the focus is not measured.
LEAST_EDGES = 60
# Percentiles of the cells that give the brightness of a frame: what moves lies outside.
STEADY_SHARES = (25, 75)
# Fewest frames whose brightness shows flicker: at 25 fps, lamps of 100 Hz on cameras beat over several frames.
FLICKER_FRAMES = 12
# Percentiles over the frames that bound the range of the brightness.
RANGE_PERCENTILES = (3, 97)
# Level of 255 below which a cell is too dark for a ratio.
LEAST_LEVEL = 12


def draw_table_mask(size: tuple[int, int], corners: FloatArray, scale: float = 1.0) -> BoolArray:
    """Draw the playing surface.

    Args:
        size: Width and height of the mask, px.
        corners: (4, 2) px of the image.
        scale: Mask pixels per image pixel.

    Returns:
        Mask (h, w).
    """
    mask = np.zeros(size[::-1], np.uint8)
    cv2.fillConvexPoly(mask, np.rint(corners * scale).astype(np.int32), 1)
    return mask > 0


def measure_exposure(image: ImageArray, mask: BoolArray) -> float:
    """Measure the median brightness of the table, grey levels of 255, in an image (H, W, 3) under a mask (H, W)."""
    return float(np.median(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)[mask]))


def measure_clipping(image: ImageArray, mask: BoolArray) -> float:
    """Measure the share of pixels with a colour at its maximum, %, in an image (H, W, 3) under a mask (H, W)."""
    return float(100 * (image.max(axis=2)[mask] >= CLIPPED_LEVEL).mean())


def measure_flicker(thumbnails: ImageArray, mask: BoolArray) -> float:
    """Measure half the range of the brightness over the frames, %.

    Args:
        thumbnails: (K, h, w) small grey frames.
        mask: (h, w) where light is compared.

    Returns:
        Half the range, % of the mean; NaN of too few frames.
    """
    if len(thumbnails) < FLICKER_FRAMES:
        return float("nan")
    cells = thumbnails[:, mask].astype(np.float32)
    typical = np.median(cells, axis=0)
    bright = typical >= LEAST_LEVEL
    if not bright.any():
        return float("nan")
    ratio = np.sort(cells[:, bright] / typical[bright], axis=1)
    low, high = (ratio.shape[1] * share // 100 for share in STEADY_SHARES)
    gain = ratio[:, low : max(high, low + 1)].mean(axis=1)
    first, last = np.percentile(gain, RANGE_PERCENTILES)
    return float(50 * (last - first))


def find_glare(image: ImageArray, mask: BoolArray, ball_radius: float) -> BoolArray:
    """Find bright spots on the cloth that are larger than balls.

    Args:
        image: (H, W, 3), the table without what moves.
        mask: (H, W) of the playing surface.
        ball_radius: px.

    Returns:
        Mask (H, W) of the spots.
    """
    saturation = cv2.cvtColor(image, cv2.COLOR_RGB2HSV)[..., 1].astype(np.float32)
    grey = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY).astype(np.float32)
    cloth_grey, cloth_saturation = float(np.median(grey[mask])), float(np.median(saturation[mask]))
    bright = mask & (grey > np.clip(GLARE_RATIO * cloth_grey, *GLARE_LEVELS))
    bright &= (saturation < GLARE_GREY * cloth_saturation) | (grey >= CLIPPED_LEVEL)
    size = 2 * max(round(SPOT_RADII * ball_radius), 1) + 1
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    return np.asarray(cv2.morphologyEx(bright.astype(np.uint8), cv2.MORPH_OPEN, kernel) > 0)


def measure_edge_blur(grey: ByteArray, mask: BoolArray) -> float:
    """Measure the blur of the sharpest strong edges.

    An edge of step h that is blurred by a Gaussian of standard deviation s has the largest slope h / (s sqrt(2 pi)).

    Args:
        grey: (H, W).
        mask: (H, W) where edges count.

    Returns:
        Standard deviation, px; NaN where there are too few strong edges.
    """
    smooth = grey.astype(np.float32)
    across, down = (cv2.Scharr(smooth, cv2.CV_32F, *axis) / 32 for axis in ((1, 0), (0, 1)))
    slope = cv2.magnitude(across, down)
    kernel = np.ones((EDGE_WINDOW, EDGE_WINDOW), np.uint8)
    step = cv2.dilate(smooth, kernel) - cv2.erode(smooth, kernel)
    near = cv2.dilate(slope, np.ones((5, 5), np.uint8))
    strong = mask & (step >= STRONG_EDGE) & (slope >= near) & (slope > 0.02 * step)
    if np.count_nonzero(strong) < LEAST_EDGES:
        return float("nan")
    apparent = float(np.quantile(step[strong] / (slope[strong] * np.sqrt(2 * np.pi)), SHARPEST_SHARE))
    return float(np.sqrt(max(apparent**2 - SLOPE_VARIANCE, 0.0)))
