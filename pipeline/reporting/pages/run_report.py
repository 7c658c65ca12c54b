"""The page of a run: one self-contained HTML file to keep and send."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version
from itertools import combinations
from pathlib import Path

import numpy as np

from models.core.fit_result import Fit
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.estimation.contact_test import call_answers
from models.estimation.contact_test.call_answers import Call
from models.estimation.contact_test.shot_record import Record, record_of
from pipeline.engine.atomic_write import aside
from pipeline.reporting.figures.run_figures import ROW_PX as PARAMETER_PX
from pipeline.reporting.figures.run_figures import (
    energy_figure,
    page_colour,
    parameter_figure,
    plan_figure,
    speed_figure,
)
from pipeline.reporting.pages.page_embedding import data_uri, write_page
from pipeline.reporting.pages.page_template import embedded, plotly_source, render
from pipeline.reporting.text.run_trust import run_trust
from pipeline.reporting.text.sentences import event_sentence, parameter_range, parameter_words
from pipeline.reporting.text.shot_summary import tell
from video.calibration.table_classifier import COULD_BE
from video.drawing.palette import ball_colour
from video.io.clip import Clip

EMBED_LIMIT_BYTES = 48_000_000
"""A larger slow.mp4 is linked beside the page instead of carried in it."""
SLOW_MARK = "slow-motion/carried-here"
"""No clip can bear this name. Where the video goes in the page."""
LEAD_IN = 0.15
"""s of the clip before a moment, from which the video plays."""
PACKAGES = ("trueroll", "torch", "opencv-python-headless", "onnxruntime", "numpy", "av")
CLOSE = 0.02
"""m between two balls that did not touch, up to which they are called."""
MOST_CLOSE = 6
"""Calls of balls that came near each other."""
GOOD_SHARE, GOOD_CHI2, GOOD_PX = 0.9, 3.0, 1.0
"""What is explained of the motion, what is left of it, and how noisy a place may be, before a flag is raised."""


@dataclass(frozen=True, slots=True)
class ReportFiles:
    """What the page shows: the slow motion and the still, already written."""

    slow: Path
    poster: Path
    slow_factor: float
    start: float = 0.0
    """s of the clip at which the slow motion begins."""


@dataclass(frozen=True, slots=True)
class Flag:
    """One thing that makes a run good or doubtful."""

    what: str
    value: str
    good: bool


def write_report(
    clip: Clip,
    scene: Scene,
    tracks: Tracks,
    fit: Fit,
    files: ReportFiles,
    title: str,
    settings: Sequence[str],
    path: Path,
) -> None:
    """Write the page to `path`; `settings` are the options that reproduce the run, for its last section."""
    colours = [page_colour(ball_colour(*seen)) for seen in zip(tracks.kinds, tracks.colour, strict=True)]
    carried = {SLOW_MARK: (files.slow, "video/mp4")} if files.slow.stat().st_size <= EMBED_LIMIT_BYTES else {}
    parameters = [*fit.parameters, *(fit.laws.parameters if fit.laws is not None else ())]
    html = render(
        "report.html",
        name=title,
        trust=run_trust(clip, fit),
        stories=tell(tracks, fit, [doubt for doubt in scene.doubts if doubt.startswith(COULD_BE)]),
        balls=balls_of(tracks),
        numbered=any(ball[-1:].isdigit() for ball in tracks.ids),
        poster=data_uri(files.poster, "image/png"),
        video=SLOW_MARK if carried else files.slow.name,
        slow=files.slow_factor,
        start=files.start,
        events=event_rows(fit, files),
        plan=embedded(plan_figure(scene, fit, colours), "plan", 440),
        plan_ratio=round(scene.table.width / scene.table.length, 4),
        speeds=embedded(speed_figure(scene, fit, colours), "speeds", 330),
        energies=embedded(energy_figure(scene, fit, colours), "energies", 330),
        calls=calls_of(record_of(tracks, fit.events, fit.trajectory, scene.table, scene.camera)),
        plotly=plotly_source(),
        parameter_plot=_parameter_plot(fit),
        parameters=[(p, parameter_words(p.name), parameter_range(p.name)) for p in parameters],
        lawless=fit.lawless,
        flags=flags_of(clip, scene, tracks, fit),
        notes=[*scene.notes, *clip.notes],
        settings=list(settings),
        versions={name: version(name) for name in PACKAGES},
        digest=clip.digest,
    )
    with aside(path) as fresh:
        write_page(html, carried, fresh)


def balls_of(tracks: Tracks) -> list[tuple[str, str]]:
    """Every ball and its colour: a name such as stripe-4 is the program's, and no number that is printed on a ball."""
    seen = zip(tracks.ids, tracks.kinds, tracks.colour, strict=True)
    return [(ball, "rgb({},{},{})".format(*ball_colour(kind, colour))) for ball, kind, colour in seen]


def _parameter_plot(fit: Fit) -> str:
    told = [p for p in fit.parameters if np.isfinite(p.sigma)]
    return embedded(parameter_figure(told), "parameters", 50 + PARAMETER_PX * len(told)) if told else ""


def event_rows(fit: Fit, files: ReportFiles) -> list[dict[str, str | float]]:
    """The contact list: each row seeks the video to a little before the moment."""
    events = fit.events
    rows: list[dict[str, str | float]] = []
    for k in range(len(events)):
        gap = f"{1000 * events.gap[k]:+.1f} ± {1000 * events.gap_sigma[k]:.1f}" if np.isfinite(events.gap[k]) else ""
        rows.append(
            {
                "seek": round(max(float(events.t[k]) - LEAD_IN - files.start, 0.0) * files.slow_factor, 3),
                "at": round(max(float(events.t[k]) - files.start, 0.0) * files.slow_factor, 3),
                "time": f"{events.t[k]:.4f}",
                "sigma": f"{1000 * events.t_sigma[k]:.1f}",
                "sentence": event_sentence(events, k),
                "speed": f"{events.speed[k]:.2f}" if np.isfinite(events.speed[k]) else "",
                "gap": gap,
                "probability": f"{events.probability[k]:.0%}",
            }
        )
    return rows


def calls_of(record: Record) -> list[tuple[str, Call]]:
    """Questions and answers: what each struck ball met first, and which balls all but touched."""
    struck = list(
        dict.fromkeys(record.events.a[k] for k in range(len(record.events)) if record.events.kind[k] == "strike")
    )
    calls = [(f"first {a}", call_answers.first(record, a)) for a in struck if a in record.ids]
    calls += [(f"cushion-first {a}", call_answers.cushion_first(record, a)) for a in struck if a in record.ids]
    for k in range(len(record.events)):
        if record.events.kind[k] == "pocket" and record.events.a[k] in record.ids:
            a, pocket = record.events.a[k], record.events.b[k]
            calls.append((f"pocket {a} {pocket}", call_answers.pocket(record, a, pocket)))
    return calls + _close_calls(record)


def _close_calls(record: Record) -> list[tuple[str, Call]]:
    """Pairs of balls that came near each other without a contact that is sure, the nearest first."""
    events = record.events
    met = {frozenset((events.a[k], events.b[k])) for k in range(len(events)) if events.kind[k] == "ball"}
    reach = 2 * record.table.ball_radius + CLOSE
    near = []
    for a, b in combinations(range(len(record.ids)), 2):
        apart = np.linalg.norm(record.path[:, a] - record.path[:, b], axis=1)
        known = apart[np.isfinite(apart)]
        pair = (record.ids[a], record.ids[b])
        if len(known) and known.min() < reach and np.ptp(known) > CLOSE and frozenset(pair) not in met:
            near.append((float(known.min()), pair))
    called = [pair for _, pair in sorted(near)[:MOST_CLOSE]]
    return [(f"contact {a} {b}", call_answers.contact(record, a, b)) for a, b in called]


def flags_of(clip: Clip, scene: Scene, tracks: Tracks, fit: Fit) -> list[Flag]:
    """What the light came from, and what else may matter, each good or doubtful."""
    moving, held = int(fit.moving.sum()), int((fit.moving & fit.accepted).sum())
    share = held / moving if moving else 1.0
    px = float(np.nanmedian(tracks.sigma[tracks.observed])) if tracks.observed.any() else float("nan")
    scale = float(np.sqrt(abs(np.linalg.det(scene.camera.metres_per_pixel(_middle(scene), scene.table.ball_radius)))))
    pictures = f"{len(clip.distinct)} distinct of {clip.frame_count}, {float(clip.rate):.3f} per second"
    explained = f"{share:.0%} of their time" if moving else "nothing moves"
    noise = f"{1000 * fit.noise:.2f} mm ({fit.noise / scale:.2f} px)"
    return [
        Flag("Clip", "whole" if not clip.notes else " ".join(clip.notes), not clip.notes),
        Flag("Pictures", pictures, True),
        Flag("Table", f"{scene.table.name}, {scene.table.length:g} x {scene.table.width:g} m", not scene.doubts),
        Flag("Camera", "moves" if scene.camera.motion is not None else "stands still", scene.camera.motion is None),
        Flag("Moving balls explained by physics", explained, share >= GOOD_SHARE),
        Flag("Noise of a measured position", noise, fit.noise / scale <= GOOD_PX),
        Flag("Promised noise of a detection", f"{px / scale:.2f} px (median)", True),
        Flag("Chi-square per degree of freedom", f"{fit.chi2_per_dof:.2f}", fit.chi2_per_dof <= GOOD_CHI2),
        Flag(
            "Shutter clock",
            "irregular" if fit.trajectory.clock is not None else "regular",
            fit.trajectory.clock is None,
        ),
    ]


def _middle(scene: Scene) -> np.ndarray:
    return np.array([scene.table.length / 2, scene.table.width / 2])
