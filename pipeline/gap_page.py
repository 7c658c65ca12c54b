"""gap.html: the diagnosis on one self-contained page that a coach can read."""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from numpy.typing import NDArray

from diagnosis.verdict import Candidate, Gap, Report
from models.scene import Table
from pipeline.gap_words import causes, closed_sentence, gap_sentence, plain, strengths, with_unit
from pipeline.page import embedded, plotly_source, render
from pipeline.publish import aside

Floats = NDArray[np.float64]

SHOWN = 8
"""candidates in the list"""
_RAIL = 0.05
"""m around the table that plans show."""
BEFORE, AFTER, SEEN = "#c62828", "#0f5c42", "#55605a"


def write_gap_page(report: Report, title: str, path: Path, table: Table | None = None) -> None:
    """Write the page to `path`; plans show the table, where there is one."""
    html = render(
        "gap.html",
        name=title,
        report=report,
        sentence=gap_sentence(report),
        closed=closed_sentence(report),
        candidates=[_row(one) for one in causes(report)[:SHOWN]],
        plots=_plots(report.gap, table),
        plotly=plotly_source(),
    )
    with aside(path) as target:
        target.write_text(html, encoding="utf-8")


def _row(one: Candidate) -> dict[str, str | float]:
    seen = [
        f"{plain(s.name)} {with_unit(f'{s.detectable_from:.2g}', s.unit)}"
        for s in one.strengths
        if np.isfinite(s.detectable_from)
    ]
    return {
        "name": plain(one.effect),
        "probability": one.probability,
        "group": ", ".join(plain(name) for name in one.group[1:]),
        "strength": strengths(one),
        "detectable": "; ".join(seen),
    }


def _plots(gap: Gap, table: Table | None = None) -> list[tuple[str, str]]:
    """Titles and figures: a held-out path, the error as it grows, and where it is made."""
    if not gap.windows:
        return []
    both = "before and after, " if _differ(gap) else ""
    figures = [(f"Seen, and predicted {both}on a held-out shot", _path(gap, table))]
    foreseen = any(len(_misses(gap, k, gap.before)[1]) for k in range(len(gap.windows)))
    if foreseen:
        figures.append(("How the error of a prediction grows", _growth(gap)))
    if foreseen and gap.before[0].shape[2] >= 2:
        figures.append(("Where predictions go wrong", _map(gap, table)))
    return [(title, embedded(figure, f"plot-{k}", 420)) for k, (title, figure) in enumerate(figures)]


def _differ(gap: Gap) -> bool:
    """Whether anything was added to the simulator."""
    return any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(gap.before, gap.after, strict=True))


def _predictions(gap: Gap) -> list[tuple[str, tuple[Floats, ...], str]]:
    """Label, paths and colour of what there is to draw."""
    if not _differ(gap):
        return [("predicted", gap.before, BEFORE)]
    return [("predicted before", gap.before, BEFORE), ("predicted after", gap.after, AFTER)]


def _worst(gap: Gap) -> int:
    errors = [_misses(gap, k, gap.before)[1] for k in range(len(gap.windows))]
    return int(np.argmax([float(np.mean(one)) if len(one) else 0.0 for one in errors]))


def _misses(gap: Gap, window: int, paths: tuple[Floats, ...]) -> tuple[Floats, Floats, Floats]:
    """Time since the prediction began (K,), its error (K,) and place (K, D), of what was predicted and seen."""
    one = gap.windows[window]
    seen = one.piece.seen.copy()
    seen[: one.known] = False
    rows, _ = np.nonzero(seen)
    miss = np.linalg.norm((paths[window] - one.piece.places)[seen], axis=1)
    return one.piece.t[rows] - one.piece.t[one.known - 1], miss, one.piece.places[seen]


def _path(gap: Gap, table: Table | None) -> go.Figure:
    number = _worst(gap)
    one = gap.windows[number]
    figure = go.Figure()
    for body in range(len(one.piece.bodies)):
        predicted = [(label, paths[number], colour) for label, paths, colour in _predictions(gap)]
        for label, values, colour in (("seen", one.piece.places, SEEN), *predicted):
            part = values[:, body]
            across, up = (part[:, 0], part[:, 1]) if part.shape[1] > 1 else (one.piece.t, part[:, 0])
            mode = "markers" if label == "seen" else "lines"
            figure.add_scatter(
                x=across, y=up, mode=mode, name=label, legendgroup=label, showlegend=body == 0,
                line={"color": colour}, marker={"color": colour, "size": 5},
            )  # fmt: skip
    return _plan(figure, table) if one.piece.places.shape[2] > 1 else figure.update_xaxes(title="s")


def _plan(figure: go.Figure, table: Table | None) -> go.Figure:
    """Metres alike along both axes; a table with its cushions, y downwards as in its picture."""
    figure.update_xaxes(title="m")
    figure.update_yaxes(scaleanchor="x", title="m")
    if table is not None:
        noses = {"x0": 0, "y0": 0, "x1": table.length, "y1": table.width}
        figure.add_shape(type="rect", **noses, line={"color": AFTER, "width": 3}, layer="below")
        figure.update_xaxes(range=[-_RAIL, table.length + _RAIL], showgrid=False, zeroline=False)
        figure.update_yaxes(range=[table.width + _RAIL, -_RAIL], showgrid=False, zeroline=False)
    return figure


def _growth(gap: Gap) -> go.Figure:
    figure = go.Figure()
    for label, paths, colour in _predictions(gap):
        found = [_misses(gap, k, paths) for k in range(len(gap.windows))]
        t, miss = np.concatenate([one[0] for one in found]), np.concatenate([one[1] for one in found])
        edges = np.linspace(0, gap.horizon, 13)
        here = [(t > low) & (t <= high) for low, high in pairwise(edges)]
        rms = [float(1000 * np.sqrt(np.mean(np.square(miss[part])))) if part.any() else None for part in here]
        figure.add_scatter(x=(edges[1:] + edges[:-1]) / 2, y=rms, name=label, line={"color": colour}, connectgaps=True)
    figure.update_xaxes(title="s since the prediction began")
    return figure.update_yaxes(
        title="rms error, mrad" if gap.metric.endswith("rad") else "rms error, mm", rangemode="tozero"
    )


def _map(gap: Gap, table: Table | None) -> go.Figure:
    found = [_misses(gap, k, gap.before) for k in range(len(gap.windows))]
    miss, place = 1000 * np.concatenate([one[1] for one in found]), np.concatenate([one[2] for one in found])
    unit = "mrad" if gap.metric.endswith("rad") else "mm"
    marker = {"color": miss, "colorscale": "YlOrRd", "cmin": 0, "size": 6, "colorbar": {"title": f"error, {unit}"}}
    return _plan(go.Figure(go.Scatter(x=place[:, 0], y=place[:, 1], mode="markers", marker=marker)), table)
