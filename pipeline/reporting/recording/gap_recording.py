"""gap.rrd: prediction errors of the user's simulator for the rerun viewer, as layers of a run or on their own."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from diagnosis.verdicts.verdict import DiagnosisReport, Gap
from models.core.errors import OptionError
from models.core.number_format import format_probability
from models.core.typing import FloatArray
from pipeline.engine.atomic_write import replace_file
from pipeline.io.run_folder import read_scene_document
from pipeline.reporting.recording.recorded_shot import VIDEO_TIME, finish_stream, open_stream
from pipeline.reporting.text.gap_sentences import format_gap_closure, format_verdict, list_causes
from video.drawing.palette import Colour, mix_colours

BEFORE, AFTER = (230, 80, 70), (70, 190, 130)
SMALL_ERROR_COLOUR, LARGE_ERROR_COLOUR = (255, 225, 130), (200, 20, 40)
"""Colours of no error and of a large one."""
LARGE_ERROR_QUANTILE = 0.95
"""Quantile of the errors that has the colour of a large error."""


@dataclass(frozen=True, slots=True)
class WindowErrors:
    """K hold-out observations of one window with their predictions."""

    shot: int
    t: FloatArray
    """(K,) s"""
    elapsed: FloatArray
    """(K,) s since the start of the prediction."""
    observed: FloatArray
    """(K, 2) as drawn, the second axis down: first and last coordinate, or time and the only coordinate."""
    before: FloatArray
    """(K, 2)"""
    after: FloatArray
    """(K, 2)"""
    error_before: FloatArray
    """(K,) m or rad."""
    error_after: FloatArray
    """(K,)"""


def write_gap_recording(report: DiagnosisReport, inputs: Sequence[Path], path: Path) -> None:
    """Write the layers of a diagnosis; for a single run folder they are shown in the recording of that run.

    Args:
        report: Result of the diagnosis.
        inputs: Folders that were diagnosed.
        path: File to write (.rrd).
    """
    digest = read_clip_digest(inputs[0]) if len(inputs) == 1 else None
    joins = digest is not None
    own = hashlib.sha256("\n".join(str(one.resolve()) for one in inputs).encode("utf-8", "replace")).hexdigest()
    stream = open_stream(digest or own, f"gap: {inputs[0].resolve().name}")
    with replace_file(path) as fresh:
        stream.save(fresh, default_blueprint=None if joins else _build_gap_blueprint(report))
        _log_errors(stream, compute_window_errors(report.gap, down=report.scene == "billiards"), report.gap)
        _log_summary(stream, report)
        finish_stream(stream, path)


def read_clip_digest(folder: Path) -> str | None:
    """Read the SHA-256 of the clip of a run folder; None for any other folder."""
    try:
        digest = (read_scene_document(folder / "scene.json").get("clip") or {}).get("sha256")
    except OptionError:  # another kind of scene, or none: not a run folder
        return None
    return digest if isinstance(digest, str) and (folder / "recording.rrd").is_file() else None


def compute_window_errors(gap: Gap, *, down: bool) -> list[WindowErrors]:
    """Compute the prediction errors of every hold-out window.

    The second axis of the viewer runs down, as y of a table does; for other scenes (`down` False) it is flipped.
    """
    windows = []
    turn = np.array([1.0, 1.0 if down else -1.0])
    for one, before, after in zip(gap.windows, gap.before, gap.after, strict=True):
        is_predicted = one.is_predicted
        rows, _ = np.nonzero(is_predicted)
        if not len(rows):
            continue
        t = one.segment.t[rows]
        places = [values[is_predicted] for values in (one.segment.positions, before, after)]
        drawn = [np.stack([t if part.shape[1] == 1 else part[:, 0], part[:, -1]], axis=1) * turn for part in places]
        misses = [np.linalg.norm(part - places[0], axis=1) for part in places[1:]]
        windows.append(WindowErrors(one.segment.shot, t, t - one.segment.t[one.start_rows - 1], *drawn, *misses))
    return windows


def _log_errors(stream: rr.RecordingStream, windows: list[WindowErrors], gap: Gap) -> None:
    scale = 1000.0  # mm or mrad
    unit = "mrad" if gap.metric.endswith("rad") else "mm"
    if not windows:
        return
    errors = np.concatenate([one.error_before for one in windows])
    observed = np.concatenate([one.observed for one in windows])
    worst = max(float(np.quantile(errors, LARGE_ERROR_QUANTILE)), 1e-12)
    colours = [error_colour(float(value) / worst) for value in errors]
    arrows = np.concatenate([one.before - one.observed for one in windows])
    dots = rr.Points2D(observed, colors=colours, radii=rr.Radius.ui_points(2.5))
    stream.log("plan/gap/places", dots, rr.AnyValues(**{f"miss_{unit}": scale * errors}), static=True)
    drawn = rr.Arrows2D(origins=observed, vectors=arrows, colors=colours, radii=rr.Radius.ui_points(0.6))
    stream.log("plan/gap/misses", drawn, static=True)
    for number, one in enumerate(windows):
        _log_window(stream, f"shot-{one.shot:03d}/{number:03d}", one, scale)


def _log_window(stream: rr.RecordingStream, name: str, one: WindowErrors, scale: float) -> None:
    """Log predictions as points that move with time, and their error over time."""
    moments = np.unique(one.t)
    times = [rr.TimeColumn(VIDEO_TIME, duration=moments)]
    counts = np.array([np.sum(one.t == t) for t in moments])
    order = np.argsort(one.t, kind="stable")
    for what, places, miss, colour in (
        ("before", one.before, one.error_before, BEFORE),
        ("after", one.after, one.error_after, AFTER),
    ):
        points = rr.Points2D.columns(positions=places[order]).partition(counts)
        stream.send_columns(f"plan/gap/{what}/{name}", times, points)
        look = rr.Points2D.from_fields(colors=colour, radii=rr.Radius.ui_points(4.0))
        stream.log(f"plan/gap/{what}/{name}", look, static=True)
        rms = np.array([np.sqrt(np.mean(miss[one.t == t] ** 2)) for t in moments])
        entity = f"plots/gap/{what}/{name}"
        stream.log(entity, rr.SeriesLines(colors=colour, names=f"{what}, shot {one.shot}", widths=1.0), static=True)
        stream.send_columns(entity, times, rr.Scalars.columns(scalars=scale * rms))


def error_colour(share: float) -> Colour:
    """Return the colour of an error; a share of 1 is a large error."""
    return mix_colours(SMALL_ERROR_COLOUR, LARGE_ERROR_COLOUR, float(np.clip(share, 0.0, 1.0)))


def _log_summary(stream: rr.RecordingStream, report: DiagnosisReport) -> None:
    lines = [f"# {format_verdict(report)}", "", format_gap_closure(report), "", report.film_next, ""]
    lines += ["| effect | probability | strength |", "|---|---|---|"]
    lines += [
        f"| {one.name} | {format_probability(one.probability)} | {one.strength} |" for one in list_causes(report)[:8]
    ]
    lines += [
        "",
        "Dots: hold-out observations; arrows: to their predictions. Red: before, green: after the effects were added.",
    ]
    stream.log("gap", rr.TextDocument("\n".join(lines), media_type=rr.MediaType.MARKDOWN), static=True)
    stream.set_time(VIDEO_TIME, duration=0.0)
    stream.log("log/chain/diagnose", rr.TextLog(f"diagnose: {format_verdict(report)}", level=rr.TextLogLevel.WARN))
    stream.reset_time()


def _build_gap_blueprint(report: DiagnosisReport) -> rrb.Blueprint:
    unit = "mrad" if report.gap.metric.endswith("rad") else "mm"
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="plan", name="Where predictions are wrong"),
            rrb.Vertical(
                rrb.TextDocumentView(origin="gap", name="The gap"),
                rrb.TimeSeriesView(
                    origin="plots/gap",
                    name=f"Prediction error ({unit})",
                    plot_legend=rrb.PlotLegend(rrb.Corner2D.LeftTop),
                ),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=VIDEO_TIME, state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        rrb.SelectionPanel(state="collapsed"),
    )
