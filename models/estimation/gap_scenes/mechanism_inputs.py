"""Inputs of a mechanism over time, and the effects that change them before they reach a simulator."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from models.core.typing import BoolArray, FloatArray

# Values (n,) of each parameter of the effects that act, by effect.
EffectValues = Mapping[str, tuple[FloatArray, ...]]


@dataclass(frozen=True, slots=True)
class InputHistory:
    """Inputs of a shot, which hold from row to row; K rows, I inputs."""

    t: FloatArray
    """(K,) s."""
    values: FloatArray
    """(K, I); NaN where an actuator has no power."""

    def is_powered(self, t: float) -> BoolArray:
        """Return whether each input (I,) is given at a time (s)."""
        row = int(np.clip(np.searchsorted(self.t, t + _SAME_TIME, "right") - 1, 0, len(self.t) - 1))
        return np.asarray(np.isfinite(self.values[row]))

    def average(self, edges: FloatArray, delay: FloatArray) -> FloatArray:
        """Average the inputs over steps; where one is not given, the next one that is, else the last one, counts.

        Args:
            edges: (M + 1,) s, ends of the steps.
            delay: (I,) s by which each input acts later.

        Returns:
            (M, I) means, continuous in the delays.
        """
        averages = np.zeros((len(edges) - 1, self.values.shape[1]))
        for k, column in enumerate(self.values.T):
            given = np.flatnonzero(np.isfinite(column))
            if not len(given):
                continue
            level = column[given[np.clip(np.searchsorted(given, np.arange(len(column))), 0, len(given) - 1)]]
            at = edges - delay[k]
            integral = np.concatenate([[0.0], np.cumsum(level[:-1] * np.diff(self.t))])
            whole = np.interp(at, self.t, integral)
            whole += level[0] * np.minimum(at - self.t[0], 0.0) + level[-1] * np.maximum(at - self.t[-1], 0.0)
            averages[:, k] = np.diff(whole) / np.diff(edges)
        return averages


# s by which a time may round below that of its row.
_SAME_TIME = 1e-9


def transform_all_inputs(history: InputHistory, edges: FloatArray, values: Sequence[EffectValues]) -> FloatArray:
    """Return the inputs (C, M, I) of all runs."""
    done: dict[tuple[bytes, ...], FloatArray] = {}
    columns = []
    for acting in values:
        key = tuple(acting[name][0].tobytes() if name in acting else b"" for name in _INPUT_EFFECTS)
        if key not in done:
            done[key] = _transform_inputs(history, edges, acting)
        columns.append(done[key])
    return np.array(columns)


# Effects that change inputs, whatever the motion is.
_INPUT_EFFECTS = ("delay", "backlash", "actuator_lag", "saturation", "actuator_gain")


def _transform_inputs(history: InputHistory, edges: FloatArray, values: EffectValues) -> FloatArray:
    """Return the inputs (M, I) of all steps, delayed, with play, lag, limit and gain."""
    delay = values["delay"][0] if "delay" in values else np.zeros(history.values.shape[1])
    h, first = edges[1] - edges[0], len(edges) - 1
    if "backlash" in values or "actuator_lag" in values:
        # play and lag depend on what was asked since the start of the shot
        count = max(int(np.ceil((edges[0] - history.t[0]) / h)), 0)
        edges = np.concatenate([edges[0] + h * np.arange(-count, 0), edges])
    inputs = history.average(edges, delay)
    if "backlash" in values:
        inputs = _apply_play(inputs, values["backlash"][0])
    if "actuator_lag" in values:
        inputs = _apply_lag(inputs, float(h), values["actuator_lag"][0])
    inputs = inputs[len(inputs) - first :]
    if "saturation" in values:
        inputs = np.clip(inputs, -values["saturation"][0], values["saturation"][0])
    if "actuator_gain" in values:
        inputs = inputs * values["actuator_gain"][0]
    return inputs


def _apply_lag(inputs: FloatArray, dt: float, time: FloatArray) -> FloatArray:
    """Filter inputs (M, I) with a first-order low pass of time constants (I,) s."""
    lagged = np.empty_like(inputs)
    for k, column in enumerate(inputs.T):
        keep = float(np.exp(-dt / time[k])) if time[k] > 0 else 0.0
        lagged[:, k] = lfilter([1 - keep], [1.0, -keep], column, zi=[keep * column[0]])[0]
    return lagged


def _apply_play(inputs: FloatArray, width: FloatArray) -> FloatArray:
    """Move inputs (M, I) through a play of widths (I,), from its middle."""
    moved, place = np.empty_like(inputs), inputs[0]
    for k, wanted in enumerate(inputs):
        moved[k] = place = np.minimum(np.maximum(place, wanted - width / 2), wanted + width / 2)
    return moved
