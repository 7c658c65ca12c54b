"""Optical flow of the markings of a ball (dots, stripes and numbers) between two views, where the spin is unknown."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.flow.optical_flow import compute_flow, pixel_grid
from video.matting.ball_matting import MattedSprite, comparison_half_width
from video.matting.compositing import RotationWarp

MIN_VIEW_SIDE, MAX_MAGNIFICATION = 96, 4.0
"""px to which small balls are magnified before the flow is computed, and largest magnification: its patches are 8 px
wide."""
MAX_DIFFERENCE_SHARE = 0.9
"""Share of the difference between two views that an accepted flow may leave."""
MAX_FLOW_RADII = 0.8
"""Radii by which a dot may move between two views; farther dots are not identifiable."""
VISIBLE_RADII = 0.8
"""Radii around its centre within which a ball must be visible for a flow to be measured."""
SMOOTHING_RADII = 0.12
"""Radii over which the flow on a ball is averaged."""
TO_GREY = np.array([[0.299, 0.587, 0.114, 0.0], [0.0, 0.0, 0.0, 1.0]], dtype=np.float32)
"""Map from RGBA to brightness (ITU-R BT.601-7) times alpha, and alpha."""


@dataclass(frozen=True, slots=True)
class MarkingFlow:
    """Flow of the markings of a ball from one view to the next, and back."""

    forward: Float32Array
    """(g, g, 2) px, centred on the ball."""
    backward: Float32Array
    """(g, g, 2) px."""

    def warps_at(self, share: float) -> tuple[RotationWarp, RotationWarp]:
        """Return the warps of the view before and of the view after to a share of the gap, 0 to 1."""
        return RotationWarp(np.float32(share) * self.forward), RotationWarp(np.float32(1 - share) * self.backward)


def estimate_marking_flow(first: MattedSprite, second: MattedSprite, radius: float) -> MarkingFlow | None:
    """Estimate the flow of the markings of a ball from the first view to the second.

    None where the flow explains nothing: plain, blurred or occluded balls.
    """
    half = comparison_half_width(radius)
    magnification = float(np.clip(MIN_VIEW_SIDE / (2 * half + 1), 1.0, MAX_MAGNIFICATION))
    if not all(_is_fully_visible(sprite, half, radius) for sprite in (first, second)):
        return None
    views = [_magnify_view(sprite, half, magnification) for sprite in (first, second)]
    flows = []
    for a, b in (views, views[::-1]):
        flow = compute_flow(a, b)
        if not _reduces_difference(flow, a, b):
            return None
        flows.append(_shrink_flow(flow, half, magnification, radius))
    return MarkingFlow(flows[0], flows[1])


@lru_cache(maxsize=64)
def _magnify_view(sprite: MattedSprite, half: int, magnification: float) -> ImageArray:
    """Return a magnified grey view (n, n) of the ball on a background of its own mean brightness, which has no edge.

    Cached and read-only: a view is used for the gap before it and for the gap after it.
    """
    grey, mask = cv2.split(sprite.patch_around_centre(cv2.transform(sprite.rgba, TO_GREY), half, magnification))
    mask = np.clip(mask, 0, 1)
    mean = cv2.sumElems(grey)[0] / max(cv2.sumElems(mask)[0], 1.0)
    return np.asarray(cv2.add(grey, np.float32(mean) * (1 - mask), dtype=cv2.CV_8U), dtype=np.uint8)


def _is_fully_visible(sprite: MattedSprite, half: int, radius: float) -> bool:
    """Return whether the ball except its rim is visible, neither occluded by another ball nor cut by the border."""
    centre, within = sprite.centre_in_rgba, VISIBLE_RADII * radius
    rows, columns = sprite.visibility.shape
    inside = min(centre) >= within and centre[0] + within <= columns - 1 and centre[1] + within <= rows - 1
    if inside and sprite.occlusion is None:
        return True
    visibility = sprite.patch_around_centre(sprite.visibility, half)
    place = np.arange(2 * half + 1) - half
    return bool(visibility[np.hypot(place[None], place[:, None]) < within].min() >= 0.5)


def _reduces_difference(flow: Float32Array, first: ImageArray, second: ImageArray) -> bool:
    """Return whether sampling the second image along the flow makes it similar to the first."""
    side = first.shape[0]
    warped = cv2.remap(second, pixel_grid(side, side) + flow, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    left, before = (cv2.norm(first, other, cv2.NORM_L2SQR) for other in (warped, second))
    return bool(left < MAX_DIFFERENCE_SHARE * before)


def _shrink_flow(flow: Float32Array, half: int, magnification: float, radius: float) -> Float32Array:
    """Reduce a flow to the original size, smooth it, limit its length and fade it out at the rim."""
    side = 2 * half + 1
    small = cv2.resize(flow, (side, side), interpolation=cv2.INTER_AREA) / np.float32(magnification)
    smooth = cv2.GaussianBlur(small, (0, 0), max(SMOOTHING_RADII * radius, 0.5))
    length = cv2.magnitude(*cv2.split(smooth))
    place = np.arange(side, dtype=np.float32) - half
    rim = np.clip(2 - np.hypot(place[None], place[:, None]) / (0.6 * radius), 0, 1)
    damping = np.minimum(1, MAX_FLOW_RADII * radius / np.maximum(length, 1e-6)) * rim
    return np.asarray(smooth * damping[..., None], dtype=np.float32)
