"""Correction of identity switches: bodies that a tracker has exchanged get their own names back.

Switches within a clip, before its fit, are corrected in `models.tracking.identity_switches`.

In a switch away from a contact, both bodies jump within one frame to the position of the other. No motion does that,
and the deviation that a simulator would have there is no gap.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray

_SIDE_STEPS = 5
"""Steps on either side from which the speed of a body is estimated."""
_MIN_SIDE_ROWS = 3
"""Least number of rows on either side for an estimate of speed."""
_JUMP_SPEED_RATIO = 2.0
"""Ratio to the speed on either side from which a step is a jump: a contact changes a speed, not a position."""
_JUMP_SIGMAS = 10.0
"""Additional length of a jump, standard deviations."""


@dataclass(frozen=True, slots=True)
class IdentitySwitch:
    """Bodies of one shot whose identities were switched from a moment on; the switch was undone."""

    shot: int
    t: float
    """Time of the switch, s."""
    bodies: tuple[str, ...]

    def __str__(self) -> str:
        names = " and ".join(self.bodies)
        return f"in shot {self.shot} bodies {names} were exchanged at {self.t:.2f} s; the exchange was undone"


def undo_identity_switches(recording: Recording) -> tuple[Recording, tuple[IdentitySwitch, ...]]:
    """Undo all identity switches in a recording.

    Args:
        recording: Recording of one shot.

    Returns:
        The corrected recording, or the same object where there was no switch; and the switches.
    """
    t, positions, sigma, switches = recording.t, recording.positions.copy(), recording.sigma.copy(), []
    for row in range(1, len(t)):
        jumped = [body for body in range(len(recording.bodies)) if _has_jump(t, positions, sigma, row, body, body)]
        if not recording.is_observed[row, jumped].any():
            continue
        identities = _match_identities(t, positions, sigma, row, jumped)
        if identities is not None:
            positions[row:, identities], sigma[row:, identities] = positions[row:, jumped], sigma[row:, jumped]
            switches.append(
                IdentitySwitch(recording.shot, float(t[row]), tuple(recording.bodies[body] for body in jumped))
            )
    return (replace(recording, positions=positions, sigma=sigma), tuple(switches)) if switches else (recording, ())


def _match_identities(
    t: FloatArray, positions: FloatArray, sigma: FloatArray, row: int, jumped: list[int]
) -> list[int] | None:
    """Match each body that jumped to its identity before, by the shortest distances.

    None where a matched body would still jump, or is itself.
    """
    before = np.array([positions[_find_adjacent_rows(positions, row, body, body)[0][-1], body] for body in jumped])
    after = np.array([positions[_find_adjacent_rows(positions, row, body, body)[1][0], body] for body in jumped])
    distances = np.linalg.norm(after[:, None] - before[None], axis=2)
    chosen = [jumped[k] for k in linear_sum_assignment(distances)[1]]
    for old, new in zip(jumped, chosen, strict=True):
        if old == new or _has_jump(t, positions, sigma, row, new, old):
            return None
    return chosen or None


def _has_jump(t: FloatArray, positions: FloatArray, sigma: FloatArray, row: int, before: int, after: int) -> bool:
    """Return whether the step to `row` of a body named `before` and then `after` exceeds the speed on either side."""
    first, later = _find_adjacent_rows(positions, row, before, after)
    if min(len(first), len(later)) < _MIN_SIDE_ROWS:
        return False
    one, other = positions[first, before], positions[later, after]
    step, time = float(np.linalg.norm(other[0] - one[-1])), float(t[later[0]] - t[first[-1]])
    fastest = max(_typical_speed(t[first], one), _typical_speed(t[later], other))
    return bool(step > _JUMP_SPEED_RATIO * fastest * time + _JUMP_SIGMAS * float(np.median(sigma[later, after])))


def _find_adjacent_rows(positions: FloatArray, row: int, before: int, after: int) -> tuple[IntArray, IntArray]:
    """Find the last rows before `row`, and the first from `row` on, in which a body was observed."""
    is_observed: BoolArray = np.asarray(np.isfinite(positions).all(axis=2))
    return np.flatnonzero(is_observed[:row, before])[-_SIDE_STEPS - 1 :], row + np.flatnonzero(
        is_observed[row:, after]
    )[: _SIDE_STEPS + 1]


def _typical_speed(t: FloatArray, positions: FloatArray) -> float:
    """Return the upper quartile of the speed from frame to frame, as a body that is hit is slow in some frames."""
    return float(np.quantile(np.linalg.norm(np.diff(positions, axis=0), axis=1) / np.diff(t), 0.75))
