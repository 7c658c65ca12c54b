"""Text of a recording: log of the stages, fitted parameters with their errors, trust level."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.detections import Detections
from models.core.fit_result import Fit, Parameter
from models.core.scene import Scene
from models.core.tracks import Tracks
from pipeline.reporting.recording.plan_layer import residual_magnification
from pipeline.reporting.recording.recorded_shot import RecordedShot
from pipeline.reporting.recording.recording_stream import build_time_columns
from pipeline.reporting.text.number_format import format_measured, format_unit
from pipeline.reporting.text.text_formatting import format_textbook_range
from pipeline.reporting.text.whole_shot_sentences import format_whole_shot
from video.io.clip import Clip

LogLine = tuple[str, str]
"""Level of rerun's text log, and a sentence."""


def log_stage_lines(stream: rr.RecordingStream, clip: Clip, stage: str, lines: list[LogLine]) -> None:
    """Log lines of a stage in `log/chain` at the first frame."""
    levels, texts = zip(*lines, strict=True) if lines else ((), ())
    columns = rr.TextLog.columns(text=[f"{stage}: {text}" for text in texts], level=list(levels))
    if lines:
        stream.send_columns(f"log/chain/{stage}", build_time_columns(np.full(len(lines), clip.t[0]), clip.t), columns)


def describe_clip(clip: Clip) -> list[LogLine]:
    """Describe frame count, frame rate, size and faults of a clip."""
    counted = f"{clip.frame_count} frames, {len(clip.distinct_frames)} distinct, {float(clip.fps):.3f} fps"
    return [("INFO", f"{counted}, {clip.width} x {clip.height}"), *(("WARN", note) for note in clip.notes)]


def describe_scene(scene: Scene) -> list[LogLine]:
    """Describe how the table was located and which assumptions were made."""
    return [("WARN" if note in scene.warnings else "INFO", note) for note in scene.notes]


def describe_detections(detections: Detections) -> list[LogLine]:
    """Describe number and position noise of the detections."""
    if not len(detections):
        return [("WARN", "no ball was detected")]
    sigma = float(np.median(detections.sigma))
    frames = len(np.unique(detections.frame))
    return [("INFO", f"{len(detections)} detections in {frames} frames, median position sigma {sigma:.2f} px")]


def describe_tracks(tracks: Tracks) -> list[LogLine]:
    """Describe the share of frames in which each ball was observed."""
    shares = tracks.is_observed.mean(axis=0)
    return [
        ("INFO", f"{ball} observed in {100 * share:.0f} % of the frames")
        for ball, share in zip(tracks.ids, shares, strict=True)
    ]


def describe_fit(clip: Clip, fit: Fit) -> list[LogLine]:
    """Describe noise, misfit and trust level of a fit."""
    trust = fit.trust
    level = {"green": "INFO", "amber": "WARN", "red": "ERROR"}[trust.level]
    quality = f"noise {1000 * fit.noise:.2f} mm, chi2 per degree of freedom {fit.chi2_per_dof:.2f}"
    sentence = format_whole_shot(fit)
    laws = [("INFO", sentence)] if sentence else []
    return [("INFO", quality), *laws, *((level, f"trust {trust.level}: {reason}") for reason in trust.reasons)]


def log_parameters(stream: rr.RecordingStream, fit: Fit) -> None:
    """Log `parameters/NAME`: value, sigma, unit and whether the prior alone determined it."""
    for p in (*fit.parameters, *(fit.whole_shot.parameters if fit.whole_shot is not None else ())):
        facts = rr.AnyValues(value=p.value, sigma=p.sigma, unit=p.unit, prior_only=p.prior_only)
        stream.log(f"parameters/{p.name}", facts, static=True)


def log_about(stream: rr.RecordingStream, shot: RecordedShot) -> None:
    """Log `about`: trust level, parameters and a legend of the plan."""
    text = rr.TextDocument(format_about(shot), media_type=rr.MediaType.MARKDOWN)
    stream.log("about", text, static=True)


def format_about(shot: RecordedShot) -> str:
    """Format trust level, parameters and the legend of the plan as Markdown."""
    trust = shot.fit.trust
    lines = [f"# Trust: {trust.level}", *(f"- {reason}" for reason in trust.reasons), "", "## Fitted"]
    lines += ["| parameter | value | sigma | unit | textbook range |", "|---|---|---|---|---|"]
    lines += [_format_parameter_row(p) for p in shot.fit.parameters]
    lines += ["", f"Noise {1000 * shot.fit.noise:.2f} mm, chi2 per degree of freedom {shot.fit.chi2_per_dof:.2f}."]
    lines += [
        "",
        "## Legend of the plan",
        f"- pink arrows: measured minus fitted, {residual_magnification(shot):g} times as long",
    ]
    lines += ["- faint line: whole path; bright line: path up to the current time; thin bundle: forecast"]
    return "\n".join([*lines, "", "## Table", *(f"- {note}" for note in shot.scene.notes)])


def _format_parameter_row(p: Parameter) -> str:
    value, sigma = format_measured(p.value, p.sigma)
    source = " (prior)" if p.prior_only else ""
    return f"| {p.name} | {value} | {sigma}{source} | {format_unit(p.unit)} | {format_textbook_range(p.name)} |"
