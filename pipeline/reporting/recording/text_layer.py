"""What the chain says of itself: its log, the fitted parameters with their errors, how far to trust it."""

from __future__ import annotations

import numpy as np
import rerun as rr

from models.core.detections import Detections
from models.core.fit_result import Fit, Parameter
from models.core.scene import Scene
from models.core.tracks import Tracks
from pipeline.reporting.recording.plan_layer import magnification
from pipeline.reporting.recording.recorded_shot import Shot
from pipeline.reporting.recording.recording_stream import timeline
from pipeline.reporting.text.run_trust import run_trust
from pipeline.reporting.text.sentences import parameter_range
from video.io.clip import Clip

Line = tuple[str, str]
"""A level of rerun's text log, and a sentence."""


def log_chain(stream: rr.RecordingStream, clip: Clip, stage: str, lines: list[Line]) -> None:
    """What a stage found, in `log/chain` at the first picture."""
    levels, texts = zip(*lines, strict=True) if lines else ((), ())
    told = rr.TextLog.columns(text=[f"{stage}: {text}" for text in texts], level=list(levels))
    if lines:
        stream.send_columns(f"log/chain/{stage}", timeline(np.full(len(lines), clip.t[0]), clip.t), told)


def of_clip(clip: Clip) -> list[Line]:
    """Pictures, rate, and what was not as it should be."""
    counted = f"{clip.frame_count} pictures, {len(clip.distinct)} distinct, {float(clip.rate):.3f} per second"
    return [("INFO", f"{counted}, {clip.width} x {clip.height}"), *(("WARN", note) for note in clip.notes)]


def of_scene(scene: Scene) -> list[Line]:
    """How the table was found and what was assumed."""
    return [("WARN" if note in scene.doubts else "INFO", note) for note in scene.notes]


def of_detections(detections: Detections) -> list[Line]:
    """How many, and how well placed."""
    if not len(detections):
        return [("WARN", "no ball was seen")]
    sigma = float(np.median(detections.sigma))
    pictures = len(np.unique(detections.frame))
    return [("INFO", f"{len(detections)} balls in {pictures} pictures, each placed to {sigma:.2f} px (median sigma)")]


def of_tracks(tracks: Tracks) -> list[Line]:
    """Which balls, and how often each was seen."""
    shares = tracks.observed.mean(axis=0)
    return [
        ("INFO", f"{ball} seen in {share:.0%} of the pictures") for ball, share in zip(tracks.ids, shares, strict=True)
    ]


def of_fit(clip: Clip, fit: Fit) -> list[Line]:
    """How well the physics holds, and how far to trust it."""
    trust = run_trust(clip, fit)
    level = {"green": "INFO", "amber": "WARN", "red": "ERROR"}[trust.light]
    quality = f"noise {1000 * fit.noise:.2f} mm, chi2 per degree of freedom {fit.chi2_per_dof:.2f}"
    laws = [("INFO", fit.lawless)] if fit.lawless else []
    return [("INFO", quality), *laws, *((level, f"trust {trust.light}: {reason}") for reason in trust.reasons)]


def log_parameters(stream: rr.RecordingStream, fit: Fit) -> None:
    """`parameters/NAME`: value, sigma, unit and whether the clip told it."""
    for p in (*fit.parameters, *(fit.laws.parameters if fit.laws is not None else ())):
        facts = rr.AnyValues(value=p.value, sigma=p.sigma, unit=p.unit, prior_only=p.prior_only)
        stream.log(f"parameters/{p.name}", facts, static=True)


def log_about(stream: rr.RecordingStream, shot: Shot) -> None:
    """`about`: trust, parameters and how to read the plan, as one text."""
    text = rr.TextDocument(about(shot), media_type=rr.MediaType.MARKDOWN)
    stream.log("about", text, static=True)


def about(shot: Shot) -> str:
    """Markdown."""
    trust = run_trust(shot.clip, shot.fit)
    lines = [f"# Trust: {trust.light}", *(f"- {reason}" for reason in trust.reasons), "", "## Fitted"]
    lines += ["| parameter | value | sigma | unit | usual |", "|---|---|---|---|---|"]
    lines += [_row(p) for p in shot.fit.parameters]
    lines += ["", f"Noise {1000 * shot.fit.noise:.2f} mm, chi2 per degree of freedom {shot.fit.chi2_per_dof:.2f}."]
    lines += ["", "## To read the plan", f"- pink arrows: measured minus fitted, {magnification(shot):g} times as long"]
    lines += ["- faint line: the whole path; bright: until now; thin bundle: what was foretold then"]
    return "\n".join([*lines, "", "## Table", *(f"- {note}" for note in shot.scene.notes)])


def _row(p: Parameter) -> str:
    told = f"{p.sigma:.2g}{' (prior)' if p.prior_only else ''}"
    return f"| {p.name} | {p.value:.4g} | {told} | {p.unit if p.unit != '1' else ''} | {parameter_range(p.name)} |"
