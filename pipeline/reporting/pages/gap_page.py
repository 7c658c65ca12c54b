"""gap.html: a diagnosis on one self-contained page, and its figures.

Figures are the worst predicted hold-out window, an enlarged part of it, growth and map of the errors, and the law of
what is missing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType

import numpy as np
import plotly.graph_objects as go

from diagnosis.fitting.display_names import (
    format_cause,
    format_growth_variable,
    format_parameter,
    format_phase,
)
from diagnosis.unexplained.force_law import ForceLaw
from diagnosis.unexplained.local_patch import LocalPatch
from diagnosis.verdicts.verdict import DiagnosisReport, Gap, Strength
from models.core.number_format import format_measured, format_unit
from models.core.scene import Table
from models.core.typing import FloatArray
from pipeline.engine.atomic_write import write_text
from pipeline.io.gap_files import PROFILE_FILE
from pipeline.io.simulators.mechanism_recordings import MechanismShots
from pipeline.reporting.pages.gap_place_figure import LineStyle, PredictedLine, build_place_figures
from pipeline.reporting.pages.page_template import embed_figure, pack_plotly_source, render_template
from pipeline.reporting.text import gap_sentences
from pipeline.reporting.text.text_formatting import escape_text, format_law

# Candidates in the list.
MAX_CANDIDATES = 8
# Height of a figure, px.
_FIGURE_HEIGHT = 420


def write_gap_page(
    report: DiagnosisReport,
    title: str,
    path: Path,
    table: Table | None = None,
    origins: Mapping[int, str] = MappingProxyType({}),
    shots: MechanismShots | None = None,
) -> None:
    """Write the page of a diagnosis.

    Args:
        report: Result of the diagnosis.
        title: Heading of the page.
        path: File to write; for a table, profile.json is in the same folder.
        table: The table, drawn in the plans; None for other scenes.
        origins: Folder names of the shots; empty if all are in one folder.
        shots: Simulator and inputs of a mechanism; None for other scenes.
    """
    patch, law = report.unexplained.patch, report.unexplained.law
    # With the verdict "none" nothing was added to the simulator: draw its prediction once.
    gap = replace(report.gap, after=report.gap.before) if report.verdict == "none" else report.gap
    causes, where = gap_sentences.list_causes(report), _list_places(report, origins)
    candidates, others = causes[:MAX_CANDIDATES], ", ".join(one.name for one in causes[MAX_CANDIDATES:])
    # what was assumed to read a log comes last, what is wrong in the file of a simulator first
    reading = 0 if shots is None else len(shots.notes)
    first, last = report.notes[: len(report.notes) - reading], report.notes[len(report.notes) - reading :]
    html = render_template(
        "gap.html",
        name=title,
        report=report,
        sentence=gap_sentences.format_verdict(report),
        closed=gap_sentences.format_gap_closure(report),
        first_notes=[f"{one[:1].upper()}{one[1:]}." for one in first] if reading else [],
        last_notes=last if reading else report.notes,
        shot_use=gap_sentences.format_shot_use(report),
        is_angle=report.gap.unit == "rad",
        candidates=candidates,
        other_candidates=others,
        has_detectable=any(one.detectable for one in candidates),
        has_rivals=any(one.rivals for one in candidates),
        strength_note=gap_sentences.format_strength_note(report),
        agreement=(*gap_sentences.format_body_differences(report), *gap_sentences.format_agreement(report)),
        where=where,
        has_mostly=any(one["mostly"] for one in where),
        has_growth=any(one["grows_with"] for one in where),
        unexplained=gap_sentences.format_unexplained(report),
        residual_p_value=gap_sentences.format_p_value(report.p_value),
        law="" if law is None else embed_figure(build_law_figure(law, report.gap.unit), "plot-law", _FIGURE_HEIGHT),
        law_variable="" if law is None else law.variable,
        per_effect=[
            (format_cause(one.effect), *map(gap_sentences.format_share, (one.closed, *one.interval, one.alone)))
            for one in report.per_effect
        ],
        plots=[
            (caption, embed_figure(figure, f"plot-{k}", _FIGURE_HEIGHT))
            for k, (caption, figure) in enumerate(build_gap_figures(gap, table, origins, patch, shots))
        ],
        fitted=[_format_parameter(one) for one in report.fitted if _is_listed(one, report)],
        numbered=gap_sentences.format_shot_folders(origins),
        laws=" and ".join(format_law(name) for name in report.forms),
        model=gap_sentences.format_assumed_effects(report),
        undecided=gap_sentences.format_undecided(report),
        profile=escape_text(path.parent / PROFILE_FILE) if table is not None and report.fitted else "",
        plotly=pack_plotly_source(),
    )
    write_text(path, gap_sentences.name_runs_in_page(report.scene, html))


def _list_places(report: DiagnosisReport, origins: Mapping[int, str]) -> list[dict[str, str]]:
    """List where the gap appears, as table rows, with the body and the shot that contribute most."""
    word, rows = {"billiards": "ball", "mechanism": "joint"}.get(report.scene, "body"), []
    for one in report.where:
        body = "" if one.ball is None else f"{word} {one.ball}"
        shot = "" if one.shot is None else gap_sentences.format_shot_name(one.shot, origins)
        growth = format_growth_variable(one.grows_with or "")
        rows.append(
            {
                "phase": format_phase(one.phase), "share": gap_sentences.format_share(one.share),
                "mostly": ", ".join(filter(None, (body, shot))), "grows_with": growth,
            }
        )  # fmt: skip
    return rows


def _is_listed(one: Strength, report: DiagnosisReport) -> bool:
    """Return whether a parameter is listed; a parameter that the contact models do not use is not."""
    effect = one.name.partition(".")[0]
    unused = one.prior_only and not math.isfinite(one.detectable_from)
    return not unused or effect in (*report.model, *report.effects)


def _format_parameter(one: Strength) -> dict[str, str]:
    """Format a parameter as a table row; a parameter that is not identifiable has no value."""
    name, unit = format_parameter(one.name), format_unit(one.unit)
    if one.prior_only:
        return {"name": name, "unidentified": gap_sentences.format_unidentified(one)}
    value, sigma = format_measured(one.value, one.sigma)
    return {"name": name, "unidentified": "", "value": value, "sigma": sigma, "unit": unit}


# m, margin around the table in plans.
_PLAN_MARGIN = 0.05
# Ratios of width to height, and of height to width, beyond which the scales of a path differ: else it is a stroke.
# Figures are wide, so that upright paths become strokes sooner.
_MAX_LENGTH_RATIO, _MAX_HEIGHT_RATIO = 10.0, 3.0
# Colours of errors from none to the largest: all of them dark enough for dots on white.
_ERROR_COLOURS = [[0.0, "#4f8fd0"], [0.5, "#8e3fa8"], [1.0, "#b00020"]]
# Half the size of the enlarged part, in multiples of the error in its middle.
_ZOOM_REACH = 3.0
BEFORE, AFTER, OBSERVED, FRAME = "#c62828", "#0f5c42", "#55605a", "#1b2420"
Interval = tuple[float, float]
# Row of a window and index of a body.
Moment = tuple[int, int]


def build_gap_figures(
    gap: Gap,
    table: Table | None = None,
    origins: Mapping[int, str] = MappingProxyType({}),
    patch: LocalPatch | None = None,
    shots: MechanismShots | None = None,
) -> list[tuple[str, go.Figure]]:
    """Build the figures of a diagnosis.

    Args:
        gap: Predictions of the hold-out windows before and after effects were added.
        table: The table, drawn in the plans; None for other scenes.
        origins: Folder names of the shots; empty if all are in one folder.
        patch: Where bodies are braked more, or less, than around it; drawn in the map of the errors.
        shots: Simulator and inputs of a mechanism; None for other scenes.

    Returns:
        Titles and figures; none without hold-out shots.
    """
    if not gap.windows:
        return []
    drawn = _build_path_figures(gap, table, origins)
    has_predictions = any(len(_prediction_errors(gap, k, gap.before)[1]) for k in range(len(gap.windows)))
    if has_predictions:
        drawn.append(("How the prediction error grows", _draw_error_growth(gap)))
    if has_predictions and shots is not None:
        drawn = [*build_place_figures(gap, shots, _list_predictions(gap)), *drawn]
    if has_predictions and _is_plan(gap):
        drawn += _build_error_maps(gap, table, patch)
    return drawn


def _has_added_effects(gap: Gap) -> bool:
    """Return whether effects were added to the simulator."""
    return any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(gap.before, gap.after, strict=True))


def _is_plan(gap: Gap) -> bool:
    """Return whether positions have several coordinates; the first and the last are drawn."""
    return bool(gap.before[0].shape[2] > 1)


def _list_predictions(gap: Gap) -> list[PredictedLine]:
    """List label, paths by window and line style of the predictions."""
    before: LineStyle = {"color": BEFORE, "width": 2, "dash": "dash"}
    if not _has_added_effects(gap):
        return [("predicted", gap.before, before)]
    return [("predicted before", gap.before, before), ("predicted after", gap.after, {"color": AFTER, "width": 2})]


def _prediction_errors(
    gap: Gap, window: int, paths: tuple[FloatArray, ...]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return time since the start (K,), error (K,) and position (K, D) of the observed predictions of a window."""
    one = gap.windows[window]
    is_predicted = one.is_predicted
    rows, _ = np.nonzero(is_predicted)
    errors = np.linalg.norm((paths[window] - one.segment.positions)[is_predicted], axis=1)
    return one.segment.t[rows] - one.segment.t[one.start_rows - 1], errors, one.segment.positions[is_predicted]


def _build_path_figures(gap: Gap, table: Table | None, origins: Mapping[int, str]) -> list[tuple[str, go.Figure]]:
    """Draw the hold-out window with the largest prediction error, and an enlarged part of it."""
    errors = [_prediction_errors(gap, k, gap.before)[1] for k in range(len(gap.windows))]
    number = int(np.argmax([float(np.mean(one)) if len(one) else 0.0 for one in errors]))
    both = " before and after" if _has_added_effects(gap) else ""
    moment = _find_key_moment(gap, number)
    part = None if moment is None else _compute_zoom(gap, number, moment)
    whole = _draw_window_path(gap, number, moment)
    if _is_plan(gap):
        _format_plan(whole, table)
    shot = gap_sentences.format_shot_name(gap.windows[number].segment.shot, origins)
    unequal = _note_scales(whole) if _is_plan(gap) else ""
    segment = gap.windows[number].segment
    joint = (
        f", {segment.bodies[moment[1]]}" if moment is not None and not _is_plan(gap) and len(segment.bodies) > 1 else ""
    )
    drawn = [(f"Observed, and predicted{both}, on hold-out {shot}{joint}{unequal}", whole)]
    if part is not None:
        (left, right), (low, high) = part
        whole.add_shape(type="rect", x0=left, x1=right, y0=low, y1=high, line={"color": FRAME, "width": 1.5})
        close = _draw_window_path(gap, number, moment).update_xaxes(range=[left, right])
        close.update_yaxes(
            range=[low, high] if table is None else [high, low], scaleanchor=whole.layout.yaxis.scaleanchor
        )
        drawn.append((f"Inside the rectangle, enlarged: {high - low:.2g} {gap.unit} from top to bottom", close))
    return drawn


def _draw_window_path(gap: Gap, number: int, moment: Moment | None) -> go.Figure:
    """Draw observations and predictions of a window, and the error at one moment; a single coordinate over time."""
    piece = gap.windows[number].segment
    figure = go.Figure()
    # over time, paths of several joints would hide each other
    bodies = range(len(piece.bodies)) if _is_plan(gap) or moment is None else moment[1:]
    for body in bodies:
        drawn = [("observed", piece.positions, {"mode": "markers", "marker": {"color": OBSERVED, "size": 6}})]
        predicted = [
            (label, paths[number], {"mode": "lines", "line": line}) for label, paths, line in _list_predictions(gap)
        ]
        drawn += reversed(predicted)  # dashed lines last: they do not hide the others
        for label, places, look in drawn:
            one = places[:, body]
            x = one[:, 0] if _is_plan(gap) else piece.t
            figure.add_scatter(
                x=x, y=one[:, -1], name=label, legendgroup=label, showlegend=body == bodies[0], **look
            )  # fmt: skip
    if moment is not None:
        row, body = moment
        ends = np.stack([gap.before[number][row, body], piece.positions[row, body]])
        size = gap_sentences.format_error_size(float(np.linalg.norm(ends[1] - ends[0])), gap.metric)
        off = f"error{' before' if _has_added_effects(gap) else ''}, {size} at {piece.t[row]:.2f} s"
        x = ends[:, 0] if _is_plan(gap) else np.full(2, piece.t[row])
        figure.add_scatter(x=x, y=ends[:, -1], name=off, mode="lines+markers", line={"color": FRAME, "width": 2})
    if _is_plan(gap) and _has_equal_scales(piece.positions[piece.is_observed]):
        figure.update_yaxes(scaleanchor="x")
    across, up = _name_axes(gap)
    return figure.update_xaxes(title=across if _is_plan(gap) else "time (s)").update_yaxes(title=up)


def _name_axes(gap: Gap) -> tuple[str, str]:
    """Return the titles of the first and the last coordinate."""
    words = {"z": "height z", "theta1": "angle theta1", "theta2": "angle theta2"}
    ends = gap.coordinates[0], gap.coordinates[-1]
    first, last = (f"{words.get(name, name)} ({gap.unit})" for name in ends)
    return first, last


def _has_equal_scales(places: FloatArray) -> bool:
    """Return whether both coordinates of places (K, D) extend far enough to be drawn with equal scales."""
    across, up = float(np.ptp(places[:, 0])), float(np.ptp(places[:, -1]))
    return across <= _MAX_LENGTH_RATIO * up and up <= _MAX_HEIGHT_RATIO * across


def _note_scales(figure: go.Figure) -> str:
    """Return an addition to the title of a plan whose axes have different scales; empty where they are equal."""
    return "" if figure.layout.yaxis.scaleanchor else " (the axes have different scales)"


def _find_key_moment(gap: Gap, number: int) -> Moment | None:
    """Return where the added effects reduce the error most, or where it is largest; None without observations."""
    one = gap.windows[number]
    off = np.linalg.norm(gap.before[number] - one.segment.positions, axis=2)
    mended = off - np.linalg.norm(gap.after[number] - one.segment.positions, axis=2) if _has_added_effects(gap) else off
    later = np.where(np.arange(len(off))[:, None] >= one.start_rows, mended, np.nan)
    if not np.isfinite(later).any():
        return None
    row, body = np.unravel_index(int(np.nanargmax(later)), later.shape)
    return int(row), int(body)


def _compute_zoom(gap: Gap, number: int, moment: Moment) -> tuple[Interval, Interval] | None:
    """Return the axis ranges of an enlarged view around an error; None if it would show most of the window."""
    piece = gap.windows[number].segment
    predicted, observed = gap.before[number][moment], piece.positions[moment]
    extent = float(np.ptp(piece.positions[piece.is_observed], axis=0).max())
    reach = _ZOOM_REACH * float(np.linalg.norm(predicted - observed))
    if not 0 < 4 * reach < extent:
        return None
    across, up = ((float(x - reach), float(x + reach)) for x in (predicted + observed)[[0, -1]] / 2)
    if not _is_plan(gap):
        t, span = float(piece.t[moment[0]]), float(np.ptp(piece.t)) * reach / extent
        across = t - span, t + span
    return across, up


def _format_plan(figure: go.Figure, table: Table | None) -> go.Figure:
    """With a table, draw its cushions with equal scales and let y run down as in the image."""
    if table is not None:
        figure.update_yaxes(scaleanchor="x")
        noses = {"x0": 0, "y0": 0, "x1": table.length, "y1": table.width}
        figure.add_shape(type="rect", **noses, line={"color": AFTER, "width": 3}, layer="below")
        across, up = [-_PLAN_MARGIN, table.length + _PLAN_MARGIN], [table.width + _PLAN_MARGIN, -_PLAN_MARGIN]
        figure.update_xaxes(range=across, constrain="domain", showgrid=False, zeroline=False)
        figure.update_yaxes(range=up, constrain="domain", showgrid=False, zeroline=False)
    return figure


def compute_error_growth(gap: Gap, paths: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
    """Compute how the error of predictions grows.

    Args:
        gap: Hold-out windows.
        paths: Predicted positions (T, N, D) of each window.

    Returns:
        (12,) times since the start of the prediction, s; (12,) rms error around them, m or rad; NaN for none.
    """
    parts = [_prediction_errors(gap, k, paths) for k in range(len(gap.windows))]
    t, miss = np.concatenate([one[0] for one in parts]), np.concatenate([one[1] for one in parts])
    edges = np.linspace(0, gap.horizon, 13)
    here = [(t > low) & (t <= high) for low, high in pairwise(edges)]
    rms = [np.sqrt(np.mean(np.square(miss[part]))) if part.any() else np.nan for part in here]
    return (edges[1:] + edges[:-1]) / 2, np.array(rms)


def _draw_error_growth(gap: Gap) -> go.Figure:
    figure = go.Figure()
    for label, paths, line in _list_predictions(gap):
        t, rms = compute_error_growth(gap, paths)
        shown = [None if np.isnan(value) else 1000 * float(value) for value in rms]
        figure.add_scatter(x=t, y=shown, name=label, line=line, connectgaps=True)
    floor, dotted = gap.closure.floor, {"color": OBSERVED, "width": 1.5, "dash": "dot"}
    if np.isfinite(floor):
        label = "attainable, over all times"
        figure.add_scatter(x=[0, gap.horizon], y=[1000 * floor] * 2, name=label, mode="lines", line=dotted)
    figure.update_xaxes(title="time since the start of the prediction (s)")
    return figure.update_yaxes(title=f"rms error at that time (m{gap.unit})", rangemode="tozero")


def build_law_figure(law: ForceLaw, unit: str) -> go.Figure:
    """Draw an unexplained acceleration over the quantity with which it varies, with its standard deviations.

    The fitted curve is drawn where it explains most of the acceleration.

    Args:
        unit: Unit of a coordinate, m or rad.

    Returns:
        The figure.
    """
    units = {"speed": f"{unit}/s", "time": "s"}
    bars = {"type": "data", "array": law.sigma}
    points = go.Scatter(x=law.at, y=law.acceleration, error_y=bars, mode="markers", marker={"color": BEFORE})
    fitted = [go.Scatter(x=law.curve[0], y=law.curve[1], mode="lines", line={"color": AFTER})]
    figure = go.Figure(
        [points, *(fitted if gap_sentences.explains_most(law) else [])], {"showlegend": False}
    ).add_hline(0, line={"color": OBSERVED, "width": 1})
    figure.update_xaxes(title=f"{law.variable} ({units.get(law.variable, unit)})")
    return figure.update_yaxes(title=f"missing acceleration {gap_sentences.format_law_direction(law)} ({unit}/s²)")


def _build_error_maps(gap: Gap, table: Table | None, patch: LocalPatch | None) -> list[tuple[str, go.Figure]]:
    """Draw where predictions are wrong, before and after effects were added, with the same colours."""
    largest = max(float(_gather_errors(gap, paths)[0].max()) for _, paths, _ in _list_predictions(gap))
    before = _draw_error_map(gap, gap.before, largest, table, patch)
    if not _has_added_effects(gap):
        return [(f"Where predictions are wrong{_note_scales(before)}", before)]
    after = _draw_error_map(gap, gap.after, largest, table, patch)
    return [
        (f"Where predictions of your simulator are wrong, before{_note_scales(before)}", before),
        (f"Where predictions of the improved simulator are wrong, after: the same colours{_note_scales(after)}", after),
    ]


def _gather_errors(gap: Gap, paths: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray]:
    """Return errors (K,), mm or mrad, and positions (K, D) of all predictions, the largest errors last."""
    parts = [_prediction_errors(gap, k, paths) for k in range(len(gap.windows))]
    miss, place = 1000 * np.concatenate([one[1] for one in parts]), np.concatenate([one[2] for one in parts])
    order = np.argsort(miss, kind="stable")
    return miss[order], place[order]


def _draw_error_map(
    gap: Gap, paths: tuple[FloatArray, ...], largest: float, table: Table | None, patch: LocalPatch | None
) -> go.Figure:
    """Draw errors as colours up to the `largest` at their places; large errors lie on top."""
    miss, place = _gather_errors(gap, paths)
    bar = {"title": f"error (m{gap.unit})"}
    marker = {"color": miss, "colorscale": _ERROR_COLOURS, "cmin": 0, "cmax": largest, "size": 6, "colorbar": bar}
    points = go.Scatter(x=place[:, 0], y=place[:, -1], mode="markers", marker=marker)
    across, up = _name_axes(gap)
    figure = go.Figure(points).update_xaxes(title=across).update_yaxes(title=up)
    if patch is not None or _has_equal_scales(place):  # a disc is drawn as a circle
        figure.update_yaxes(scaleanchor="x")
    if patch is not None:
        _add_patch(figure, patch)
    return _format_plan(figure, table)


def _add_patch(figure: go.Figure, patch: LocalPatch) -> None:
    """Add the disc of a patch, dotted one standard deviation of its radius inside and outside, and its centre."""
    for off, dash, width in ((0.0, "solid", 2), (-patch.radius_sigma, "dot", 1), (patch.radius_sigma, "dot", 1)):
        if patch.radius + off > 0:  # not where the error is unknown, or larger than the radius
            (left, top), (right, bottom) = patch.centre - patch.radius - off, patch.centre + patch.radius + off
            line = {"color": FRAME, "width": width, "dash": dash}
            figure.add_shape(type="circle", x0=left, y0=top, x1=right, y1=bottom, line=line)
    across, down = ({"type": "data", "array": [sigma], "color": FRAME} for sigma in patch.centre_sigma.tolist())
    figure.add_scatter(
        x=patch.centre[:1], y=patch.centre[1:], error_x=across, error_y=down, mode="markers",
        marker={"color": FRAME, "size": 5},
    ).update_layout(showlegend=False)  # fmt: skip
