"""Annotated slow motion of a rally."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path

import cv2
import numpy as np

from models.core.progress import Progress, ignore_progress
from models.core.rally import Rally
from models.core.typing import FloatArray, ImageArray
from models.estimation.rally.landing_judgement import LandingCall, judge_landing
from video.drawing.masks import drawing_scale
from video.drawing.palette import MUTED_GREY
from video.io.clip import Clip, read_frames
from video.io.video_options import RenderOptions
from video.io.yuv_frame import Canvas, YuvFrame
from video.overlay.annotation import DEFAULT_OPTIONS
from video.overlay.frame_overlay import Label
from video.overlay.landing_close_up import draw_landing
from video.overlay.rally_annotation import prepare_rally_annotation
from video.overlay.slow_motion import (
    PREFETCHED_FRAMES,
    encode_slow_motion,
    find_output_rate,
    prefetch_items,
    space_output_times,
)
from video.synthesis.rally_synthesis import RallyTimeline, build_rally_timeline, synthesize_rally_frames

# s for which the close-up of the landing is shown at the end.
CLOSE_UP_S = 3.5
# Slowdown of the replay of a landing relative to the slow motion before, its magnification, and its frames at most.
REPLAY_SLOWDOWN, REPLAY_ZOOM, REPLAY_FRAMES = 4.0, 4.0, 72


def render_rally(
    clip: Clip, rally: Rally, path: Path, options: RenderOptions = DEFAULT_OPTIONS,
    progress: Progress = ignore_progress,
) -> None:  # fmt: skip
    """Write the annotated slow motion of a rally as H.264; but in the clean style, the landing's close-up ends it.

    Args:
        path: Output file; its frame rate is that of the clip, limited to 25 to 60 frames per second.
        options: Slowdown, style and quality.
        progress: Function that receives the finished share.
    """
    timeline, rate = build_rally_timeline(rally), find_output_rate(clip)
    times = find_rally_times(clip, rally, options)
    call = judge_landing(rally)
    (first,) = (image for _, image in read_frames(clip, indices=rally.frame[:1]))
    annotation = prepare_rally_annotation(timeline, call, first, options.slow, options.style)
    size = (clip.width + clip.width % 2, clip.height + clip.height % 2)  # as the writer makes them
    still_count = round(CLOSE_UP_S * rate) if options.style != "clean" and call.landing is not None else 0
    frames = prefetch_items(synthesize_rally_frames(clip, timeline, times), PREFETCHED_FRAMES)
    images: Iterator[Canvas] = (annotation.draw(frame) for frame in frames)
    still = _show_still(draw_landing(clip, rally, call, size), still_count) if still_count else iter(())
    again = find_replay_times(rally, call, float(rate) * options.slow) if options.style == "umpire" else times[:0]
    replay = _replay_landing(clip, timeline, call, again, options.slow)
    count = len(times) + len(again) + still_count
    encode_slow_motion(chain(images, replay, still), count, path, size, rate, options, progress)


def find_rally_times(clip: Clip, rally: Rally, options: RenderOptions) -> FloatArray:
    """Find the times (K,), s, of the frames of the slow motion; without still parts where the options say so."""
    flights = rally.flights
    motion = (flights[0].start, max(one.end for one in flights)) if flights else None
    return space_output_times(clip, rally.t, motion, options)


def find_replay_times(rally: Rally, call: LandingCall, rate: float) -> FloatArray:
    """Find the times (K,), s, of the replay of a landing, for a slow motion of `rate` frames per s of the clip."""
    if call.landing is None:
        return np.empty(0)
    step = 1 / (rate * REPLAY_SLOWDOWN)
    times = call.landing.t + step * np.arange(-REPLAY_FRAMES // 2, REPLAY_FRAMES // 2)
    return np.asarray(times[(times >= rally.t[0]) & (times <= rally.t[-1])])


def _replay_landing(
    clip: Clip, timeline: RallyTimeline, call: LandingCall, times: FloatArray, slow: float
) -> Iterator[Canvas]:
    """Yield magnified frames around a landing, with the time from it on."""
    landing = call.landing
    for frame in synthesize_rally_frames(clip, timeline, times) if landing is not None and len(times) else ():
        assert landing is not None
        image = magnify_planes(frame.canvas, timeline.project(landing.place, frame.t), REPLAY_ZOOM)
        scale = drawing_scale(image.shape[0])
        value = f"{1e3 * (frame.t - landing.t):+.1f} ms   {slow * REPLAY_SLOWDOWN:g}× slower"
        Label("landing", value, MUTED_GREY).draw(image, np.full(2, 14 * scale), 1.25 * scale)
        yield image


def magnify_planes(frame: YuvFrame, centre: FloatArray, zoom: float) -> YuvFrame:
    """Magnify a frame about a place (2,) px, moved so that the view lies in the frame."""
    planes = []
    for k, plane in enumerate(frame.planes):
        size = np.array(plane.shape[::-1], np.float64)
        place = np.nan_to_num(centre, nan=0.0) if k == 0 else (np.nan_to_num(centre, nan=0.0) - 0.5) / 2
        corner = np.clip(place - size / (2 * zoom), 0, size * (1 - 1 / zoom))
        to_view = np.column_stack([zoom * np.eye(2), -zoom * corner])
        planes.append(cv2.warpAffine(plane, to_view, plane.shape[::-1], flags=cv2.INTER_CUBIC))
    return YuvFrame((planes[0], planes[1], planes[2]))


def _show_still(image: ImageArray, count: int) -> Iterator[Canvas]:
    """Yield an image as many times as it is shown."""
    return repeat(YuvFrame.from_rgb(np.ascontiguousarray(image)), count)
