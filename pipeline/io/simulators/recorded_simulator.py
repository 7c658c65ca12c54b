"""A recorded simulation, where the simulator itself cannot be run: tracks of its own predictions.

What it lacks is then a small deviation from its path. The deviation is that of a free body: forces that it changes in
the simulator itself are not known, so that only weak effects over short times are predicted well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import numpy as np
from scipy.interpolate import CubicSpline

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.mechanism_inputs import EffectValues
from models.estimation.gap_scenes.outside_simulator import Drive, Joint


class RecordedSimulator:
    """Recorded predictions; see `models.estimation.gap_scenes.outside_simulator.OutsideSimulator`."""

    takes_forces = False
    is_free_beside_others = False
    failure = ""
    last_mass = 1.0
    velocity_lag = 0.0
    drives: tuple[Drive, ...] = ()
    inputs: tuple[str, ...] = ()
    servo_joints: tuple[int, ...] = ()
    own_effects: Mapping[str, tuple[float, ...]] = MappingProxyType({})

    def __init__(self, joints: tuple[Joint, ...], paths: Mapping[int, tuple[FloatArray, FloatArray]]) -> None:
        """Take times (T,) s and positions (T, N) by shot."""
        self.joints, self.paths, self.rest = joints, paths, np.zeros(2 * len(joints))
        own = {id(path): CubicSpline(path[0], path[1], axis=0) for path in paths.values()}  # shots may share a path
        self._splines = {shot: own[id(path)] for shot, path in paths.items()}
        self.time_step = float(np.median(np.concatenate([np.diff(t) for t, _ in paths.values()])))

    def begin(
        self, starts: FloatArray, values: Sequence[EffectValues], powered: BoolArray, shots: IntArray, t: FloatArray
    ) -> RecordedRuns:
        """Begin runs side by side; see `OutsideSimulator.begin`."""
        return RecordedRuns(self, starts, shots, t)

    def read_path(self, shot: int, t: FloatArray) -> FloatArray:
        """Read the recorded states (T, 2N) at times (T,)."""
        path = self._splines[shot]
        return np.concatenate([path(t), path(t, 1)], axis=1)


class RecordedRuns:
    """Deviations from a recorded path, which move freely; see `OutsideSimulator` for runs."""

    def __init__(self, simulator: RecordedSimulator, starts: FloatArray, shots: IntArray, t: FloatArray) -> None:
        self._simulator, self._passed = simulator, 0.0
        self._stretches, self._place = np.unique(np.stack([shots, t], axis=1), axis=0, return_inverse=True)
        self._deviation = starts - self._read_paths(np.zeros(1))[:, 0]

    def advance(self, inputs: FloatArray, force: FloatArray) -> FloatArray:
        """Let the runs go on by M steps."""
        times = self._simulator.time_step * np.arange(1, inputs.shape[1] + 1)
        span, push = times[None, :, None], force[:, None]
        off, speed = np.split(self._deviation[:, None], 2, axis=2)
        deviation = np.concatenate([off + span * speed + span**2 / 2 * push, speed + span * push], axis=2)
        self._deviation, self._passed = deviation[:, -1], self._passed + times[-1]
        return np.asarray(self._read_paths(times - times[-1]) + deviation)

    def _read_paths(self, times: FloatArray) -> FloatArray:
        """Read the recorded states (C, M, 2N) at times (M,) s after those until which the runs have gone on."""
        paths = [self._simulator.read_path(int(shot), t + self._passed + times) for shot, t in self._stretches]
        return np.asarray(np.array(paths)[self._place])
