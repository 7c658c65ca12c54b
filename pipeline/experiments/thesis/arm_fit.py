"""Fit of two rigid arms on joints with friction to a double pendulum, with the equations of the diagnosis.

No model of a real joint is exact, and the motion is chaotic. Every window therefore has a start of its own and is
short, and windows begin at every sample: between two samples, the motions of both windows that cover them are blended.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray
from models.estimation.gap_scenes.pendulum_scene import build_pendulum_scene
from models.estimation.multiple_shooting.shooting_fit import fit_windows
from models.physics.effect import Prior

# rad: noise of a good encoder, or of a marker observed from near.
ANGLE_NOISE = 1e-3
# Samples of a window: long ones decide between distant starts; then the shortest ones that measure more than their
# start follow what no model of a joint explains.
WINDOW_SAMPLES = (12, 6, 3)
_FRAME = ReferenceFrame(("theta1", "theta2"), "rad", "from the vertical")


def fit_arms(t: FloatArray, angles: FloatArray) -> tuple[Callable[[FloatArray], FloatArray], tuple[Prior, ...]]:
    """Fit two arms to their absolute angles (T, 2), 0 hanging, at times (T,) s.

    Returns:
        The angles (M, 2) at ascending times (M,) between the first and the last sample, and the fitted parameters.
    """
    scene = build_pendulum_scene(2, ("joint_friction",))
    effects = [(one, one.name in scene.simulator_effects) for one in scene.effects]
    fitted = tuple(prior for one, is_fitted in effects if is_fitted for prior in one.parameters)
    mask = np.repeat([is_fitted for _, is_fitted in effects], [len(one.parameters) for one, _ in effects])
    count, path, shared = len(t) - 2, CubicSpline(t, angles), None
    starts = tuple(np.concatenate([path(one), path(one, 1)]) for one in t[:count])
    for size in WINDOW_SAMPLES:
        windows = tuple(_record_arms(t[k : k + size], angles[k : k + size]) for k in range(count))
        fit = fit_windows(scene.build_model(windows, (), mask), shared, starts=starts)
        starts, shared = fit.starts, fit.shared

    def predict(window: int, times: FloatArray) -> FloatArray:
        rows = _record_arms(np.append(t[window], times), np.zeros((len(times) + 1, 2)))
        return scene.predict_positions(rows, fit.starts[window], fit.shared, ())[1:, 0]

    def blend(times: FloatArray) -> FloatArray:
        gap, blended = np.clip(np.searchsorted(t, times, side="right") - 1, 0, len(t) - 2), np.empty((len(times), 2))
        for k in np.unique(gap).tolist():
            here = gap == k
            share = ((times[here] - t[k]) / (t[k + 1] - t[k]))[:, None]
            weight = share**2 * (3 - 2 * share)
            before, after = predict(max(k - 1, 0), times[here]), predict(min(k, count - 1), times[here])
            blended[here] = (1 - weight) * before + weight * after
        return blended

    return blend, fitted


def _record_arms(t: FloatArray, angles: FloatArray) -> Recording:
    """Record angles (T, 2) as the one body of the scene."""
    sigma = np.full((len(t), 1), ANGLE_NOISE)
    return Recording(0, np.arange(len(t)), t, ("arms",), angles[:, None], sigma, _FRAME, True)
