"""Posterior samples of a whole shot, taken back to the strike: the fit begins at the first frame after it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.fit_result import WholeShotSolution
from models.core.typing import FloatArray
from models.physics.billiards.cloth.closed_form_motion import GRAVITY
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.parametrised_shot import RADIUS_FACTOR, SIDE_SPIN, unpack_start

_SEED = 1
"""Random seed of the time of the strike."""


@dataclass(frozen=True, slots=True)
class StruckSample:
    """One sample of N balls and all parameters."""

    states: FloatArray
    """(N, 7) place, velocity, slip, and surface speed of side spin, m and m/s, as in `parametrised_shot`."""
    values: FloatArray
    """(Q,) values of `parametrised_shot.SHOT_PARAMETERS`."""
    ball_model: str
    """Contact model of two balls."""


def rewind_samples(
    whole: WholeShotSolution, ball: str, strike: float, strike_sigma: float, radius: float
) -> tuple[StruckSample, ...]:
    """Take the posterior samples of a whole shot back to its strike.

    Args:
        whole: The fit of the whole shot.
        ball: Id of the struck ball.
        strike: s, presentation time of the strike.
        strike_sigma: s, its standard deviation.
        radius: m, nominal radius of a ball.

    Returns:
        The samples.
    """
    rng, samples, row = np.random.default_rng(_SEED), [], whole.ids.index(ball)
    for start, values, ball_model in zip(
        whole.start_samples, whole.parameter_samples, whole.sample_ball_models, strict=True
    ):
        states = unpack_start(start, whole.moving)
        elapsed = max(whole.t - strike + strike_sigma * float(rng.standard_normal()), 0.0)
        states[row] = _rewind_state(
            states[row], elapsed, values, radius * float(values[RADIUS_FACTOR]), float(rng.uniform(-1, 1))
        )
        samples.append(StruckSample(states, values, ball_model))
    return tuple(samples)


def _rewind_state(
    state: FloatArray, elapsed: float, values: FloatArray, radius: float, chance: float
) -> FloatArray:  # fmt: skip
    """Return a state (7,) some time (s) earlier, while the ball slid.

    A ball that rolls in the end may have slid before, forwards or backwards: `chance` from -1 to 1 decides.
    """
    before, slip, lost = state.copy(), float(np.hypot(*state[4:6])), float(values[SLIDING_MU]) * GRAVITY * elapsed
    if slip > 0:
        friction = lost * state[4:6] / slip
    else:
        friction = chance * lost * state[2:4] / max(float(np.hypot(*state[2:4])), 1e-9)
    before[2:4] += friction
    before[4:6] += 3.5 * friction
    before[:2] -= elapsed * (before[2:4] - friction / 2)
    before[SIDE_SPIN] += np.sign(state[SIDE_SPIN]) * radius * float(values[SPIN_DECAY]) * elapsed
    return before
