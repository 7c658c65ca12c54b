"""Annotated slow motion of a shot."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, islice
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from models.core.fit_result import Fit
from models.core.progress import Progress, ignore_progress
from models.core.tracks import Tracks
from models.core.trajectory import State
from models.core.typing import FloatArray, ImageArray
from video.drawing.masks import draw_ring, drawing_scale
from video.drawing.palette import MUTED_GREY, WHITE
from video.io.clip import Clip, read_frames
from video.io.video_options import RenderOptions
from video.io.video_writer import VideoWriter
from video.io.yuv_frame import Canvas, YuvFrame
from video.matting.ball_timeline import BallTimeline, read_rows
from video.overlay.annotation import DEFAULT_OPTIONS, prepare_annotation
from video.overlay.close_up import magnify_image
from video.overlay.frame_overlay import FrameBalls, Label, keep_balls_on_top
from video.overlay.motion_paths import MIN_SPEED, ContactMark, select_contact_marks
from video.synthesis.frame_synthesis import ClipAppearance, FrameInterval, prepare_interval

# Limits of the frame rate of the output video, 1/s.
MIN_RATE, MAX_RATE = Fraction(25), Fraction(60)
# s of the shot kept before the first and after the last motion when still parts are trimmed.
TRIM_MARGIN_S = 0.5
# Frames that may wait for their annotation.
PREFETCHED_FRAMES = 8
# x264 options, and the slowdown from which they apply: motion is then about a pixel per frame, which needs neither a
# wide nor a fine search, and arithmetic coding would save 7 % of the bytes for 12 % of the work. A constant quantizer
# needs no look ahead at coming frames, a third of the work: neighbouring frames of a slow motion are equally complex.
# With 19, frames are closer to what was drawn than with `CRF`, on clips without and with grain.
SLOW_TUNING, TUNING_MIN_SLOWDOWN = "me=dia:subme=0:cabac=0:qp=19:scenecut=0:weightp=0:rc-lookahead=0", 4.0
# Constant rate factor of x264 below that slowdown. At 8 times slower, cloth keeps its grain, and the error is close to
# that of 20 with macroblock-tree rate control, which the writer disables.
CRF = 26
# Threads of the encoder: it returns at once, so that one frame is encoded while the next is drawn.
ENCODER_THREADS = 2
# s between keyframes: a quarter of a second of a shot that is eight times slower.
KEYFRAME_INTERVAL_S = 2.0
# Times for which the balls are evaluated together: single evaluations take ten times as long.
TIMES_PER_LOOKUP = 256
# Share of the output frame interval within which a decoded frame replaces a synthesized one.
SNAP_SHARE = 0.05


@dataclass(frozen=True, slots=True)
class SynthesizedFrame:
    """A frame of the slow motion before annotation, and the balls on it."""

    t: float
    canvas: Canvas
    balls: FrameBalls
    table_positions: FloatArray
    """(N, 2) m."""

    @property
    def image(self) -> ImageArray:
        """The frame in RGB (H, W, 3); not for those in planes."""
        assert not isinstance(self.canvas, YuvFrame)
        return self.canvas


def render_slow_motion(
    clip: Clip,
    appearance: ClipAppearance,
    tracks: Tracks,
    fit: Fit,
    path: Path,
    options: RenderOptions = DEFAULT_OPTIONS,
    progress: Progress = ignore_progress,
) -> None:
    """Write the annotated slow motion of a shot as H.264; the umpire style appends replays of the contacts.

    Args:
        appearance: Its estimated appearance.
        tracks: Tracks of the balls.
        fit: Fitted motion and events.
        path: Output file; its frame rate is that of the clip, limited to 25 to 60 frames per second.
        options: Slowdown, style and quality.
        progress: Function that receives the finished share.
    """
    rate, times = find_output_rate(clip), find_output_times(clip, appearance.timeline, options)
    marks = select_replay_marks(select_contact_marks(appearance.timeline, fit)) if options.style == "umpire" else []
    again = sum(len(replay_times(appearance.timeline, mark, float(rate), options.slow)) for mark in marks)
    (first,) = (image for _, image in read_frames(clip, indices=appearance.timeline.frame[:1]))
    annotation = prepare_annotation(appearance.timeline, tracks, fit, first, options.slow, options.style)
    in_planes = clip.width % 2 == clip.height % 2 == 0  # else the last chroma would cover half a pixel
    frames = prefetch_items(synthesize_frames(clip, appearance, times, in_planes=in_planes), PREFETCHED_FRAMES)
    shot = (annotation.draw(frame.canvas, frame.t, frame.balls, frame.table_positions) for frame in frames)
    closer = map(annotation.extend, render_replays(clip, appearance, marks, float(rate), options.slow))
    size = (clip.width, clip.height + annotation.strip_height)
    encode_slow_motion(chain(shot, closer), len(times) + again, path, size, rate, options, progress)


def encode_slow_motion(
    images: Iterable[Canvas], count: int, path: Path, size: tuple[int, int], rate: Fraction, options: RenderOptions,
    progress: Progress,
) -> None:  # fmt: skip
    """Encode the frames of a slow motion of a shot or a rally as H.264.

    Args:
        images: The annotated frames.
        count: Their number.
        size: Width and height, px.
        rate: Frame rate, 1/s.
    """
    is_tuned = options.slow >= TUNING_MIN_SLOWDOWN and not options.quick
    with VideoWriter(
        path, *size, rate, crf=CRF, preset="ultrafast" if options.quick else "veryfast",
        tuning=SLOW_TUNING if is_tuned else "", threads=ENCODER_THREADS, key_s=KEYFRAME_INTERVAL_S,
    ) as writer:  # fmt: skip
        for done, image in enumerate(images, start=1):
            writer.write(image)
            progress(done / count)


def find_output_rate(clip: Clip) -> Fraction:
    """Return the frame rate of the slow motion, 1/s."""
    return min(max(clip.fps, MIN_RATE), MAX_RATE)


def find_output_times(clip: Clip, timeline: BallTimeline, options: RenderOptions) -> FloatArray:
    """Find the times in the clip of the frames of the slow motion.

    Args:
        timeline: Positions of its balls.
        options: Slowdown, and whether still parts are left out.

    Returns:
        (K,) s, exactly regular, except that a decoded frame is used where it nearly coincides.
    """
    rows = np.flatnonzero(timeline.moving.any(axis=1))
    motion = (float(timeline.t[rows[0]]), float(timeline.t[rows[-1] + 1])) if len(rows) else None
    return space_output_times(clip, timeline.t, motion, options)


def space_output_times(
    clip: Clip, t: FloatArray, motion: tuple[float, float] | None, options: RenderOptions
) -> FloatArray:
    """Space the times (K,), s, of the frames of a slow motion; close to a frame at `t` (T,), its time is used.

    Args:
        motion: s, first and last motion, around which still parts are left out where the options say so.
    """
    first, last, step = float(t[0]), float(t[-1]), 1 / (float(find_output_rate(clip)) * options.slow)
    if options.trim_still and motion is not None:
        first, last = max(first, motion[0] - TRIM_MARGIN_S), min(last, motion[1] + TRIM_MARGIN_S)
    times = np.asarray(first + step * np.arange(int((last - first) / step + SNAP_SHARE) + 1), dtype=np.float64)
    nearest = t[np.clip(np.searchsorted(t, times), 0, len(t) - 1)]
    before = t[np.clip(np.searchsorted(t, times) - 1, 0, None)]
    nearest = np.where(np.abs(before - times) < np.abs(nearest - times), before, nearest)
    return np.where(np.abs(nearest - times) < SNAP_SHARE * step, nearest, times)


def synthesize_frames(
    clip: Clip,
    appearance: ClipAppearance,
    times: FloatArray,
    shutter_time: float | None = None,
    *,
    in_planes: bool = False,
) -> Iterator[SynthesizedFrame]:
    """Yield frames at ascending times within the clip; at most two decoded frames are held in memory.

    Args:
        appearance: Its estimated appearance.
        times: Times of the frames (K,), s; at the time of a decoded frame its image is a copy of that.
        shutter_time: s for which the shutter is open; None: as filmed.
        in_planes: Whether the frames are for the encoder, else they are images in RGB.
    """
    timeline = appearance.timeline
    rows, _ = timeline.locate_times(times)
    count = np.bincount(rows, minlength=len(timeline.t))
    moments = _iterate_ball_states(timeline, times, timeline.shutter_time if shutter_time is None else shutter_time)
    before: ImageArray | None = None
    interval: FrameInterval | None = None
    for row, after in read_rows(clip, timeline, np.unique([rows, np.minimum(rows + 1, len(timeline.t) - 1)])):
        if before is not None:
            decoded = {float(timeline.t[row - 1]): before, float(timeline.t[row]): after}
            for t, balls, streak, plan in islice(moments, int(count[row - 1])):
                if t not in decoded and (interval is None or interval.row != row - 1):
                    interval = prepare_interval(
                        timeline, appearance.plate, row - 1, before, after, appearance.sharp_balls,
                        force_deblur=shutter_time is not None, previous=interval,
                    )  # fmt: skip
                canvas: Canvas
                if t in decoded or interval is None:
                    canvas = YuvFrame.from_rgb(decoded[t]) if in_planes else decoded[t].copy()
                else:
                    synthesize = interval.synthesize_planes if in_planes else interval.synthesize
                    canvas = synthesize(t, balls.centre, streak)
                yield SynthesizedFrame(t, canvas, balls, plan)
        before = after


def _iterate_ball_states(
    timeline: BallTimeline, times: FloatArray, shutter_time: float
) -> Iterator[tuple[float, FrameBalls, FloatArray, FloatArray]]:
    """Yield time, balls, their streaks (P, N, 2) px and their positions (N, 2) m; many times are evaluated at once."""
    for start in range(0, len(times), TIMES_PER_LOOKUP):
        t = times[start : start + TIMES_PER_LOOKUP]
        balls = balls_at_times(timeline, timeline.state_at(t), t)
        streaks, plan = timeline.streak_paths(t, shutter_time), timeline.trajectory.at(t).xy
        yield from zip(t.tolist(), balls, streaks, plan, strict=True)


T = TypeVar("T")

_END: Any = object()


def prefetch_items(items: Iterator[T], max_ahead: int) -> Iterator[T]:
    """Iterate in a background thread that is at most `max_ahead` results ahead of the consumer.

    This helps where the time goes into code that releases the GIL: decoding, image processing, encoding.

    Args:
        items: the iterator to run.
        max_ahead: largest number of results that wait for the consumer.

    Yields:
        The results in their order. An exception is raised where the result would have been.
    """
    pending: deque[Future[T]] = deque()
    with ThreadPoolExecutor(1, "ahead") as pool:
        try:
            pending.extend(pool.submit(next, items, _END) for _ in range(max_ahead))
            while (item := pending.popleft().result()) is not _END:
                pending.append(pool.submit(next, items, _END))
                yield item
        finally:
            for future in pending:
                future.cancel()


# Slowdown relative to the slow motion before.
REPLAY_SLOWDOWN = 4.0
# s of the output video for each contact, at most.
MAX_REPLAY_S = 2.5
# Contacts that are replayed: the strongest ones.
MAX_REPLAYS = 8
# Ball radii from the middle to the upper border of the view.
AROUND_RADII = 7.0


def select_replay_marks(marks: tuple[ContactMark, ...]) -> list[ContactMark]:
    """Select the strongest marks, sure ones first, in order of time."""
    strongest = sorted(marks, key=lambda mark: (-mark.opacity, -mark.strength, mark.t))[:MAX_REPLAYS]
    return sorted(strongest, key=lambda mark: mark.t)


def replay_times(timeline: BallTimeline, mark: ContactMark, rate: float, slow: float) -> FloatArray:
    """Return times (K,) s around a contact, within the two frames that enclose it."""
    row, _ = timeline.locate_time(mark.t)
    first, last = float(timeline.t[row]), float(timeline.t[min(row + 1, len(timeline.t) - 1)])
    step = 1 / (rate * slow * REPLAY_SLOWDOWN)
    half = MAX_REPLAY_S / 2 * rate * step
    return np.arange(max(first, mark.t - half), min(last, mark.t + half), step)


def render_replays(
    clip: Clip, appearance: ClipAppearance, marks: list[ContactMark], rate: float, slow: float
) -> Iterator[ImageArray]:
    """Yield the frames (H, W, 3) of the replays: close-ups of all marked contacts."""
    timeline = appearance.timeline
    for mark in marks:
        for frame in synthesize_frames(clip, appearance, replay_times(timeline, mark, rate, slow)):
            yield _draw_replay_frame(frame.image, timeline, mark, frame.t, frame.balls, slow)


def _draw_replay_frame(
    image: ImageArray, timeline: BallTimeline, mark: ContactMark, t: float, balls: FrameBalls, slow: float
) -> ImageArray:
    """Magnify the place of the contact, and draw the fitted outlines and the time relative to the contact."""
    height, width = image.shape[:2]
    extent = 2 * AROUND_RADII * balls.radius_of(mark.ball) * np.array([width / height, 1.0])
    view, scale, corner = magnify_image(image, (width, height), np.stack([timeline.project(mark.xy, t), extent]))
    stroke = drawing_scale(height)
    margin, inside = 14 * stroke, replace(balls, centre=scale * (balls.centre - corner), radius=scale * balls.radius)
    value = f"{1e3 * (t - mark.t):+.1f} ms   {slow * REPLAY_SLOWDOWN:g}× slower"
    with keep_balls_on_top(view, inside):
        for ball in inside.present:
            draw_ring(view, inside.centre[ball], inside.radius[ball] + 2 * stroke, 1.4 * stroke, WHITE, 0.7)
        Label(mark.label.name or "contact", value, MUTED_GREY).draw(view, np.array([margin, margin]), 1.25 * stroke)
    return view


def balls_at_times(timeline: BallTimeline, state: State, t: FloatArray) -> list[FrameBalls]:
    """Evaluate the balls on frames at any times.

    Args:
        timeline: Positions of the balls.
        state: State of the balls (K, N) at the times.
        t: Times (K,), s.

    Returns:
        The balls on each frame.
    """
    rows, share = timeline.locate_times(t)
    after, moved = np.minimum(rows + 1, len(timeline.t) - 1), share[:, None, None]
    centre = timeline.centres_at(t, state.xy)
    interpolated = timeline.centre[rows] * (1 - moved) + timeline.centre[after] * moved
    located = np.isfinite(timeline.centre[rows, :, :1])
    centre = np.where(np.isfinite(centre), centre, np.where(located, interpolated, np.nan))
    speed = np.linalg.norm(state.v, axis=-1)
    moving = (np.nan_to_num(speed) > MIN_SPEED) & timeline.moving[np.minimum(rows, len(timeline.moving) - 1)]
    sure = ~state.measured | timeline.observed[rows] | timeline.observed[after]
    near = np.where(share < 0.5, rows, after)
    radius = np.where(np.isfinite(timeline.radius[near]), timeline.radius[near], timeline.radius[rows])
    shown_speed = np.where(moving | ~np.isfinite(speed), speed, 0.0)  # NaN where unknown, as in a pocket
    heading = _motion_headings(timeline, state, t, moving)
    columns = (centre, radius, shown_speed, heading, moving, state.measured, sure)
    return [FrameBalls(*row) for row in zip(*columns, strict=True)]


def _motion_headings(timeline: BallTimeline, state: State, t: FloatArray, moving: NDArray[np.bool_]) -> FloatArray:
    """Return unit vectors of the motion (K, N, 2), px; 0 at rest."""
    ahead = timeline.project(state.xy + 0.01 * state.v, t) - timeline.project(state.xy, t)
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    return np.nan_to_num(np.where(moving[..., None] & (length > 1e-6), ahead / np.maximum(length, 1e-6), 0.0))
