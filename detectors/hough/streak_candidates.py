"""Fast balls: during the exposure a disc sweeps a capsule, as wide as the ball and longer the faster it is."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from detectors.measurement.working_view import View
from models.core.typing import BoolArray, ByteArray, Float32Array, FloatArray

FAINT_SHARE = 0.25
"""Share of a blob's own contrast below which a pixel is not part of it."""
END_SHARE = 0.25
"""Height at which the ends of a streak are read: a ball leaves little light there."""
MOST_LOPSIDED = 0.3
"""Difference of a streak's halves, over its mean, above which it is none."""
LEAST_STRETCH = 0.5
"""Streak over radius from which a blob counts as one; shorter ones are measured as discs."""
LONGEST_RADII = 26.0
"""A ball at 10 m/s that is exposed for 1/15 s moves about 23 radii."""
WIDTH_BAND = (0.78, 1.5)
"""Width of the blob over the ball's, between which it is a ball."""
LEAST_WAIST = 0.7
"""Least width of the blob between its round ends, over its width: two balls that touch have a waist."""
LEAST_FILL = 0.80
"""Least part of the capsule that the blob covers, and of the blob that the capsule covers."""


@dataclass(frozen=True, slots=True)
class Streaks:
    """K capsules, working px."""

    centre: FloatArray
    """(K, 2) middle of the streak: the place at mid-exposure."""
    vector: FloatArray
    """(K, 2) from one end's disc to the other's, sign unknown."""
    radius: FloatArray
    """(K,)"""
    fill: FloatArray
    """(K,) overlap of blob and capsule over their union."""


def find_streaks(moving: BoolArray, strength: Float32Array, view: View) -> Streaks:
    """Capsules among the blobs of what differs from both the cloth and the median picture, working px."""
    left, top, width, height = cv2.boundingRect(moving.astype(np.uint8))
    if width == 0:
        return _stacked([])
    window = slice(top, top + height), slice(left, left + width)
    moving, strength, rim = moving[window], strength[window], view.rim[window]
    count, labels, stats, _ = cv2.connectedComponentsWithStats(moving.astype(np.uint8), connectivity=8)
    beyond = set(labels[rim].tolist())
    least = 0.5 * np.pi * float(view.radius.min()) ** 2
    found = []
    for blob in range(1, count):
        x, y, w, h, area = (int(n) for n in stats[blob])
        if blob in beyond or area < least or max(w, h) > (LONGEST_RADII + 2) * float(view.radius.max()):
            continue
        inside = labels[y : y + h, x : x + w] == blob
        levels = np.where(inside, strength[y : y + h, x : x + w], 0)
        # Relative to the ball's own contrast, so that its shadow is left out.
        clear = inside & (levels > FAINT_SHARE * np.quantile(levels[inside], 0.9))
        capsule = _capsule(clear, np.array([left + x, top + y], dtype=float), view)
        if capsule is not None:
            found.append(capsule)
    return _stacked(found)


def _stacked(found: list[tuple[FloatArray, FloatArray, float, float]]) -> Streaks:
    if not found:
        return Streaks(np.empty((0, 2)), np.empty((0, 2)), np.empty(0), np.empty(0))
    centre, vector, radius, fill = (np.array(column) for column in zip(*found, strict=True))
    return Streaks(centre, vector, radius, fill)


def refine_streaks(rgb: ByteArray, rough: Streaks, basis: FloatArray) -> Streaks:
    """Middles and lengths in the whole picture, px: the two sides and the two ends, each at half its height."""
    fine = [_refined(rgb, *one, basis) for one in zip(*_columns(rough), strict=True)]
    return _stacked([one for one in fine if one is not None])


def _columns(streaks: Streaks) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    return streaks.centre, streaks.vector, streaks.radius, streaks.fill


def _refined(
    rgb: ByteArray, centre: FloatArray, vector: FloatArray, radius: float, fill: float, basis: FloatArray
) -> tuple[FloatArray, FloatArray, float, float] | None:
    """One streak in the whole picture; None where it is not the same from both ends, as a ball with its shadow."""
    length = float(np.linalg.norm(vector))
    along = vector / length
    across = np.array([-along[1], along[0]])
    u = np.arange(-length / 2 - 2.2 * radius, length / 2 + 2.2 * radius + 0.01, 0.5)
    v = np.arange(-2.0 * radius, 2.0 * radius + 0.01, 0.5)
    share = _share(rgb, centre + u[:, None, None] * along + v[:, None] * across, u, v, length, radius, basis)
    side = _crossings(share[np.abs(u) < max(0.3 * length, 0.4 * radius)].mean(axis=0), v, 0.5)
    ends = _crossings(share[:, np.abs(v) < 0.4 * radius].mean(axis=1), u, END_SHARE)
    if side is None or ends is None:
        return centre, vector, radius, fill
    core = share[:, np.abs(v) < 0.4 * radius].mean(axis=1)
    if _lopsided(core, u, sum(ends) / 2, length / 2 + radius) > MOST_LOPSIDED:
        return None
    # The ramp of an end is as long as the shorter of streak and ball; half a level of it is cut off.
    seen = ends[1] - ends[0]
    exposed = max(seen - 2 * radius + 2 * END_SHARE * min(length, 2 * radius), 0.0)
    moved = centre + along * sum(ends) / 2 + across * sum(side) / 2
    if np.linalg.norm(moved - centre) > 0.8 * radius or abs(exposed - length) > radius:
        return centre, vector, radius, fill
    return moved, along * exposed, radius, fill


def _lopsided(profile: FloatArray, at: FloatArray, middle: float, reach: float) -> float:
    """Mean difference of both halves of a profile (n,) about its middle, over its mean."""
    offsets = np.arange(0.0, reach, 0.5)
    before, after = np.interp(middle - offsets, at, profile), np.interp(middle + offsets, at, profile)
    return float(np.abs(before - after).mean() / max(float((before + after).mean()) / 2, 1e-9))


def _share(
    rgb: ByteArray, at: FloatArray, u: FloatArray, v: FloatArray, length: float, radius: float, basis: FloatArray
) -> FloatArray:
    """How much of the ball's colour (n, m) is mixed into the cloth's at px (n, m, 2)."""
    place = at.astype(np.float32)
    seen = cv2.remap(rgb, place[..., 0], place[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    colours = seen.astype(np.float64) @ basis.T
    inner = (np.abs(u) < length / 2)[:, None] & (np.abs(v) < 0.5 * radius)
    outer = (np.abs(v) > 1.5 * radius)[None] & np.ones(len(u), dtype=bool)[:, None]
    cloth = np.median(colours[outer], axis=0)
    ball = np.median(colours[inner], axis=0) - cloth
    mixed: FloatArray = (colours - cloth) @ ball / max(float(ball @ ball), 1e-9)
    return mixed


def _crossings(profile: FloatArray, at: FloatArray, level: float) -> tuple[float, float] | None:
    """Where a hump (n,) rises and falls through a share of its height."""
    high = profile > level * float(np.quantile(profile, 0.9))
    inside = np.flatnonzero(high)
    if not len(inside) or inside[0] == 0 or inside[-1] == len(profile) - 1:
        return None
    height = level * float(np.quantile(profile, 0.9))
    first, last = inside[0], inside[-1]
    rise = at[first - 1] + (height - profile[first - 1]) / (profile[first] - profile[first - 1]) * (at[1] - at[0])
    fall = at[last] + (profile[last] - height) / (profile[last] - profile[last + 1]) * (at[1] - at[0])
    return float(rise), float(fall)


def _capsule(blob: BoolArray, corner: FloatArray, view: View) -> tuple[FloatArray, FloatArray, float, float] | None:
    """The capsule of the expected width that covers a blob (h, w), None where it is another shape."""
    points = np.column_stack(np.nonzero(blob)[::-1]).astype(np.float64) + corner
    if len(points) < 12:
        return None
    middle = points.mean(axis=0)
    u, v = np.clip(np.rint(middle).astype(int), 0, np.array(view.radius.shape[::-1]) - 1)
    radius = float(view.radius[v, u])
    axes = np.linalg.eigh(np.cov((points - middle).T))[1]
    along, across = axes[:, 1], axes[:, 0]
    reach, width = _extent((points - middle) @ along), _extent((points - middle) @ across)
    length = (reach[1] - reach[0]) - (width[1] - width[0])
    ratio = (width[1] - width[0]) / (2 * radius)
    if length < LEAST_STRETCH * radius or not WIDTH_BAND[0] < ratio < WIDTH_BAND[1] or not view.centres[v, u]:
        return None
    if _waist((points - middle) @ along, reach, 2 * radius * ratio) < LEAST_WAIST:
        return None
    centre = middle + along * sum(reach) / 2 + across * sum(width) / 2
    fill = _overlap(points, centre, along * length, radius * ratio)
    return (centre, along * length, radius, fill) if fill > LEAST_FILL else None


def _waist(along: FloatArray, reach: tuple[float, float], width: float) -> float:
    """Least width between the round ends of points (n,) along the axis, over the width."""
    bins = np.arange(reach[0] + width / 2, reach[1] - width / 2 + 2.0, 2.0)
    if len(bins) < 2:
        return 1.0
    return float(np.histogram(along, bins)[0].min() / (2.0 * width))


def _extent(along: FloatArray) -> tuple[float, float]:
    """Both ends of points (n,), pixel edges included, single stray pixels left out."""
    low, high = np.quantile(along, (0.004, 0.996))
    return float(low) - 0.5, float(high) + 0.5


def _overlap(points: FloatArray, centre: FloatArray, vector: FloatArray, radius: float) -> float:
    """Intersection over union of pixels (n, 2) and a capsule."""
    length = float(np.linalg.norm(vector))
    at = points - centre
    along = np.clip(at @ vector / max(length, 1e-9), -length / 2, length / 2)
    beside = np.linalg.norm(at - along[:, None] * vector / max(length, 1e-9), axis=1)
    inside = float((beside < radius + 0.5).sum())
    area = np.pi * radius**2 + 2 * radius * length
    return inside / (area + len(points) - inside)
