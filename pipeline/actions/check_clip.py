"""Check how a clip is filmed, in a few seconds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from detectors.detect import concatenate_detections, prepare_detector
from detectors.detect_options import DetectOptions
from models.core.answer import Answer
from models.core.detections import Detections
from models.core.errors import NO_BALLS
from models.core.scene import Scene
from models.core.typing import ImageArray
from pipeline.reporting.text.filming_sentences import (
    LEVEL_SIGNS,
    LIMITS,
    VERDICT_WORDS,
    WORDS,
    format_advice,
    format_bounds,
    format_located_table,
    format_value,
    rank_faults,
)
from pipeline.settings import DoorOptions
from pipeline.stages.read_stage import open_frame_memory
from pipeline.stages.shot_stages import find_single_span
from video.filming_check.clip_sample import ClipSample, sample_clip
from video.filming_check.measure_filming import (
    FilmedView,
    FilmingMeasurement,
    grade_measurements,
    locate_view,
    measure_filming,
)
from video.filming_check.motion_measurements import measure_exposure_time, select_lively_runs
from video.io.clip import Clip, open_clip, read_frames
from video.io.video_options import CalibrateOptions

Verdict = Literal["go", "doubts", "no-go"]
DEFAULT_OPTIONS = DoorOptions()
# Frames of a clip that are looked at before it is called one without balls: as many as locate its table.
SPREAD_FRAMES = 9
# Pixels up to which a clip is read as a whole, as a run does: 1,000 frames of 720p, 5 s on one core.
WHOLE_CLIP_PIXELS = 1_000_000_000


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
        """Number of balls in the first of these frames."""
        frames = self.detections.frame
        return int(np.count_nonzero(frames == frames.min(initial=np.iinfo(np.int64).max)))


def check_clip(path: Path, options: DoorOptions = DEFAULT_OPTIONS) -> FilmingReport:
    """Check how a clip is filmed.

    Table and balls are those that a run finds: it reads, calibrates and detects by the same functions. Of a recording
    longer than `WHOLE_CLIP_PIXELS` only the liveliest part is calibrated.

    Args:
        path: A video, or a folder of numbered images.
        options: Options of reading, calibration and detection.

    Returns:
        All measurements, and the verdict.

    Raises:
        ClipError: The clip cannot be read.
        OptionError: An option is not meaningful.
    """
    with open_frame_memory() as memory:
        rate, aspect = options.read.rate, options.read.aspect
        sample = sample_clip(path, fps=rate, aspect=aspect)
        part = sample.clip
        is_short = len(sample.times) * part.width * part.height <= WHOLE_CLIP_PIXELS
        clip = open_clip(path, fps=rate, aspect=aspect, memory=memory) if is_short else part
        sample = replace(sample, times=clip.t) if is_short else sample
        clip, view = _locate_in_first_shot(sample, _list_parts(clip), options.calibrate)
        detections, refusal = concatenate_detections([]), view.refusal
        if view.scene is not None and not refusal:
            detections = _detect_fast_balls(sample, clip, view, view.scene, options.detect)
            refusal = "" if len(detections) else NO_BALLS
    values = measure_filming(sample, view, measure_exposure_time(detections, part.t))
    measurements = grade_measurements(values, LIMITS)
    levels = {one.level for one in measurements}
    verdict: Verdict = "no-go" if refusal or "bad" in levels else "doubts" if "doubt" in levels else "go"
    return FilmingReport(
        part, measurements, verdict, refusal, sample.bits_per_pixel, view, sample.stills[0], detections
    )


def state_filming(report: FilmingReport) -> Answer:
    """State how a clip is filmed in words and numbers: what was measured, and what to change, the worst first."""
    scene = None if report.refusal else report.view.scene
    located = () if scene is None else (format_located_table(scene.table, report.ball_count),)
    remarks = (*(() if scene is None else scene.warnings), *format_advice(report.measurements, report.refusal))
    rows = (
        (LEVEL_SIGNS[one.level], WORDS[one.code].name, format_value(one), format_bounds(LIMITS.find_limit(one.code)))
        for one in report.measurements
    )
    document = {
        "verdict": report.verdict, "faults": [one.code for one in rank_faults(report.measurements)],
        "refusal": report.refusal, "table": None if scene is None else scene.table.name,
        "balls": None if scene is None else report.ball_count,
        "warnings": [] if scene is None else scene.warnings, "bits_per_pixel": report.bits_per_pixel,
        "sentences": [VERDICT_WORDS[report.verdict], *located, *remarks],
        "measurements": [
            {"code": one.code, "value": one.value, "unit": WORDS[one.code].unit, "level": one.level,
             "good": LIMITS.find_limit(one.code).good, "bad": LIMITS.find_limit(one.code).bad,
             "advice": WORDS[one.code].advice if one.level in ("doubt", "bad") else ""}
            for one in report.measurements
        ],
    }  # fmt: skip
    return Answer(
        "How is this clip filmed?", (VERDICT_WORDS[report.verdict], *located), report.verdict,
        rows=(("", "", "measured", "good"), *rows), notes=tuple(f"- {one}" for one in remarks), document=document,
    )  # fmt: skip


def _list_parts(clip: Clip) -> list[Clip]:
    """List the parts of a clip that a run tries in turn: the shots of a recording with several views or shots."""
    if not len(clip.views) or find_single_span(clip):
        return [clip]
    from video.calibration.shot_segmentation import list_shot_spans, rank_span, segment_shots  # slow to import

    spans = sorted(
        list_shot_spans(clip, segment_shots(clip)),
        key=lambda span: rank_span(float(clip.t[span[0]]), float(clip.t[span[1] - 1]), span[2]),
    )
    return [clip.extract_subclip(first, stop) for first, stop, _ in spans] or [clip]


def _locate_in_first_shot(sample: ClipSample, parts: list[Clip], options: CalibrateOptions) -> tuple[Clip, FilmedView]:
    """Locate the table in the first part of a clip that shows one; else in the first part."""
    first = locate_view(sample, parts[0], options)
    for part in parts[1:] if first.refusal else []:
        view = locate_view(sample, part, options)
        if not view.refusal:
            return part, view
    return parts[0], first


def _detect_fast_balls(
    sample: ClipSample, clip: Clip, view: FilmedView, scene: Scene, options: DetectOptions
) -> Detections:
    """Detect the balls in the first frame of the sampled part and in those of its frames in which they are fastest.

    Where there is none, also in frames spread over the clip.
    """
    runs = select_lively_runs(sample.thumbnails, view.thumbnail_mask)
    offset = sample.clip.first_frame
    begin = max(offset, clip.first_frame)
    begin = begin if begin in clip.frames else clip.first_frame  # the sample is of another shot
    numbers = np.unique(np.concatenate([[begin - offset], *runs]))
    numbers = numbers[np.isin(numbers + offset, clip.frames)]
    detector = prepare_detector(clip, scene, options)
    spread = clip.frames[np.linspace(0, clip.frame_count - 1, SPREAD_FRAMES).astype(int)] - offset
    for chosen in (numbers, np.unique(spread)):
        images = read_frames(clip, indices=chosen + offset)
        detections = concatenate_detections([detector.detect(rgb, int(frame - offset)) for frame, rgb in images])
        if len(detections):
            break
    return detections
