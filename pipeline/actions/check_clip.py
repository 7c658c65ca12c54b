"""Check how a clip is filmed, in a few seconds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np

from detectors.detect import concatenate_detections, prepare_detector
from detectors.detect_options import DetectOptions
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import ImageArray
from pipeline.settings import DoorOptions
from pipeline.stages.read_stage import open_frame_memory
from video.filming_check.clip_sample import ClipSample, sample_clip
from video.filming_check.filming_limits import FilmingLimits
from video.filming_check.measure_filming import (
    FilmedView,
    FilmingMeasurement,
    grade_measurements,
    locate_view,
    measure_filming,
)
from video.filming_check.motion_measurements import measure_exposure_time, select_lively_runs
from video.io.clip import Clip, open_clip, read_frames

Verdict = Literal["go", "doubts", "no-go"]
DEFAULT_OPTIONS, DEFAULT_LIMITS = DoorOptions(), FilmingLimits()
WHOLE_CLIP_PIXELS = 1_000_000_000
"""Pixels up to which a clip is read as a whole, as a run does: 1,000 frames of 720p, 5 s on one core."""


@dataclass(frozen=True, slots=True)
class FilmingReport:
    """How a clip is filmed."""

    clip: Clip
    """The part of the clip that was looked at."""
    measurements: tuple[FilmingMeasurement, ...]
    verdict: Verdict
    refusal: str
    """Why a run refuses the clip; empty otherwise."""
    bits_per_pixel: float
    """Mean over the clip; NaN for images."""
    view: FilmedView
    still: ImageArray
    """(H, W, 3) the first frame of the part."""
    detections: Detections
    """Balls in the first and in a few other frames of the part, counted from its first, px."""

    @property
    def ball_count(self) -> int:
        """Number of balls in the first frame of the part."""
        return int(np.count_nonzero(self.detections.frame == 0))


def check_clip(
    path: Path, options: DoorOptions = DEFAULT_OPTIONS, limits: FilmingLimits = DEFAULT_LIMITS
) -> FilmingReport:
    """Check how a clip is filmed.

    Table and balls are those that a run finds: it reads, calibrates and detects by the same functions. Of a recording
    longer than `WHOLE_CLIP_PIXELS` only the liveliest part is calibrated.

    Args:
        path: A video, or a folder of numbered images.
        options: Options of reading, calibration and detection.
        limits: Limits of good filming.

    Returns:
        All measurements, and the verdict.

    Raises:
        ClipError: The clip cannot be read.
        OptionError: An option is not meaningful.
    """
    with open_frame_memory() as memory:
        sample = sample_clip(path)
        part, fps = sample.clip, options.read.fps
        is_short = len(sample.times) * part.width * part.height <= WHOLE_CLIP_PIXELS
        clip = open_clip(path, fps=None if fps is None else Fraction(fps), memory=memory) if is_short else part
        sample = replace(sample, times=clip.t) if is_short else sample
        view = locate_view(sample, clip, options.calibrate)
        detections = concatenate_detections([])
        if view.scene is not None and not view.refusal:
            detections = _detect_fast_balls(sample, clip, view, view.scene, options.detect)
    values = measure_filming(sample, view, measure_exposure_time(detections, part.t))
    measurements = grade_measurements(values, limits)
    return FilmingReport(
        part, measurements, _judge(measurements, view.refusal), view.refusal, sample.bits_per_pixel, view,
        sample.stills[0], detections,
    )  # fmt: skip


def _judge(measurements: tuple[FilmingMeasurement, ...], refusal: str) -> Verdict:
    """Return the verdict that the worst measurement gives; what a run refuses is a no-go."""
    levels = {one.level for one in measurements}
    return "no-go" if refusal or "bad" in levels else "doubts" if "doubt" in levels else "go"


def _detect_fast_balls(
    sample: ClipSample, clip: Clip, view: FilmedView, scene: Scene, options: DetectOptions
) -> Detections:
    """Detect the balls in the first frame of the sampled part and in those of its frames in which they are fastest."""
    runs = select_lively_runs(sample.thumbnails, view.thumbnail_mask)
    numbers = np.unique(np.concatenate([[0], *runs]))
    numbers = numbers[np.isin(sample.clip.frames[numbers], clip.frames)]
    detector = prepare_detector(clip, scene, options)
    images = (rgb for _, rgb in read_frames(clip, indices=sample.clip.frames[numbers]))
    return concatenate_detections([detector.detect(rgb, int(k)) for k, rgb in zip(numbers, images, strict=True)])
