"""What is on a ball, dots and stripes and numbers, goes round with it between two sightings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.flow.optical_flow import flow_between, grid
from video.matting.ball_matting import Sprite, reach_around
from video.matting.compositing import Turned

LEAST_SIDE, LARGEST_TIMES = 96, 4.0
"""px to which small balls are magnified before the flow is sought, and at most so much: its patches are 8 px wide."""
LEAST_GAIN = 0.9
"""Share of the difference between two sightings that may be left for a turn to be believed."""
MOST_TURN = 0.8
"""Radii that a dot may go by between two sightings: further, nobody can tell it from another."""
SEEN_RADII = 0.8
"""Radii around its centre within which a ball must be seen for its turn to be told."""
SMOOTH = 0.12
"""Radii over which neighbouring ways on a ball are averaged."""
TO_GREY = np.array([[0.299, 0.587, 0.114, 0.0], [0.0, 0.0, 0.0, 1.0]], dtype=np.float32)
"""Of a cover: brightness (ITU-R BT.601-7) times mask, and mask."""


@dataclass(frozen=True, slots=True)
class Bends:
    """Ways of what is on a ball from one sighting to the next, and back."""

    there: Float32Array
    """(g, g, 2) px, the centre is the ball's."""
    back: Float32Array
    """(g, g, 2) px"""

    def looked_up(self, share: float) -> tuple[Turned, Turned]:
        """Where what shows at a share of the time, 0 to 1, lies in the sighting before and in that after."""
        return Turned(np.float32(share) * self.there), Turned(np.float32(1 - share) * self.back)


def bends_between(first: Sprite, second: Sprite, radius: float) -> Bends | None:
    """How what is on a ball goes from the first sighting to the second.

    None where turning the one into the other explains nothing: plain, blurred or hidden balls.
    """
    half = reach_around(radius)
    times = float(np.clip(LEAST_SIDE / (2 * half + 1), 1.0, LARGEST_TIMES))
    if not all(_is_seen(sprite, half, radius) for sprite in (first, second)):
        return None
    views = [_view(sprite, half, times) for sprite in (first, second)]
    bends = []
    for a, b in (views, views[::-1]):
        way = flow_between(a, b)
        if not _explains(way, a, b):
            return None
        bends.append(_small(way, half, times, radius))
    return Bends(bends[0], bends[1])


@lru_cache(maxsize=64)
def _view(sprite: Sprite, half: int, times: float) -> ImageArray:
    """(n, n) grey, magnified: the ball around its centre on a ground of its own mean brightness, which has no edge.

    Shared, not to be written into: a ball is seen once for the way to it and once for the way on.
    """
    grey, mask = cv2.split(sprite.around(cv2.transform(sprite.cover, TO_GREY), half, times))
    mask = np.clip(mask, 0, 1)
    mean = cv2.sumElems(grey)[0] / max(cv2.sumElems(mask)[0], 1.0)
    return np.asarray(cv2.add(grey, np.float32(mean) * (1 - mask), dtype=cv2.CV_8U), dtype=np.uint8)


def _is_seen(sprite: Sprite, half: int, radius: float) -> bool:
    """Whether the ball is seen but for its rim, and neither another ball nor the border hides any of it."""
    centre, within = sprite.in_cover, SEEN_RADII * radius
    rows, columns = sprite.seen.shape
    inside = min(centre) >= within and centre[0] + within <= columns - 1 and centre[1] + within <= rows - 1
    if inside and sprite.hidden is None:
        return True
    seen = sprite.around(sprite.seen, half)
    place = np.arange(2 * half + 1) - half
    return bool(seen[np.hypot(place[None], place[:, None]) < within].min() >= 0.5)


def _explains(way: Float32Array, first: ImageArray, second: ImageArray) -> bool:
    """True where looking the second picture up along the way makes it like the first."""
    side = first.shape[0]
    turned = cv2.remap(second, grid(side, side) + way, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    left, before = (cv2.norm(first, other, cv2.NORM_L2SQR) for other in (turned, second))
    return bool(left < LEAST_GAIN * before)


def _small(way: Float32Array, half: int, times: float, radius: float) -> Float32Array:
    side = 2 * half + 1
    small = cv2.resize(way, (side, side), interpolation=cv2.INTER_AREA) / np.float32(times)
    smooth = cv2.GaussianBlur(small, (0, 0), max(SMOOTH * radius, 0.5))
    length = cv2.magnitude(*cv2.split(smooth))
    place = np.arange(side, dtype=np.float32) - half
    rim = np.clip(2 - np.hypot(place[None], place[:, None]) / (0.6 * radius), 0, 1)
    kept = np.minimum(1, MOST_TURN * radius / np.maximum(length, 1e-6)) * rim
    return np.asarray(smooth * kept[..., None], dtype=np.float32)
