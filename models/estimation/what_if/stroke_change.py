"""Changes of a stroke: speed, direction, side spin and top spin of the cue ball, and a player's own spread."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray

MIN_SPEED = 1e-3
"""m/s: no stroke is slower."""


@dataclass(frozen=True, slots=True)
class StrokeChange:
    """How a stroke differs from the real one. Spins are shares: R omega over the speed of the ball."""

    speed_factor: float = 1.0
    speed: float | None = None
    """m/s; replaces the speed."""
    angle: float = 0.0
    """Degrees to the right of the player."""
    side_added: float = 0.0
    """Added to the side spin; > 0 to the right."""
    side: float | None = None
    """Replaces the side spin."""
    top_added: float = 0.0
    """Added to the top spin: 1 rolls, 0 stun, < 0 draw."""
    top: float | None = None
    """Replaces the top spin."""


@dataclass(frozen=True, slots=True)
class PlayerSpread:
    """How strokes of a player scatter: standard deviations."""

    speed: float = 0.0
    """Of the speed, as a share of it."""
    angle: float = 0.0
    """Of the direction, degrees."""

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw factors of the speed and turns (degrees) of strokes (count, 2)."""
        drawn = rng.standard_normal((count, 2)) * [self.speed, self.angle]
        return np.column_stack([np.maximum(1.0 + drawn[:, 0], 0.05), drawn[:, 1]])


def measure_stroke(state: FloatArray, radius: float) -> tuple[float, float, float]:
    """Measure a stroke by the state of the struck ball.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s) after the strike.
        radius: m, of the ball.

    Returns:
        Speed in m/s, side spin (> 0 to the right) and top spin (1 rolls) as shares: R omega over the speed.
    """
    speed = max(float(np.hypot(*state[2:4])), MIN_SPEED)
    along = state[2:4] / speed if np.any(state[2:4]) else np.array([1.0, 0.0])
    top = radius * float(state[4:6] @ np.array([-along[1], along[0]])) / speed
    return speed, -radius * float(state[6]) / speed, top


def change_stroke(state: FloatArray, radius: float, change: StrokeChange, factor: float, turn: float) -> FloatArray:
    """Change the state of a struck ball; a change of speed or direction keeps the shares of spin.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s) after the strike.
        radius: m, of the ball.
        change: How the stroke differs from the real one.
        factor: Further factor of the speed, of one stroke of the player.
        turn: Further turn of the direction, degrees to the right.

    Returns:
        (7,) state.
    """
    before, side, top = measure_stroke(state, radius)
    speed = before * change.speed_factor if change.speed is None else change.speed
    speed = max(speed * factor, MIN_SPEED)
    angle = np.radians(change.angle + turn)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    along = state[2:4] / before if np.any(state[2:4]) else np.array([1.0, 0.0])
    rolling_axis = np.array([-along[1], along[0]])
    spin = state[4:6] / before
    wanted_top = top + change.top_added if change.top is None else change.top
    wanted_side = side + change.side_added if change.side is None else change.side
    changed = state.copy()
    changed[2:4] = speed * (rotation @ along)
    changed[4:6] = speed * (rotation @ (spin + (wanted_top - top) / radius * rolling_axis))
    changed[6] = -wanted_side * speed / radius
    return changed
