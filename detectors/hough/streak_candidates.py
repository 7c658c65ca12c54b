"""Candidate motion-blur streaks: a fast ball covers a capsule during the exposure, as wide as the ball."""

from __future__ import annotations

import cv2
import numpy as np

from detectors.measurement.frame_detections import NO_BALLS, FrameDetections
from detectors.measurement.working_view import WorkingView
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

# Share of a blob's own contrast below which a pixel does not belong to it.
FAINT_SHARE = 0.25
# Level, share of the height, at which the ends of a streak are measured: a ball leaves little light there.
END_SHARE = 0.25
# Largest difference of the halves of a streak's profile, over its mean.
MAX_ASYMMETRY = 0.3
# Least length of a streak, ball radii; shorter ones are measured as discs.
MIN_LENGTH_RADII = 0.5
# Largest length of a streak, ball radii; a ball at 10 m/s that is exposed for 1/15 s moves about 23 radii.
MAX_LENGTH_RADII = 26.0
# Limits of the width of the blob over that of the ball.
WIDTH_LIMITS = (0.78, 1.5)
# Least width of the blob between its round ends, over its width: two touching balls have a waist.
MIN_WAIST = 0.7
# Least intersection over union of blob and capsule.
MIN_FILL = 0.80
# Standard deviation of a streak's middle: across it, px, and in addition along it, share of its length.
STREAK_SIGMA_PX, STREAK_SIGMA_SHARE = 0.3, 0.03


def find_streak_candidates(moving: BoolArray, strength: Float32Array, view: WorkingView) -> FrameDetections:
    """Find capsules among the blobs that differ from both the cloth and the median image, working px."""
    left, top, width, height = cv2.boundingRect(moving.astype(np.uint8))
    if width == 0:
        return _stack_streaks([])
    window = slice(top, top + height), slice(left, left + width)
    moving, strength, rim = moving[window], strength[window], view.border[window]
    count, labels, stats, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8), connectivity=8)
    beyond = set(labels[rim].tolist())
    least = 0.5 * np.pi * float(view.radius.min()) ** 2
    capsules = []
    for blob in range(1, count):
        x, y, w, h, area = (int(n) for n in stats[blob])
        if blob in beyond or area < least or max(w, h) > (MAX_LENGTH_RADII + 2) * float(view.radius.max()):
            continue
        inside = labels[y : y + h, x : x + w] == blob
        levels = np.where(inside, strength[y : y + h, x : x + w], 0)
        # Relative to the ball's own contrast, so that its shadow is left out.
        clear = inside & (levels > FAINT_SHARE * np.quantile(levels[inside], 0.9))
        capsule = _fit_capsule(clear, np.array([left + x, top + y], dtype=float), view)
        if capsule is not None:
            capsules.append(capsule)
    return _stack_streaks(capsules)


def _stack_streaks(rows: list[tuple[FloatArray, FloatArray, float, float]]) -> FrameDetections:
    if not rows:
        return NO_BALLS
    centre, streak, radius, fill = (np.array(column) for column in zip(*rows, strict=True))
    across = np.full(len(rows), STREAK_SIGMA_PX)
    along = np.hypot(across, STREAK_SIGMA_SHARE * np.linalg.norm(streak, axis=1))
    return FrameDetections(centre, radius, streak, fill, across, along)


def refine_streaks(rgb: ByteArray, rough: FrameDetections, basis: FloatArray) -> FrameDetections:
    """Measure middles and lengths of streaks in the full image, px, by the profiles across and along them."""
    columns = rough.centre, rough.streak, rough.radius, rough.score
    fine = [_refine_streak(rgb, *one, basis) for one in zip(*columns, strict=True)]
    return _stack_streaks([one for one in fine if one is not None])


def _refine_streak(
    rgb: ByteArray, centre: FloatArray, displacement: FloatArray, radius: float, fill: float, basis: FloatArray
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """Measure one streak in the full image; None if it is not symmetric, such as a ball with its shadow."""
    length = float(np.linalg.norm(displacement))
    along = displacement / length
    across = np.array([-along[1], along[0]])
    u = np.arange(-length / 2 - 2.2 * radius, length / 2 + 2.2 * radius + 0.01, 0.5)
    v = np.arange(-2.0 * radius, 2.0 * radius + 0.01, 0.5)
    share = _mixing_share(rgb, centre + u[:, None, None] * along + v[:, None] * across, u, v, length, radius, basis)
    side = _find_crossings(share[np.abs(u) < max(0.3 * length, 0.4 * radius)].mean(axis=0), v, 0.5)
    ends = _find_crossings(share[:, np.abs(v) < 0.4 * radius].mean(axis=1), u, END_SHARE)
    if side is None or ends is None:
        return centre, displacement, radius, fill
    core = share[:, np.abs(v) < 0.4 * radius].mean(axis=1)
    if _profile_asymmetry(core, u, sum(ends) / 2, length / 2 + radius) > MAX_ASYMMETRY:
        return None
    # The ramp of an end is as long as the shorter of streak and ball; the level cuts off part of it.
    extent = ends[1] - ends[0]
    refined_length = max(extent - 2 * radius + 2 * END_SHARE * min(length, 2 * radius), 0.0)
    moved = centre + along * sum(ends) / 2 + across * sum(side) / 2
    if np.linalg.norm(moved - centre) > 0.8 * radius or abs(refined_length - length) > radius:
        return centre, displacement, radius, fill
    return moved, along * refined_length, radius, fill


def _profile_asymmetry(profile: FloatArray, at: FloatArray, middle: float, reach: float) -> float:
    """Mean difference of both halves of a profile (n,) about its middle, over its mean."""
    offsets = np.arange(0.0, reach, 0.5)
    before, after = np.interp(middle - offsets, at, profile), np.interp(middle + offsets, at, profile)
    return float(np.abs(before - after).mean() / max(float((before + after).mean()) / 2, 1e-9))


def _mixing_share(
    rgb: ByteArray, at: FloatArray, u: FloatArray, v: FloatArray, length: float, radius: float, basis: FloatArray
) -> FloatArray:
    """Share (n, m) of the ball's colour that is mixed into the cloth's at px (n, m, 2)."""
    place = at.astype(np.float32)
    samples = cv2.remap(rgb, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = samples.astype(np.float64) @ basis.T
    inner = (np.abs(u) < length / 2)[:, None] & (np.abs(v) < 0.5 * radius)
    outer = (np.abs(v) > 1.5 * radius)[None] & np.ones(len(u), dtype=bool)[:, None]
    cloth = np.median(colours[outer], axis=0)
    ball = np.median(colours[inner], axis=0) - cloth
    mixed: FloatArray = (colours - cloth) @ ball / max(float(ball @ ball), 1e-9)
    return mixed


def _find_crossings(profile: FloatArray, at: FloatArray, level: float) -> tuple[float, float] | None:
    """Find where a profile (n,) with one maximum rises and falls through a share of its height; None at its ends."""
    high = profile > level * float(np.quantile(profile, 0.9))
    inside = np.flatnonzero(high)
    if not len(inside) or inside[0] == 0 or inside[-1] == len(profile) - 1:
        return None
    height = level * float(np.quantile(profile, 0.9))
    first, last = inside[0], inside[-1]
    rise = at[first - 1] + (height - profile[first - 1]) / (profile[first] - profile[first - 1]) * (at[1] - at[0])
    fall = at[last] + (profile[last] - height) / (profile[last] - profile[last + 1]) * (at[1] - at[0])
    return float(rise), float(fall)


def _fit_capsule(
    blob: BoolArray, corner: FloatArray, view: WorkingView
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """Fit a capsule of the expected width to a blob (h, w); None if it has another shape."""
    points = np.column_stack(np.nonzero(blob)[::-1]).astype(np.float64) + corner
    if len(points) < 12:
        return None
    middle = points.mean(axis=0)
    u, v = np.clip(np.rint(middle).astype(int), 0, np.array(view.radius.shape[::-1]) - 1)
    radius = float(view.radius[v, u])
    axes = np.linalg.eigh(np.cov((points - middle).T))[1]
    along, across = axes[:, 1], axes[:, 0]
    reach, width = _extent_along((points - middle) @ along), _extent_along((points - middle) @ across)
    length = (reach[1] - reach[0]) - (width[1] - width[0])
    ratio = (width[1] - width[0]) / (2 * radius)
    if (
        length < MIN_LENGTH_RADII * radius
        or not WIDTH_LIMITS[0] < ratio < WIDTH_LIMITS[1]
        or not view.centre_area[v, u]
    ):
        return None
    if _relative_waist((points - middle) @ along, reach, 2 * radius * ratio) < MIN_WAIST:
        return None
    centre = middle + along * sum(reach) / 2 + across * sum(width) / 2
    fill = _capsule_overlap(points, centre, along * length, radius * ratio)
    return (centre, along * length, radius, fill) if fill > MIN_FILL else None


def _relative_waist(along: FloatArray, reach: tuple[float, float], width: float) -> float:
    """Least width between the round ends of points (n,) along the axis, over the width."""
    bins = np.arange(reach[0] + width / 2, reach[1] - width / 2 + 2.0, 2.0)
    if len(bins) < 2:
        return 1.0
    return float(np.histogram(along, bins)[0].min() / (2.0 * width))


def _extent_along(along: FloatArray) -> tuple[float, float]:
    """Both ends of points (n,), with pixel edges and without single stray pixels."""
    low, high = np.quantile(along, (0.004, 0.996))
    return float(low) - 0.5, float(high) + 0.5


def _capsule_overlap(points: FloatArray, centre: FloatArray, vector: FloatArray, radius: float) -> float:
    """Intersection over union of pixels (n, 2) and a capsule."""
    length = float(np.linalg.norm(vector))
    at = points - centre
    along = np.clip(at @ vector / max(length, 1e-9), -length / 2, length / 2)
    beside = np.linalg.norm(at - along[:, None] * vector / max(length, 1e-9), axis=1)
    inside = float((beside < radius + 0.5).sum())
    area = np.pi * radius**2 + 2 * radius * length
    return inside / (area + len(points) - inside)
