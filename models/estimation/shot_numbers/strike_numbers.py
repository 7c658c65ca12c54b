"""Speed and spin of the struck ball just after the strike."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.core.fit_result import WholeShotSolution
from models.core.scene import Table
from models.core.shot_numbers import ShotNumber
from models.core.typing import FloatArray
from models.estimation.joint_fit.segment_prior_residuals import LEAST_SLIP, STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.physics.billiards.cloth.closed_form_motion import GRAVITY
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.parametrised_shot import RADIUS_FACTOR, unpack_start

SIDE_SPIN_SHARE = 0.5
"""Standard deviation of the side spin of all players, as R omega / v: a cue that does not miscue reaches 5/4 (Alciatore
2004), and most shots have little."""
STRIKE_NUMBERS = (
    ("cue_speed", "m/s"), ("top_spin", "rad/s"), ("top_spin_share", ""), ("side_spin", "rad/s"), ("side_spin_share", ""),
)  # fmt: skip
"""Names and units."""
_SEED = 1
"""Random seed of the time of the strike in posterior samples."""


def measure_strike(view: PosteriorView, course: ShotCourse, ball: str) -> list[ShotNumber]:
    """Measure speed and top spin after the strike from the path; side spin is not observable there.

    Args:
        view: Joint fit with its covariance.
        course: The shot.
        ball: Id of the struck ball.

    Returns:
        The numbers, in the order of `STRIKE_NUMBERS`.
    """

    def numbers(x: FloatArray) -> FloatArray:
        speed, share = float(np.hypot(x[2], x[3])), rolling_share(x)
        return np.array([speed, share * speed / view.radius, share])

    values, sigmas = view.evaluate(numbers, view.state_at_start(course.segments[course.cue][0]))
    speed = float(values[0])
    prior = (STRUCK_SLIP * speed + LEAST_SLIP) / max(speed, LEAST_SLIP)
    side = SIDE_SPIN_SHARE * np.array([speed / view.radius, 1.0])
    top = course.is_struck and float(sigmas[2]) < PRIOR_DOMINATED * prior
    return _list_numbers(
        np.append(values, [np.nan, np.nan]), np.append(sigmas, side), (course.is_struck, top, top, False, False), ball
    )


def measure_strike_of_samples(
    whole: WholeShotSolution, table: Table, ball: str, strike: float, strike_sigma: float
) -> list[ShotNumber]:
    """Measure speed and spin after the strike from posterior samples of a fit of the whole shot.

    The fit begins at the first frame after the strike; until then the ball slides.

    Args:
        whole: The fit.
        table: Dimensions of the table.
        ball: Id of the struck ball.
        strike: s, presentation time of the strike.
        strike_sigma: s, its standard deviation.

    Returns:
        The numbers, in the order of `STRIKE_NUMBERS`.
    """
    rng, rows = np.random.default_rng(_SEED), []
    row = whole.ids.index(ball)
    for start, values in zip(whole.start_samples, whole.parameter_samples, strict=True):
        state = unpack_start(start, whole.moving)[row]
        elapsed = max(whole.t - strike + strike_sigma * float(rng.standard_normal()), 0.0)
        radius = table.ball_radius * float(values[RADIUS_FACTOR])
        rows.append(_numbers_at_strike(state, elapsed, values, radius, float(rng.uniform(-1, 1))))
    numbers = np.array(rows)
    sigmas = numbers.std(axis=0, ddof=1)
    top, side = sigmas[2] < PRIOR_DOMINATED * STRUCK_SLIP, sigmas[4] < PRIOR_DOMINATED * SIDE_SPIN_SHARE
    return _list_numbers(numbers.mean(axis=0), sigmas, (True, top, top, side, side), ball)


def rolling_share(state: FloatArray) -> float:
    """Return top spin over that of a rolling ball, from place, velocity and slip (6,): 1 rolls, 0 stun, < 0 draw."""
    speed_squared = max(float(state[2] ** 2 + state[3] ** 2), 1e-12)
    return 1.0 - float(state[2] * state[4] + state[3] * state[5]) / speed_squared


def _numbers_at_strike(
    state: FloatArray, elapsed: float, values: FloatArray, radius: float, chance: float
) -> FloatArray:
    """Return the numbers of a strike from the state (7,) of `parametrised_shot` some time after it.

    A ball that rolls by then may have slid before, forwards or backwards: `chance` from -1 to 1 decides.
    """
    before, slip, lost = state.copy(), float(np.hypot(*state[4:6])), float(values[SLIDING_MU]) * GRAVITY * elapsed
    if slip > 0:
        friction = lost * state[4:6] / slip
    else:
        friction = chance * lost * state[2:4] / max(float(np.hypot(*state[2:4])), 1e-9)
    before[2:4] += friction
    before[4:6] += 3.5 * friction
    speed, share = float(np.hypot(*before[2:4])), rolling_share(before)
    side = -(float(state[6]) + np.sign(state[6]) * radius * float(values[SPIN_DECAY]) * elapsed)
    return np.array([speed, share * speed / radius, share, side / radius, side / max(speed, 1e-9)])


def _list_numbers(
    values: FloatArray, sigmas: FloatArray, is_observable: Sequence[bool | np.bool_], ball: str
) -> list[ShotNumber]:
    return [
        ShotNumber(name, float(value), float(sigma), unit, bool(observable), ball)
        for (name, unit), value, sigma, observable in zip(STRIKE_NUMBERS, values, sigmas, is_observable, strict=True)
    ]
