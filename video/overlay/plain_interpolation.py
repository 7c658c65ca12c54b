"""The frames between the frames: originals untouched at their places, balls in between where the physics puts them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise

import numpy as np

from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.flow.optical_flow import Interpolator
from video.io.clip import Clip, read_frames
from video.matting.ball_timeline import sight
from video.overlay.ball_outlines import balls_at
from video.synthesis.frame_synthesis import OPTICAL_FLOW, Scenery, open_interval, scenery_of

EVEN_S = 1e-3
"""s by which timestamps may wander and still be those of a constant rate: some containers count milliseconds."""
SNAP = 0.02
"""Share of the step between pictures within which a real picture is shown as it is."""


@dataclass(frozen=True, slots=True)
class Making:
    """How pictures are made."""

    elsewhere: Interpolator = OPTICAL_FLOW
    """Of all that is no ball."""
    exposure: float | None = None
    """s for which the shutter is open; None: as it was filmed."""


def between(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit, factor: int) -> Iterator[ImageArray]:
    """The pictures (H, W, 3) of a clip with `factor` - 1 new ones in every gap: (D - 1) factor + 1 of D distinct ones.

    Every factor-th is the decoded picture itself. ValueError for a factor below 1.
    """
    times = times_between(clip, factor)
    yield from pictures_at(clip, scenery_of(sight(scene, tracks, fit), clip), times)


def pictures_at(clip: Clip, scenery: Scenery, times: FloatArray, making: Making | None = None) -> Iterator[ImageArray]:
    """The pictures (H, W, 3) at ascending times (K,) s within the clip; a decoded one itself at its time.

    Two decoded pictures are held at a time.
    """
    making = Making() if making is None else making
    t = scenery.sightings.t
    rows = np.clip(np.searchsorted(t, times, side="right") - 1, 0, max(len(t) - 2, 0))
    before: ImageArray | None = None
    for row, (_, after) in enumerate(read_frames(clip, indices=scenery.sightings.frame), start=-1):
        wanted = times[rows == row]
        if before is not None and len(wanted):
            yield from _inside(scenery, row, before, after, wanted, making)
        before = after


def _inside(
    scenery: Scenery, row: int, first: ImageArray, second: ImageArray, times: FloatArray, making: Making
) -> Iterator[ImageArray]:
    """The pictures from that of `row` to that of `row + 1`."""
    sightings = scenery.sightings
    ends = {float(sightings.t[row]): first, float(sightings.t[row + 1]): second}
    if all(float(t) in ends for t in times):
        yield from (ends[float(t)] for t in times)
        return
    anew = making.exposure is not None
    interval = open_interval(sightings, scenery.plate, row, first, second, making.elsewhere, scenery.sharp, anew=anew)
    exposure = sightings.exposure if making.exposure is None else making.exposure
    state, ways = sightings.state(times), sightings.ways(times, exposure)
    for t, balls, way in zip(times.tolist(), balls_at(sightings, state, times), ways, strict=True):
        yield ends[t] if t in ends else interval.at(t, balls.centre, way)


def times_between(clip: Clip, factor: int) -> FloatArray:
    """Times ((D - 1) factor + 1,) s that divide every gap evenly, by the source's clock; ValueError below 1."""
    if factor < 1:
        raise ValueError(f"a factor is 1 or more; got {factor}")
    t = clip.t[clip.distinct]
    inner = [np.array([a, *_inner_times(a, b, factor)]) for a, b in pairwise(t)]
    return np.concatenate([*inner, t[-1:]])


def even_times(clip: Clip, rate: float) -> FloatArray:
    """Times (K,) s, `rate` of them a second of the clip; those of real pictures where they fall on them."""
    real = clip.t[clip.distinct]
    times = real[0] + np.arange(int((real[-1] - real[0]) * rate + SNAP) + 1) / rate
    after = np.clip(np.searchsorted(real, times), 1, len(real) - 1)
    nearest = np.where(times - real[after - 1] < real[after] - times, real[after - 1], real[after])
    return np.asarray(np.where(np.abs(nearest - times) * rate < SNAP, nearest, times), dtype=np.float64)


def even_rate(clip: Clip, factor: int) -> Fraction | None:
    """Pictures per second of the finished video where the distinct ones of the clip come evenly; None elsewhere."""
    frames = clip.distinct
    strides = np.diff(frames)
    if not len(strides) or (strides != strides[0]).any():
        return None
    rate = clip.rate / int(strides[0])
    even = clip.t[frames[0]] + np.arange(len(frames)) / float(rate)
    return rate * factor if np.abs(clip.t[frames] - even).max() < EVEN_S else None


def _inner_times(first: float, last: float, factor: int) -> FloatArray:
    """Times (factor - 1,) that divide a gap evenly."""
    return first + (last - first) * np.arange(1, factor) / factor
