"""Annotated slow motion of a rally."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, repeat
from pathlib import Path

import numpy as np

from models.core.progress import Progress, ignore_progress
from models.core.rally import Rally
from models.core.typing import FloatArray, ImageArray
from models.estimation.rally.landing_judgement import LandingCall, judge_landing
from video.io.clip import Clip, read_frames
from video.io.video_options import RenderOptions
from video.io.video_writer import VideoWriter
from video.io.yuv_frame import Canvas, YuvFrame
from video.overlay.annotation import DEFAULT_OPTIONS
from video.overlay.landing_close_up import draw_landing
from video.overlay.rally_annotation import prepare_rally_annotation
from video.overlay.slow_motion import (
    CRF,
    ENCODER_THREADS,
    KEYFRAME_INTERVAL_S,
    PREFETCHED_FRAMES,
    SLOW_TUNING,
    TRIM_MARGIN_S,
    TUNING_MIN_SLOWDOWN,
    find_output_rate,
    prefetch_items,
    space_output_times,
)
from video.synthesis.rally_synthesis import build_rally_timeline, synthesize_rally_frames

# s for which the close-up of the landing is shown at the end.
CLOSE_UP_S = 3.5


def render_rally(
    clip: Clip, rally: Rally, path: Path, options: RenderOptions = DEFAULT_OPTIONS,
    progress: Progress = ignore_progress, call: LandingCall | None = None,
) -> None:  # fmt: skip
    """Write the annotated slow motion of a rally as H.264; but in the clean style, the landing's close-up ends it.

    Args:
        path: Output file; its frame rate is that of the clip, limited to 25 to 60 frames per second.
        options: Slowdown, style and quality.
        progress: Function that receives the finished share.
        call: Verdict on the landing; None for that of the usual rule.
    """
    timeline, rate = build_rally_timeline(rally), find_output_rate(clip)
    times = find_rally_times(clip, rally, options)
    call = judge_landing(rally) if call is None else call
    (first,) = (image for _, image in read_frames(clip, indices=rally.frame[:1]))
    annotation = prepare_rally_annotation(timeline, call, first, options.slow, options.style)
    size = (clip.width + clip.width % 2, clip.height + clip.height % 2)  # as the writer makes them
    still_count = round(CLOSE_UP_S * rate) if options.style != "clean" and call.landing is not None else 0
    tuning = SLOW_TUNING if options.slow >= TUNING_MIN_SLOWDOWN and not options.quick else ""
    preset = "ultrafast" if options.quick else "veryfast"
    with VideoWriter(
        path, *size, rate, crf=CRF, preset=preset, tuning=tuning, threads=ENCODER_THREADS, key_s=KEYFRAME_INTERVAL_S
    ) as writer:
        frames = prefetch_items(synthesize_rally_frames(clip, timeline, times), PREFETCHED_FRAMES)
        images: Iterator[Canvas] = (annotation.draw(frame) for frame in frames)
        still = _show_still(draw_landing(clip, rally, call, size), still_count) if still_count else iter(())
        for done, image in enumerate(chain(images, still), start=1):
            writer.write(image)
            progress(done / (len(times) + still_count))


def find_rally_times(clip: Clip, rally: Rally, options: RenderOptions) -> FloatArray:
    """Find the times (K,), s, of the frames of the slow motion; without still parts where the options say so."""
    first, last = float(rally.t[0]), float(rally.t[-1])
    if options.trim_still and rally.flights:
        first = max(first, rally.flights[0].start - TRIM_MARGIN_S)
        last = min(last, max(one.end for one in rally.flights) + TRIM_MARGIN_S)
    return space_output_times(rally.t, first, last, 1 / (float(find_output_rate(clip)) * options.slow))


def _show_still(image: ImageArray, count: int) -> Iterator[Canvas]:
    """Yield an image as many times as it is shown."""
    return repeat(YuvFrame.from_rgb(np.ascontiguousarray(image)), count)
