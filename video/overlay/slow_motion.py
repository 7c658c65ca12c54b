"""The annotated slow motion of a shot, and its still."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path

import numpy as np

from models.core.fit_result import Fit
from models.core.progress import Progress, silent
from models.core.tracks import Tracks
from models.core.typing import FloatArray, ImageArray
from video.io.clip import Clip, read_frames
from video.io.options import RenderOptions
from video.io.prefetch import ahead
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import Sightings
from video.overlay.annotation import EIGHTFOLD, Annotation, annotate
from video.overlay.ball_outlines import balls_at
from video.overlay.frame_overlay import Balls
from video.overlay.motion_marks import marks_of
from video.overlay.poster import render_poster
from video.overlay.replays import chosen_marks, replay_times, replays
from video.synthesis.frame_synthesis import Interval, Scenery, open_interval

__all__ = ["RenderOptions", "render_poster", "render_slow_motion"]

Onlooker = Callable[[int, ImageArray], None]

LEAST_RATE, MOST_RATE = Fraction(25), Fraction(60)
"""1/s, pictures per second of the finished video."""
LEAD = 0.5
"""s of the shot kept before the first and after the last motion when still parts are trimmed."""
AHEAD = 8
"""Pictures that may wait to be drawn upon, and as many to be written."""
SLOW_TUNING, TUNED_FROM = "me=dia:subme=0:cabac=0", 4.0
"""Of x264: from so many times slower on, all goes by a pixel or so between pictures, which needs no wide search, nor a
fine one; and so little is left to be coded that arithmetic coding saves 7 % of the bytes for 12 % of the work."""
CRF = 26
"""Quality that x264 keeps to. At 8 times slower cloth keeps its grain, and the error is nearly that of 20 with a tree
of blocks, which the writer goes without."""
THREADS = 1
"""Of the encoder, which runs beside those that make and draw: two would wait for each other, an eighth of its work."""
KEY_S = 2.0
"""s between pictures that are coded whole: a quarter of a second of a shot that is shown eight times slower."""
AT_ONCE = 256
"""Times for which the balls are looked up together: asked for one by one they take ten times as long."""
SNAP = 0.05
"""Share of the step between finished pictures within which a real picture is shown as it is."""


def unseen(row: int, picture: ImageArray) -> None:
    """An onlooker who does not look."""


@dataclass(frozen=True, slots=True)
class _Made:
    """A picture of the slow motion before anything is drawn upon it, and the balls on it."""

    t: float
    picture: ImageArray
    balls: Balls
    plan: FloatArray
    """(N, 2) m"""


def render_slow_motion(
    clip: Clip,
    scenery: Scenery,
    tracks: Tracks,
    fit: Fit,
    path: Path,
    options: RenderOptions = EIGHTFOLD,
    progress: Progress = silent,
    onlooker: Onlooker = unseen,
) -> float:
    """Write the annotated slow motion to `path` as H.264, at the clip's rate held within 25 to 60 pictures a second.

    An umpire sees every contact once more afterwards. The `onlooker` is shown every real picture, not to be written
    into, and its row. Returns the time of the clip, s, that the first picture of the slow motion shows.
    """
    rate = min(max(clip.rate, LEAST_RATE), MOST_RATE)
    times = _times(scenery.sightings, rate, options)
    preset = "ultrafast" if options.quick else "veryfast"
    tuning = SLOW_TUNING if options.slow >= TUNED_FROM and not options.quick else ""
    marks = chosen_marks(marks_of(scenery.sightings, fit)) if options.style == "umpire" else []
    again = sum(len(replay_times(scenery.sightings, mark, float(rate), options.slow)) for mark in marks)
    with VideoWriter(
        path, clip.width, clip.height, rate, crf=CRF, preset=preset, tuning=tuning, threads=THREADS, key_s=KEY_S
    ) as writer:
        shot = _pictures(clip, scenery, tracks, fit, times, options, onlooker)
        closer = replays(clip, scenery, marks, float(rate), options.slow) if marks else iter(())
        for done, picture in enumerate(ahead(chain(shot, closer), AHEAD), start=1):
            writer.write(picture)
            progress(done / (len(times) + again))
    return float(times[0])


def _times(sightings: Sightings, rate: Fraction, options: RenderOptions) -> FloatArray:
    """Times (K,) s of the clip that the finished pictures show, exactly even; real pictures are met where they fall."""
    first, last = float(sightings.t[0]), float(sightings.t[-1])
    if options.trim_still and sightings.moves.any():
        rows = np.flatnonzero(sightings.moves.any(axis=1))
        first = max(first, float(sightings.t[rows[0]]) - LEAD)
        last = min(last, float(sightings.t[rows[-1] + 1]) + LEAD)
    step = 1 / (float(rate) * options.slow)
    times = np.asarray(first + step * np.arange(int((last - first) / step + SNAP) + 1), dtype=np.float64)
    nearest = sightings.t[np.clip(np.searchsorted(sightings.t, times), 0, len(sightings.t) - 1)]
    before = sightings.t[np.clip(np.searchsorted(sightings.t, times) - 1, 0, None)]
    nearest = np.where(np.abs(before - times) < np.abs(nearest - times), before, nearest)
    return np.where(np.abs(nearest - times) < SNAP * step, nearest, times)


def _pictures(
    clip: Clip,
    scenery: Scenery,
    tracks: Tracks,
    fit: Fit,
    times: FloatArray,
    options: RenderOptions,
    onlooker: Onlooker,
) -> Iterator[ImageArray]:
    """The finished pictures in order: drawn upon while those after them are made."""
    annotation: Annotation | None = None
    for made in ahead(_made(clip, scenery, fit, times, onlooker), AHEAD):
        annotation = annotation or annotate(scenery.sightings, tracks, fit, made.picture, options.slow, options.style)
        annotation.draw(made.picture, made.t, made.balls, made.plan)
        yield made.picture


def _made(clip: Clip, scenery: Scenery, fit: Fit, times: FloatArray, onlooker: Onlooker) -> Iterator[_Made]:
    """The pictures in order, two real ones held at a time."""
    sightings = scenery.sightings
    rows, _ = sightings.places(times)
    count = np.bincount(rows, minlength=len(sightings.t))
    moments = _moments(sightings, fit, times)
    before: ImageArray | None = None
    interval: Interval | None = None
    for row, (_, after) in enumerate(read_frames(clip, indices=sightings.frame), start=-1):
        onlooker(row + 1, after)
        if before is not None and count[row]:
            interval = open_interval(sightings, scenery.plate, row, before, after, sharp=scenery.sharp, before=interval)
            for t, balls, way, plan in islice(moments, int(count[row])):
                yield _Made(t, interval.at(t, balls.centre, way), balls, plan)
        before = after


def _moments(
    sightings: Sightings, fit: Fit, times: FloatArray
) -> Iterator[tuple[float, Balls, FloatArray, FloatArray]]:
    """Time, balls, their ways (P, N, 2) px while the shutter is open, and their places (N, 2) m; many at a time."""
    for start in range(0, len(times), AT_ONCE):
        t = times[start : start + AT_ONCE]
        balls = balls_at(sightings, sightings.state(t), t)
        ways, plan = sightings.ways(t, sightings.exposure), fit.trajectory.at(t).xy
        yield from zip(t.tolist(), balls, ways, plan, strict=True)
