"""What moves and is no ball, between two pictures: optical flow both ways, with occlusions, where something moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Protocol

import cv2
import numpy as np

from models.core.typing import Float32Array, ImageArray
from video.flow.ticker import crawling_ways, with_crawls

Between = Callable[[float], ImageArray]
"""The picture (h, w, 3) at a share of the time, 0 to 1, from the first to the second."""

STEPS = 2
"""Repeats of looking the flow up where it leads: after two, ways are within a tenth of a pixel but at edges."""
AGREEMENT = 10.0
"""Levels of 255 between the two ends of a way beyond which it is not believed to be one thing that moved."""
WINDOW = 5
"""px, of pictures half as large, over which the two ends of a way are compared."""
PATCH_STRIDE, DESCENTS, REFINEMENTS = 4, 16, 1
"""Of the dense inverse search: half the work of OpenCV's medium preset, and as good on hands and cues."""
WIDE = 4
SHRUNK_FROM = ((WIDE, 288), (2, 96))
"""By what the sides of a picture are divided, and from how many px of the shorter one on."""
ALL_COLOURS = np.array([[0.5, 0.5, 0.5]], dtype=np.float32)
"""Differences of the three colours to one number: their mean is less than what the eye sees in one of them."""


class Interpolator(Protocol):
    """Makes pictures between two. Balls that move are taken out before, and put in by the physics afterwards."""

    def open(self, first: ImageArray, second: ImageArray) -> Between:
        """Prepare two pictures (h, w, 3) of one size; parts of a picture may be given, of any size above 32 px."""


@dataclass(frozen=True, slots=True)
class Blend:
    """One picture over the other."""

    def open(self, first: ImageArray, second: ImageArray) -> Between:
        """Weights alone."""
        return lambda share: np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class OfFunction:
    """Any function of two pictures (h, w, 3) and a share 0 to 1."""

    function: Callable[[ImageArray, ImageArray, float], ImageArray]

    def open(self, first: ImageArray, second: ImageArray) -> Between:
        """The function with its two pictures."""
        return lambda share: self.function(first, second, share)


@dataclass(frozen=True, slots=True)
class OpticalFlow:
    """Dense inverse search (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29) both ways.

    A pixel of the new picture has two candidate ways: that of the flow forwards and that backwards. Of each, the
    colours at both ends are compared over a small window; the way whose ends agree better counts more. In wide boxes
    it is taken alone: that costs half. Where none agrees, something is covered or uncovered, and the nearer picture
    is taken.
    """

    def open(self, first: ImageArray, second: ImageArray) -> Between:
        """Find both flows, once for all shares, in half the size or a quarter: its fields are smooth."""
        height, width = first.shape[:2]
        shrink = next((by for by, least in SHRUNK_FROM if min(height, width) >= least), 1)
        size = (-(-width // shrink), -(-height // shrink))
        small = tuple(_resized(picture, size) for picture in (first, second))
        grey = [np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY), dtype=np.uint8) for picture in small]
        grids, finest = (grid(height, width), grid(*grey[0].shape)), max(2 - shrink, 0)
        a, b = grey
        ways = crawling_ways(a, b)
        there = with_crawls(flow_between(a, b, finest), a, b, ways, grids[1])
        back = with_crawls(flow_between(b, a, finest), b, a, [-way for way in ways], grids[1])
        return _Opened((first, second), (small[0], small[1]), there, back, *grids, wide=shrink == WIDE).at


@dataclass(frozen=True, slots=True)
class _Opened:
    pictures: tuple[ImageArray, ImageArray]
    small: tuple[ImageArray, ImageArray]
    """The same, half as large: there, ways are weighed against each other."""
    there: Float32Array
    """(h, w, 2) px of the small pictures, from the first to the second."""
    back: Float32Array
    grid: Float32Array
    small_grid: Float32Array
    wide: bool = False

    def at(self, share: float) -> ImageArray:
        there, back = self._way(self.there, share), np.negative(self._way(self.back, 1 - share))
        costs = self._cost(there, share), self._cost(back, share)
        if self.wide:
            way = np.where((costs[1] < costs[0])[..., None], back, there)
            return self._mixed(way, np.minimum(*costs), share)
        first, second = self._mixed(there, costs[0], share), self._mixed(back, costs[1], share)
        agree = [1 / (cost + 1) ** 2 for cost in costs]
        weight = cv2.resize(agree[0] / (agree[0] + agree[1]), (self.grid.shape[1], self.grid.shape[0]))
        return np.asarray(cv2.blendLinear(first, second, weight, 1 - weight), dtype=np.uint8)

    def _way(self, flow: Float32Array, share: float) -> Float32Array:
        """(h, w, 2) px over the whole gap of what passes each pixel at a share of it, from where the flow begins."""
        way = flow
        for _ in range(STEPS):
            way = _looked_up(flow, self.small_grid - np.float32(share) * way)
        return way

    def _cost(self, way: Float32Array, share: float) -> Float32Array:
        """(h, w) levels by which the colours at both ends of a way differ, around each pixel."""
        first = _picture_at(self.small[0], self.small_grid - np.float32(share) * way)
        second = _picture_at(self.small[1], self.small_grid + np.float32(1 - share) * way)
        apart = cv2.transform(cv2.absdiff(first, second), ALL_COLOURS)
        return np.asarray(cv2.blur(apart, (WINDOW, WINDOW)), dtype=np.float32)

    def _mixed(self, way: Float32Array, cost: Float32Array, share: float) -> ImageArray:
        """Both pictures along the way; where its ends disagree, the nearer one: right more often than a mixture."""
        height, width = self.grid.shape[:2]
        shrink = np.array([width / way.shape[1], height / way.shape[0]], dtype=np.float32)
        wide = np.asarray(cv2.resize(way * shrink, (width, height)), dtype=np.float32)
        first = _picture_at(self.pictures[0], self.grid - np.float32(share) * wide)
        second = _picture_at(self.pictures[1], self.grid + np.float32(1 - share) * wide)
        sure = np.clip(cost / np.float32(AGREEMENT) - 1, 0, 1)
        weight = share + np.float32(_stepped(share) - share) * cv2.resize(sure, (width, height))
        weight = np.asarray(weight, dtype=np.float32)
        return np.asarray(cv2.blendLinear(first, second, 1 - weight, weight), dtype=np.uint8)


def _stepped(share: float) -> float:
    """A share that passes quickly through the middle."""
    x = float(np.clip((share - 0.3) / 0.4, 0, 1))
    return x * x * (3 - 2 * x)


@lru_cache(maxsize=512)
def grid(height: int, width: int) -> Float32Array:
    """(h, w, 2) px, every pixel's own place; shared, not to be written into."""
    places = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)
    places.setflags(write=False)
    return places


def _looked_up(values: Float32Array, where: Float32Array) -> Float32Array:
    looked = cv2.remap(values, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.float32)


def _picture_at(picture: ImageArray, where: Float32Array) -> ImageArray:
    looked = cv2.remap(picture, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.uint8)


def _resized(picture: ImageArray, size: tuple[int, int]) -> ImageArray:
    return np.asarray(cv2.resize(picture, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def flow_between(first: ImageArray, second: ImageArray, finest: int = 1) -> Float32Array:
    """Dense ways (h, w, 2) px from one grey picture to another; found down to a size of 2^-finest."""
    search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    search.setFinestScale(finest)
    search.setPatchStride(PATCH_STRIDE)
    search.setGradientDescentIterations(DESCENTS)
    search.setVariationalRefinementIterations(REFINEMENTS)
    return np.asarray(search.calc(first, second, np.zeros((*first.shape, 2), dtype=np.float32)), dtype=np.float32)
