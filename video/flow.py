"""What moves and is no ball, between two pictures: optical flow both ways, with occlusions, where something moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

Picture = NDArray[np.uint8]
Singles = NDArray[np.float32]
Mask = NDArray[np.bool_]
Between = Callable[[float], Picture]
"""The picture (h, w, 3) at a share of the time, 0 to 1, from the first to the second."""

STEPS = 2
"""Repeats of looking the flow up where it leads: after two, ways are within a tenth of a pixel but at edges."""
AGREEMENT = 10.0
"""Levels of 255 between the two ends of a way beyond which it is not believed to be one thing that moved."""
WINDOW = 7
"""px over which the two ends of a way are compared."""


class Interpolator(Protocol):
    """Makes pictures between two. Balls that move are taken out before, and put in by the physics afterwards."""

    def open(self, first: Picture, second: Picture) -> Between:
        """Prepare two pictures (h, w, 3) of one size; parts of a picture may be given, of any size above 32 px."""


@dataclass(frozen=True, slots=True)
class Blend:
    """One picture over the other."""

    def open(self, first: Picture, second: Picture) -> Between:
        """Weights alone."""
        return lambda share: np.asarray(cv2.addWeighted(first, 1 - share, second, share, 0), dtype=np.uint8)


@dataclass(frozen=True, slots=True)
class OfFunction:
    """Any function of two pictures (h, w, 3) and a share 0 to 1."""

    function: Callable[[Picture, Picture, float], Picture]

    def open(self, first: Picture, second: Picture) -> Between:
        """The function with its two pictures."""
        return lambda share: self.function(first, second, share)


@dataclass(frozen=True, slots=True)
class OpticalFlow:
    """Dense inverse search (Kroeger et al. 2016, doi:10.1007/978-3-319-46493-0_29) both ways.

    A pixel of the new picture has three candidate ways: that of the flow forwards, backwards, and none. Of each, the
    colours at both ends are compared over a small window; the way whose ends agree best is taken. Where none agrees,
    something is covered or uncovered, and the side from which the pixel is reached and returned to is taken alone.
    """

    preset: int = cv2.DISOPTICAL_FLOW_PRESET_MEDIUM

    def open(self, first: Picture, second: Picture) -> Between:
        """Find both flows, once for all shares."""
        grey = [np.asarray(cv2.cvtColor(picture, cv2.COLOR_RGB2GRAY)) for picture in (first, second)]
        there, back = (flow_between(a, b, self.preset) for a, b in (grey, grey[::-1]))
        return _Opened((first, second), there, back, _grid(*grey[0].shape)).at


@dataclass(frozen=True, slots=True)
class _Opened:
    pictures: tuple[Picture, Picture]
    there: Singles
    """(h, w, 2) px, from the first picture to the second."""
    back: Singles
    grid: Singles

    def at(self, share: float) -> Picture:
        ways = (self._way(self.there, share), np.negative(self._way(self.back, 1 - share)), None)
        first, second, cost = self._taken(ways[0], share)
        for way in ways[1:]:
            *others, other_cost = self._taken(way, share)
            nearer = (other_cost < cost)[..., None]
            first, second = np.where(nearer, others[0], first), np.where(nearer, others[1], second)
            cost = np.minimum(cost, other_cost)
        return self._mixed(first, second, cost, share)

    def _way(self, flow: Singles, share: float) -> Singles:
        """(h, w, 2) px over the whole gap of what passes each pixel at a share of it, from where the flow begins."""
        way = flow
        for _ in range(STEPS):
            way = _looked_up(flow, self.grid - np.float32(share) * way)
        return way

    def _taken(self, way: Singles | None, share: float) -> tuple[Picture, Picture, Singles]:
        """The colours at both ends of a way, and how far they differ."""
        first, second = self.pictures
        if way is not None:
            first = _picture_at(first, self.grid - np.float32(share) * way)
            second = _picture_at(second, self.grid + np.float32(1 - share) * way)
        apart = np.asarray(cv2.absdiff(first, second)).max(axis=2).astype(np.float32)
        cost = np.asarray(cv2.blur(apart, (WINDOW, WINDOW)), dtype=np.float32)
        return first, second, cost + np.float32(way is None)

    def _mixed(self, first: Picture, second: Picture, cost: Singles, share: float) -> Picture:
        weight = np.float32(share) + np.zeros_like(cost)
        # where the ends disagree, the nearer picture is right more often than a mixture
        sure = np.clip(cost / AGREEMENT - 1, 0, 1)
        hard = np.float32(_stepped(share))
        weight += (hard - weight) * sure
        mixed = first + (second.astype(np.float32) - first) * weight[..., None]
        return np.asarray(np.rint(mixed), dtype=np.uint8)


def _stepped(share: float) -> float:
    """A share that passes quickly through the middle."""
    x = float(np.clip((share - 0.3) / 0.4, 0, 1))
    return x * x * (3 - 2 * x)


def _grid(height: int, width: int) -> Singles:
    """(h, w, 2) px, every pixel's own place."""
    return np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1).astype(np.float32)


def _looked_up(values: Singles, where: Singles) -> Singles:
    looked = cv2.remap(values, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.float32)


def _picture_at(picture: Picture, where: Singles) -> Picture:
    looked = cv2.remap(picture, where, None, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(looked, dtype=np.uint8)


def flow_between(first: Picture, second: Picture, preset: int = cv2.DISOPTICAL_FLOW_PRESET_MEDIUM) -> Singles:
    """Dense ways (h, w, 2) px from one grey picture to another."""
    search = cv2.DISOpticalFlow.create(preset)
    return np.asarray(search.calc(first, second, np.zeros((*first.shape, 2), dtype=np.float32)), dtype=np.float32)
