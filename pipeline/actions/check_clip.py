"""Check how a clip is filmed, in a few seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from detectors.detect import build_detector, concatenate_detections
from detectors.detect_options import DetectOptions
from models.core.detections import Detections
from models.core.scene import Scene
from models.core.typing import ImageArray
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
from video.io.clip import Clip, read_frames
from video.io.video_options import CalibrateOptions

Verdict = Literal["go", "doubts", "no-go"]
DEFAULT_OPTIONS, DEFAULT_LIMITS = CalibrateOptions(), FilmingLimits()


@dataclass(frozen=True, slots=True)
class FilmingReport:
    """How a clip is filmed."""

    clip: Clip
    """The part of the clip that was looked at."""
    measurements: tuple[FilmingMeasurement, ...]
    verdict: Verdict
    refusal: str
    """Why no table was located; empty otherwise."""
    bits_per_pixel: float
    """Mean over the clip; NaN for images."""
    view: FilmedView
    still: ImageArray
    """(H, W, 3) the first frame of the part."""
    detections: Detections
    """Balls in the first and in a few other frames of the part, counted from its first, px."""


def check_clip(
    path: Path, options: CalibrateOptions = DEFAULT_OPTIONS, limits: FilmingLimits = DEFAULT_LIMITS
) -> FilmingReport:
    """Check how a clip is filmed.

    Args:
        path: A video, or a folder of numbered images.
        options: Corners, table and ball radius if the user gave them.
        limits: Limits of good filming.

    Returns:
        All measurements, and the verdict.

    Raises:
        ClipError: The clip cannot be read.
        OptionError: An option is not meaningful.
    """
    with open_frame_memory() as memory:
        sample = sample_clip(path, memory)
        view = locate_view(sample, options)
        detections = concatenate_detections([])
        if view.scene is not None:
            detections = _detect_fast_balls(sample, view, view.scene)
    values = measure_filming(sample, view, measure_exposure_time(detections, sample.clip.t))
    measurements = grade_measurements(values, limits)
    return FilmingReport(
        sample.clip, measurements, _judge(measurements), view.refusal, sample.bits_per_pixel, view, sample.stills[0],
        detections,
    )  # fmt: skip


def _judge(measurements: tuple[FilmingMeasurement, ...]) -> Verdict:
    """Return the verdict that the worst measurement gives."""
    levels = {one.level for one in measurements}
    return "no-go" if "bad" in levels else "doubts" if "doubt" in levels else "go"


def _detect_fast_balls(sample: ClipSample, view: FilmedView, scene: Scene) -> Detections:
    """Detect the balls in the first frame and in those in which they are fastest."""
    runs = select_lively_runs(sample.thumbnails, view.thumbnail_mask)
    detector = build_detector(scene, zip(sample.still_frames, sample.stills, strict=True), DetectOptions())
    frames = np.unique(np.concatenate([[0], *runs]))
    images = (rgb for _, rgb in read_frames(sample.clip, indices=sample.clip.frames[frames]))
    return concatenate_detections([detector.detect(rgb, int(k)) for k, rgb in zip(frames, images, strict=True)])
