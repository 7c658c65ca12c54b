"""The frames between the frames: originals untouched at their places, balls in between where the physics puts them."""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from models.fit import Fit
from models.scene import Scene
from models.tracks import Tracks
from video.clip import Clip, read_frames
from video.inbetween import Scenery, open_interval, scenery_of
from video.sightings import sight
from video.slowmotion import balls_at

Floats = NDArray[np.float64]
Picture = NDArray[np.uint8]

EVEN_S = 1e-3
"""s by which timestamps may wander and still be those of a constant rate: some containers count milliseconds."""


def between(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, factor: int) -> Iterator[Picture]:
    """The pictures (H, W, 3) of a clip with `factor` - 1 new ones in every gap: (D - 1) factor + 1 of D distinct ones.

    Every factor-th is the decoded picture itself. ValueError for a factor below 1.
    """
    if factor < 1:
        raise ValueError(f"a factor is 1 or more; got {factor}")
    scenery = scenery_of(sight(scene, tracks, fit), clip)
    before: Picture | None = None
    for row, (_, after) in enumerate(read_frames(clip, indices=scenery.sightings.frame), start=-1):
        if before is not None:
            yield before
            yield from _inside(scenery, row, before, after, factor)
        before = after
    if before is not None:
        yield before


def _inside(scenery: Scenery, row: int, first: Picture, second: Picture, factor: int) -> Iterator[Picture]:
    """The new pictures between those of `row` and `row + 1`."""
    sightings = scenery.sightings
    times = _inner_times(float(sightings.t[row]), float(sightings.t[row + 1]), factor)
    if not len(times):
        return
    interval = open_interval(sightings, scenery.plate, row, first, second, sharp=scenery.sharp)
    state, ways = sightings.state(times), sightings.ways(times, sightings.exposure)
    for k, t in enumerate(times):
        yield interval.at(float(t), balls_at(sightings, state, k, float(t)).centre, ways[k])


def times_between(clip: Clip, factor: int) -> Floats:
    """Times ((D - 1) factor + 1,) s of those pictures, by the source's clock."""
    t = clip.t[clip.distinct]
    inner = [np.array([a, *_inner_times(a, b, factor)]) for a, b in pairwise(t)]
    return np.concatenate([*inner, t[-1:]])


def even_rate(clip: Clip, factor: int) -> Fraction | None:
    """Pictures per second of the finished video where the distinct ones of the clip come evenly; None elsewhere."""
    frames = clip.distinct
    strides = np.diff(frames)
    if not len(strides) or (strides != strides[0]).any():
        return None
    rate = clip.rate / int(strides[0])
    even = clip.t[frames[0]] + np.arange(len(frames)) / float(rate)
    return rate * factor if np.abs(clip.t[frames] - even).max() < EVEN_S else None


def _inner_times(first: float, last: float, factor: int) -> Floats:
    """Times (factor - 1,) that divide a gap evenly."""
    return first + (last - first) * np.arange(1, factor) / factor
