"""report.html of a rally: who won its last point, why, how sure that is, and all strokes; one self-contained page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path

import numpy as np

from models.core.fit_result import is_undecided
from models.core.number_format import format_probability, format_time
from models.core.rally import Rally
from models.estimation.rally.landing_judgement import judge_landing
from models.estimation.rally.stroke_summary import summarize_strokes
from pipeline.engine.atomic_write import write_text
from pipeline.reporting.figures.rally_figures import build_court_figure
from pipeline.reporting.pages.page_template import (
    build_jpeg_uri,
    embed_figure,
    embed_image_file,
    pack_plotly_source,
    render_template,
)
from pipeline.reporting.pages.run_report import PACKAGES, ReportFiles, find_seek_time
from pipeline.reporting.text.rally_sentences import (
    assess_rally_trust,
    format_landing,
    format_rally_event,
    format_rally_notes,
)
from pipeline.reporting.text.stroke_sentences import STROKE_HEADINGS, format_point, list_stroke_rows
from pipeline.reporting.text.text_formatting import start_sentence
from video.io.clip import Clip
from video.overlay.landing_close_up import draw_landing

# px, heights of the figures.
PLAN_HEIGHT, SIDE_HEIGHT = 460, 380


def write_rally_report(
    clip: Clip, rally: Rally, files: ReportFiles, title: str, settings: Sequence[str], path: Path
) -> None:
    """Write the page of a rally.

    Args:
        files: Slow motion and poster.
        title: Heading of the page.
        settings: Options that reproduce the run.
        path: File to write.
    """
    call, sport = judge_landing(rally), rally.scene.sport
    strokes, point = summarize_strokes(rally), format_point(rally, call)
    html = render_template(
        "rally.html",
        name=title,
        object=sport.object.name,
        point=point,
        light="green" if point.is_decided else "amber",
        trust=assess_rally_trust(rally),
        poster=embed_image_file(files.poster),
        video=files.slow,
        slow=files.slow_factor,
        start=files.start,
        events=_list_events(rally, files),
        landing=format_landing(call, rally),
        close_up="" if call.landing is None else build_jpeg_uri(draw_landing(clip, rally, call)),
        headings=STROKE_HEADINGS,
        strokes=[cells for _, cells in list_stroke_rows(rally, strokes)],
        plan=embed_figure(build_court_figure(rally, strokes, "above"), "plan", PLAN_HEIGHT),
        side=embed_figure(build_court_figure(rally, strokes, "side"), "side", SIDE_HEIGHT),
        ends="The {} end is on the left, the {} end on the right.".format(*sport.halves),
        notes=_list_notes(clip, rally),
        settings=list(settings),
        versions={name: version(name) for name in PACKAGES},
        digest=clip.digest,
        plotly=pack_plotly_source(),
    )
    write_text(path, html)


def _list_events(rally: Rally, files: ReportFiles) -> list[dict[str, str | float]]:
    """List the events; each seeks the video to shortly before it."""
    name = rally.scene.sport.object.name
    return [
        {
            "seek": find_seek_time(one.t, files),
            "at": round(max(one.t - files.start, 0.0) * files.slow_factor, 3),
            "time": format_time(one.t, one.t_sigma),
            "sentence": format_rally_event(one, name),
            "probability": format_probability(one.probability) if is_undecided(one.probability) else "",
        }
        for one in rally.events
    ]


def _list_notes(clip: Clip, rally: Rally) -> list[str]:
    """List what the quality of the answers depends on."""
    seen_count, camera = int(np.isfinite(rally.px[:, 0]).sum()), rally.scene.camera
    name = rally.scene.sport.object.name
    used = int(np.count_nonzero(rally.is_used))
    moves = "turns or zooms" if camera.motion is not None else "stands still"
    counted = f"{len(rally.t)} distinct frames of {clip.frame_count}, {float(clip.fps):.3f} fps."
    return [
        f"{rally.scene.sport.name.replace('-', ' ').capitalize()}; {counted}",
        f"The {name} was seen in {seen_count} frames; the flights were fitted to {used} of these.",
        f"The camera {moves}; its lines fit the court to {rally.scene.line_error:.2f} px.",
        *(f"{start_sentence(note)}." for note in format_rally_notes(rally)),
        *(start_sentence(note) for note in clip.notes),
    ]
