"""The figures of a diagnosis: a held-out path, the part of it that tells most, and where and how errors grow."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise
from types import MappingProxyType

import numpy as np
import plotly.graph_objects as go

from diagnosis.verdicts.verdict import Gap
from models.core.scene import Table
from models.core.typing import FloatArray
from pipeline.reporting.text.gap_sentences import length, shot_named

_RAIL = 0.05
"""m around the table that plans show."""
_AROUND = 3.0
"""times the error that it is drawn for, that an enlarged part reaches to each side."""
BEFORE, AFTER, SEEN, FRAME = "#c62828", "#0f5c42", "#55605a", "#1b2420"
Line = dict[str, str | float]
Span = tuple[float, float]
Moment = tuple[int, int]
"""Row of a window, and body."""


def figures(
    gap: Gap, table: Table | None = None, origins: Mapping[int, str] = MappingProxyType({})
) -> list[tuple[str, go.Figure]]:
    """Titles and figures, none where no shot was held out; shots have the names of their folders from `origins`."""
    if not gap.windows:
        return []
    drawn = _paths(gap, table, origins)
    foreseen = any(len(_misses(gap, k, gap.before)[1]) for k in range(len(gap.windows)))
    if foreseen:
        drawn.append(("How the error of a prediction grows", _growth(gap)))
    if foreseen and _is_plan(gap):
        drawn.append(("Where predictions go wrong", _map(gap, table)))
    return drawn


def _differ(gap: Gap) -> bool:
    """Whether anything was added to the simulator."""
    return any(not np.array_equal(a, b, equal_nan=True) for a, b in zip(gap.before, gap.after, strict=True))


def _is_plan(gap: Gap) -> bool:
    """Whether places have more than one coordinate: the first and the last are drawn."""
    return bool(gap.before[0].shape[2] > 1)


def _predictions(gap: Gap) -> list[tuple[str, tuple[FloatArray, ...], Line]]:
    """Label, paths by window and look of what was predicted."""
    before: Line = {"color": BEFORE, "width": 2, "dash": "dash"}
    if not _differ(gap):
        return [("predicted", gap.before, before)]
    return [("predicted before", gap.before, before), ("predicted after", gap.after, {"color": AFTER, "width": 2})]


def _worst(gap: Gap) -> int:
    errors = [_misses(gap, k, gap.before)[1] for k in range(len(gap.windows))]
    return int(np.argmax([float(np.mean(one)) if len(one) else 0.0 for one in errors]))


def _misses(gap: Gap, window: int, paths: tuple[FloatArray, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Time since the prediction began (K,), its error (K,) and place (K, D), of what was predicted and seen."""
    one = gap.windows[window]
    seen = one.piece.seen.copy()
    seen[: one.known] = False
    rows, _ = np.nonzero(seen)
    miss = np.linalg.norm((paths[window] - one.piece.places)[seen], axis=1)
    return one.piece.t[rows] - one.piece.t[one.known - 1], miss, one.piece.places[seen]


def _paths(gap: Gap, table: Table | None, origins: Mapping[int, str]) -> list[tuple[str, go.Figure]]:
    """The held-out window that is predicted worst; and enlarged, the part of it that tells most."""
    number = _worst(gap)
    both = " before and after" if _differ(gap) else ""
    moment = _telling(gap, number)
    part = None if moment is None else _around(gap, number, moment)
    whole = _path(gap, number, moment)
    if _is_plan(gap):
        _plan(whole, table, _unit(gap))
    drawn = [(f"Seen, and predicted{both}, on held-out {shot_named(gap.windows[number].piece.shot, origins)}", whole)]
    if part is not None:
        (left, right), (low, high) = part
        whole.add_shape(type="rect", x0=left, x1=right, y0=low, y1=high, line={"color": FRAME, "width": 1.5})
        close = _path(gap, number, moment).update_xaxes(range=[left, right])
        close.update_yaxes(range=[low, high] if table is None else [high, low])
        drawn.append((f"What the frame holds, enlarged: {high - low:.2g} {_unit(gap)} from top to bottom", close))
    return drawn


def _path(gap: Gap, number: int, moment: Moment | None) -> go.Figure:
    """What was seen in a window and what was predicted for it, and at a moment how far they part; of a single
    coordinate how it goes with time."""
    piece = gap.windows[number].piece
    figure = go.Figure()
    for body in range(len(piece.bodies)):
        drawn = [("seen", piece.places, {"mode": "markers", "marker": {"color": SEEN, "size": 6}})]
        predicted = [
            (label, paths[number], {"mode": "lines", "line": line}) for label, paths, line in _predictions(gap)
        ]
        drawn += reversed(predicted)  # what is dashed lets through what it hides
        for label, places, look in drawn:
            one = places[:, body]
            x = one[:, 0] if _is_plan(gap) else piece.t
            figure.add_scatter(x=x, y=one[:, -1], name=label, legendgroup=label, showlegend=body == 0, **look)
    if moment is not None:
        row, body = moment
        ends = np.stack([gap.before[number][row, body], piece.places[row, body]])
        off = f"off by {length(float(np.linalg.norm(ends[1] - ends[0])), gap.metric)} at this moment"
        x = ends[:, 0] if _is_plan(gap) else np.full(2, piece.t[row])
        figure.add_scatter(x=x, y=ends[:, -1], name=off, mode="lines+markers", line={"color": FRAME, "width": 2})
    if _is_plan(gap):
        figure.update_yaxes(scaleanchor="x")
    return figure.update_xaxes(title=_unit(gap) if _is_plan(gap) else "s").update_yaxes(title=_unit(gap))


def _telling(gap: Gap, number: int) -> Moment | None:
    """Where in a window what was added mends most, or where a prediction is off most; None where nothing is seen."""
    one = gap.windows[number]
    off = np.linalg.norm(gap.before[number] - one.piece.places, axis=2)
    mended = off - np.linalg.norm(gap.after[number] - one.piece.places, axis=2) if _differ(gap) else off
    later = np.where(np.arange(len(off))[:, None] >= one.known, mended, np.nan)
    if not np.isfinite(later).any():
        return None
    row, body = np.unravel_index(int(np.nanargmax(later)), later.shape)
    return int(row), int(body)


def _around(gap: Gap, number: int, moment: Moment) -> tuple[Span, Span] | None:
    """What to draw, across and up, where the error of a moment fills a sixth; None where that is half of all."""
    piece = gap.windows[number].piece
    predicted, seen = gap.before[number][moment], piece.places[moment]
    extent = float(np.ptp(piece.places[piece.seen], axis=0).max())
    reach = _AROUND * float(np.linalg.norm(predicted - seen))
    if not 0 < 4 * reach < extent:
        return None
    middle = (predicted + seen) / 2
    if _is_plan(gap):
        return _span(float(middle[0]), reach), _span(float(middle[-1]), reach)
    return _span(float(piece.t[moment[0]]), float(np.ptp(piece.t)) * reach / extent), _span(float(middle[0]), reach)


def _span(middle: float, reach: float) -> Span:
    return middle - reach, middle + reach


def _plan(figure: go.Figure, table: Table | None, unit: str) -> go.Figure:
    """Lengths alike along both axes; a table with its cushions, y downwards as in its picture."""
    figure.update_xaxes(title=unit)
    figure.update_yaxes(scaleanchor="x", title=unit)
    if table is not None:
        noses = {"x0": 0, "y0": 0, "x1": table.length, "y1": table.width}
        figure.add_shape(type="rect", **noses, line={"color": AFTER, "width": 3}, layer="below")
        across, up = [-_RAIL, table.length + _RAIL], [table.width + _RAIL, -_RAIL]
        figure.update_xaxes(range=across, constrain="domain", showgrid=False, zeroline=False)
        figure.update_yaxes(range=up, constrain="domain", showgrid=False, zeroline=False)
    return figure


def _growth(gap: Gap) -> go.Figure:
    figure = go.Figure()
    for label, paths, line in _predictions(gap):
        found = [_misses(gap, k, paths) for k in range(len(gap.windows))]
        t, miss = np.concatenate([one[0] for one in found]), np.concatenate([one[1] for one in found])
        edges = np.linspace(0, gap.horizon, 13)
        here = [(t > low) & (t <= high) for low, high in pairwise(edges)]
        rms = [float(1000 * np.sqrt(np.mean(np.square(miss[part])))) if part.any() else None for part in here]
        figure.add_scatter(x=(edges[1:] + edges[:-1]) / 2, y=rms, name=label, line=line, connectgaps=True)
    figure.update_xaxes(title="s since the prediction began")
    return figure.update_yaxes(title=f"rms error, m{_unit(gap)}", rangemode="tozero")


def _map(gap: Gap, table: Table | None) -> go.Figure:
    found = [_misses(gap, k, gap.before) for k in range(len(gap.windows))]
    miss, place = 1000 * np.concatenate([one[1] for one in found]), np.concatenate([one[2] for one in found])
    bar = {"title": f"error, m{_unit(gap)}"}
    marker = {"color": miss, "colorscale": "YlOrRd", "cmin": 0, "size": 6, "colorbar": bar}
    points = go.Scatter(x=place[:, 0], y=place[:, -1], mode="markers", marker=marker)
    return _plan(go.Figure(points), table, _unit(gap))


def _unit(gap: Gap) -> str:
    """Of a coordinate: m or rad."""
    return "rad" if gap.metric.endswith("rad") else "m"
