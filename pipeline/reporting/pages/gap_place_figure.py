"""Where the predictions of a mechanism are wrong: by joint, phase, speed, position, time and input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from diagnosis.fitting.display_names import format_phase
from diagnosis.verdicts.verdict import Gap
from models.core.typing import FloatArray, IntArray
from models.estimation.gap_scenes.simulator_scene import find_reversals
from pipeline.io.simulators.mechanism_recordings import MechanismShots

LineStyle = Mapping[str, str | float]
# Label, predicted positions by window, and look.
PredictedLine = tuple[str, tuple[FloatArray, ...], LineStyle]
# Motion and reversal, as axes name them.
_PHASES = tuple(format_phase(name).replace(" joints ", " joints<br>") for name in ("motion", "reversal"))
# Bins of a quantity, of equal numbers of predictions, and the least number of predictions in one.
_BINS, _MIN_IN_BIN = 8, 5
_COLUMNS = 3


@dataclass(frozen=True, slots=True)
class _Predictions:
    """Predictions of K observations."""

    joint: IntArray
    """(K,) its number."""
    squares: Mapping[str, FloatArray]
    """(K,) squared errors, before and after."""
    is_reversal: IntArray
    """(K,) 1 where the joint turns back."""
    quantities: Mapping[str, FloatArray]
    """(K,) by name; NaN where it is not known."""


def build_place_figures(gap: Gap, shots: MechanismShots, lines: Sequence[PredictedLine]) -> list[tuple[str, go.Figure]]:
    """Draw the rms error of held-out predictions by joint and phase, and over speed, position, time and input.

    Args:
        gap: Predictions of the hold-out windows.
        shots: Simulator and inputs.
        lines: Label, predicted positions by window, and look of each prediction.

    Returns:
        Titles and figures; of several joints, the second figure is of the one with the largest error.
    """
    predictions = _gather_predictions(gap, shots, lines)
    names = gap.windows[0].segment.bodies
    worst = int(np.argmax(np.bincount(predictions.joint, predictions.squares[lines[0][0]], len(names))))
    own = predictions.joint == worst
    units = {"speed": f"{gap.unit}/s", "position": gap.unit, "time in the run": "s"}
    panels = ["phase", *(name for name, values in predictions.quantities.items() if np.isfinite(values[own]).any())]
    titles = [f"{name} ({units[name]})" if name in units else name for name in panels]
    rows = -(-len(panels) // _COLUMNS)
    several = go.Figure()
    figure = make_subplots(rows, _COLUMNS, subplot_titles=titles, vertical_spacing=0.25)
    for label, _, look in lines:
        squares = predictions.squares[label]
        several.add_trace(_draw_bars(names, predictions.joint, squares, look).update(name=label))
        for k, panel in enumerate(panels):
            if panel == "phase":
                drawn = _draw_bars(_PHASES, predictions.is_reversal[own], squares[own], look)
            else:
                x, y = _bin(predictions.quantities[panel][own], squares[own])
                drawn = go.Scatter(x=x, y=y, mode="lines+markers", line=look)
            drawn.update(name=label, legendgroup=label, showlegend=k == 0)
            figure.add_trace(drawn, k // _COLUMNS + 1, k % _COLUMNS + 1)
    figure.update_yaxes(rangemode="tozero").update_layout(margin={"t": 36})
    title = f"rms error (m{gap.unit})"
    figure.update_yaxes(title=title, col=1)
    several.update_yaxes(title=title)
    if len(names) == 1:
        return [("Where predictions are wrong", figure)]
    return [("Which joints are predicted wrongly", several), (f"Where predictions of {names[worst]} are wrong", figure)]


def _draw_bars(names: Sequence[str], values: IntArray, squares: FloatArray, look: LineStyle) -> go.Bar:
    """Draw the rms error of each value that occurs: its number is that of its name."""
    present = np.unique(values).tolist()
    return go.Bar(
        x=[names[k] for k in present], y=[_rms(squares[values == k]) for k in present], marker={"color": look["color"]}
    )


def _gather_predictions(gap: Gap, shots: MechanismShots, lines: Sequence[PredictedLine]) -> _Predictions:
    """Gather the errors of all predictions of held-out windows, and what moves there."""
    names = [joint.name for joint in shots.simulator.joints]
    joints, reversals = list[IntArray](), list[IntArray]()
    squares: dict[str, list[FloatArray]] = {label: [] for label, _, _ in lines}
    columns: dict[str, list[FloatArray]] = {n: [] for n in ("speed", "position", "time in the run", "input")}
    for number, one in enumerate(gap.windows):
        segment, here = one.segment, one.is_predicted
        path = gap.after[number][:, :, 0]
        velocity = np.gradient(path, segment.t, axis=0)
        joints.append(np.nonzero(here)[1])
        reversals.append(find_reversals(velocity, segment.t)[here].astype(np.int64))
        for label, paths, _ in lines:
            squares[label].append(np.square(1000 * (paths[number] - segment.positions)[:, :, 0])[here])
        inputs = _find_inputs(shots, segment.shot, segment.t, [names.index(body) for body in segment.bodies])
        values = (np.abs(velocity), segment.positions[:, :, 0], np.broadcast_to(segment.t[:, None], path.shape), inputs)
        for column, value in zip(columns.values(), values, strict=True):
            column.append(value[here])
    return _Predictions(
        np.concatenate(joints), {label: np.concatenate(parts) for label, parts in squares.items()},
        np.concatenate(reversals), {name: np.concatenate(parts) for name, parts in columns.items()},
    )  # fmt: skip


def _find_inputs(shots: MechanismShots, shot: int, t: FloatArray, joints: list[int]) -> FloatArray:
    """Find the input (T, B) that drives each joint at times (T,) s; NaN where none does, or has no power."""
    history, drives = shots.histories[shot], [one.joint for one in shots.simulator.drives]
    rows = np.clip(np.searchsorted(history.t, t, "right") - 1, 0, len(history.t) - 1)
    values = np.full((len(t), len(joints)), np.nan)
    for body, joint in enumerate(joints):
        if joint in drives:
            values[:, body] = history.values[rows, drives.index(joint)]
    return values


def _rms(squares: FloatArray) -> float:
    return float(np.sqrt(squares.mean())) if len(squares) else float("nan")


def _bin(values: FloatArray, squares: FloatArray) -> tuple[list[float], list[float]]:
    """Return the means of a quantity and the rms errors of bins of equal numbers."""
    rows = np.flatnonzero(np.isfinite(values))
    order = rows[np.argsort(values[rows], kind="stable")]
    parts = np.array_split(order, min(_BINS, max(len(order) // _MIN_IN_BIN, 1)))
    return [float(values[part].mean()) for part in parts], [_rms(squares[part]) for part in parts]
