"""Interpolation of plain frames of a clip: the chain up to the fit, then frames to a video and optionally to PNGs."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from models.core.errors import OptionError
from models.core.fit_result import Trust
from models.core.rally import Rally
from models.core.shot import Shot
from models.core.typing import FloatArray, ImageArray
from pipeline.engine.atomic_write import create_folder, replace_file, require_writable_folder
from pipeline.engine.stage_graph import RunWatcher
from pipeline.io.rally_files import build_rally_clock
from pipeline.io.run_views import view_run
from pipeline.reporting.text.rally_sentences import assess_rally_trust
from video.io.audio import add_audio
from video.io.clip import Clip, read_frames
from video.io.video_writer import VideoWriter
from video.matting.ball_timeline import build_ball_timeline
from video.matting.hidden_background import estimate_hidden_background
from video.overlay.plain_interpolation import (
    regular_frame_rate,
    regular_frame_times,
    subdivide_frame_times,
    window_left_borders,
    window_width,
)
from video.overlay.slow_motion import synthesize_frames
from video.synthesis.frame_synthesis import estimate_clip_appearance

# s, time base of videos with a variable frame rate.
TIME_BASE = Fraction(1, 90000)
# Range of --rate, 1/s.
RATE_RANGE = (24, 240)
MAX_SLOW = 100.0
# degrees
MAX_SHUTTER = 360.0


@dataclass(frozen=True, slots=True)
class InterpolateOptions:
    """Times of the interpolated frames, and their synthesis."""

    factor: int | None = None
    """Steps from frame to frame."""
    rate: Fraction | None = None
    """Frame rate of the output (1/s), instead of a factor; original frames are used only where the times coincide."""
    slow: float = 1.0
    """Times slower than the clip."""
    shutter: float | None = None
    """Shutter angle, degrees of the step between output frames; None: the motion blur of the clip."""
    upright: bool = False
    """Whether to crop to a 9:16 window that follows the action."""

    def __post_init__(self) -> None:
        if (self.factor is None) == (self.rate is None):
            raise OptionError("Either --factor or --rate sets the output frames; give one of them")
        if self.rate is not None and not RATE_RANGE[0] <= self.rate <= RATE_RANGE[1]:
            raise OptionError(
                f"--rate is {RATE_RANGE[0]} to {RATE_RANGE[1]} frames per second; got {float(self.rate):g}"
            )
        if not 1 <= self.slow <= MAX_SLOW:
            raise OptionError(f"--slow is 1 to {MAX_SLOW:g} times; got {self.slow:g}")
        if self.shutter is not None and not 0 <= self.shutter <= MAX_SHUTTER:
            raise OptionError(f"--shutter is 0 to {MAX_SHUTTER:g} degrees; got {self.shutter:g}")


@dataclass(frozen=True, slots=True)
class InterpolatedClip:
    """Summary of an interpolated clip."""

    frame_count: int
    original_count: int
    rate: float
    """Mean frame rate of the output, 1/s."""
    trust: Trust
    notes: tuple[str, ...]


def interpolate_clip(
    clip: Path,
    video: Path,
    frames: Path | None,
    wanted: InterpolateOptions,
    explain_clip: Callable[[], tuple[Clip, Shot | Rally]],
    watcher: RunWatcher,
    with_sound: bool = True,
) -> InterpolatedClip:
    """Write the frames of a clip and interpolated frames between them.

    With a factor, D distinct frames become (D - 1) factor + 1. Files appear complete or not at all.

    Args:
        video: Video to write.
        frames: New or empty folder for PNGs; None for none.
        wanted: Times and synthesis of the frames.
        explain_clip: Called once the outputs can be written; it returns the clip, and its shot or rally.
        watcher: Receives the progress.
        with_sound: Whether the video has the sound of the clip.

    Returns:
        Frame counts, rate, trust level and notes.

    Raises:
        TruerollError: The clip or an output path cannot be used.
    """
    for place in (video.parent, *([frames] if frames is not None else [])):
        require_writable_folder(place)
    if video.exists() and video.samefile(clip):
        raise OptionError(f"The video would overwrite the clip {clip} itself; choose another output with -o")
    if frames is not None and frames.is_dir() and any(frames.iterdir()):
        raise OptionError(f"--frames needs a new or empty folder; {frames} contains files")
    source, explained = explain_clip()
    progress, start = watcher.start_stage("interpolate"), time.perf_counter()
    times, rate, even = _schedule_frames(source, wanted)
    if isinstance(explained, Rally):
        images, trust = _synthesize_rally(source, explained, times, wanted), assess_rally_trust(explained)
        width, lefts = source.width, np.zeros(len(times), np.int64)
    else:
        images, width, lefts = _synthesize_shot(source, explained, times, wanted)
        trust = view_run(explained).trust
    base = None if even else TIME_BASE
    with replace_file(video) as place, create_folder(frames) if frames else nullcontext() as folder:
        silent = place.with_name(f".{video.name}.silent{place.name.removeprefix('.' + video.name)}")
        try:
            with VideoWriter(silent, width, source.height, rate, crf=18, time_base=base, direct=True) as writer:
                for k, image in enumerate(images):
                    shown = np.ascontiguousarray(image[:, lefts[k] : lefts[k] + width])
                    writer.write(shown, None if even else float(wanted.slow * (times[k] - times[0])))
                    if folder is not None:
                        Image.fromarray(shown).save(folder / f"{k:06d}.png", compress_level=1)
                    progress((k + 1) / len(times))
            if source.has_audio and with_sound:
                add_audio(silent, source, wanted.slow, place)
            else:
                silent.rename(place)
        finally:
            silent.unlink(missing_ok=True)
    watcher.finish_stage("interpolate", time.perf_counter() - start, False)
    originals = int(np.isin(times, source.times_of(source.distinct_frames)).sum())
    notes = (*source.notes, *(source.memory.notes if source.memory else ()))
    return InterpolatedClip(len(times), originals, float(rate), trust, notes)


def _synthesize_shot(
    source: Clip, shot: Shot, times: FloatArray, wanted: InterpolateOptions
) -> tuple[Iterator[ImageArray], int, NDArray[np.int64]]:
    """Return the frames of a shot of billiards, the width of the output, and its left border (K,) in each frame."""
    timeline = build_ball_timeline(shot.scene, shot.tracks, view_run(shot))
    scenery = estimate_clip_appearance(estimate_hidden_background(timeline, source), source)
    exposure = wanted.shutter and float(wanted.shutter / MAX_SHUTTER * np.median(np.diff(times)))
    width, lefts = source.width, np.zeros(len(times), np.int64)
    if wanted.upright:
        width, lefts = window_width(source.width, source.height), window_left_borders(scenery.timeline, times)
    return (frame.image for frame in synthesize_frames(source, scenery, times, exposure)), width, lefts


def _synthesize_rally(
    source: Clip, rally: Rally, times: FloatArray, wanted: InterpolateOptions
) -> Iterator[ImageArray]:
    """Yield the frames of a rally; those of the clip are as they were decoded."""
    if wanted.upright or wanted.shutter is not None:
        raise OptionError("--upright and --shutter are for billiards; leave them out for a rally")
    from video.synthesis.rally_synthesis import build_rally_timeline, synthesize_rally_frames  # slow to import

    times = build_rally_clock(source, rally).capture_time_at(times)
    decoded = (image for _, image in read_frames(source, indices=rally.frame[np.isin(rally.t, times)]))
    for frame in synthesize_rally_frames(source, build_rally_timeline(rally), times):
        is_decoded = np.isin(frame.t, rally.t)
        yield next(decoded) if is_decoded else frame.canvas.to_rgb(source.height, source.width)


def _schedule_frames(clip: Clip, wanted: InterpolateOptions) -> tuple[FloatArray, Fraction, bool]:
    """Return the output times (K,) s of the clip, the output frame rate (1/s), and whether it is constant."""
    slow = Fraction(wanted.slow).limit_denominator(1000)
    if wanted.rate is not None:
        return regular_frame_times(clip, float(wanted.rate * slow)), wanted.rate, True
    assert wanted.factor is not None
    times, exact = subdivide_frame_times(clip, wanted.factor), regular_frame_rate(clip, wanted.factor)
    mean = Fraction((len(times) - 1) / float(times[-1] - times[0])).limit_denominator(1001)
    return times, (exact or mean) / slow, exact is not None
