"""Speed and spin of the struck ball just after the strike.

A whole shot is fitted from the first frame after the strike; its posterior samples are taken back to the strike.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.fit_result import WholeShotSolution
from models.core.shot_numbers import ShotNumber
from models.core.typing import FloatArray
from models.estimation.joint_fit.segment_prior_residuals import LEAST_SLIP, STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import PosteriorView, turn_angle
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.estimation.shot_numbers.slip_profile import SlipProfile
from models.physics.billiards.cloth.closed_form_motion import GRAVITY
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.parametrised_shot import RADIUS_FACTOR, SIDE_SPIN, unpack_start

SIDE_SPIN_SHARE = 0.5
"""Standard deviation of the side spin of all players, as R omega / v: a cue that does not miscue reaches 5/4 (Alciatore
2004), and most shots have little."""
STRIKE_NUMBERS = (
    ("cue_speed", "m/s"), ("direction", "deg"), ("top_spin", "rad/s"), ("top_spin_share", ""), ("side_spin", "rad/s"),
    ("side_spin_share", ""),
)  # fmt: skip
"""Names and units."""
_X_AXIS = np.array([1.0, 0.0])


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
        return np.array([speed, turn_angle(_X_AXIS, x[2:4]), share * speed / view.radius, share])

    values, sigmas = view.evaluate(numbers, view.state_at_start(course.segments[course.cue][0]))
    speed = float(values[0])
    prior = (STRUCK_SLIP * speed + LEAST_SLIP) / max(speed, LEAST_SLIP)
    side = SIDE_SPIN_SHARE * np.array([speed / view.radius, 1.0])
    top = course.is_struck and float(sigmas[3]) < PRIOR_DOMINATED * prior
    return list_numbers(
        STRIKE_NUMBERS,
        np.append(values, [np.nan, np.nan]),
        np.append(sigmas, side),
        (course.is_struck, course.is_struck, top, top, False, False),
        (ball,) * len(STRIKE_NUMBERS),
    )


def measure_strike_of_samples(samples: Sequence[_StruckSample], row: int, radius: float, ball: str) -> list[ShotNumber]:
    """Measure speed and spin after the strike from posterior samples of a fit of the whole shot.

    Args:
        samples: The samples at the strike.
        row: Row of the struck ball in their states.
        radius: m, nominal radius of a ball.
        ball: Id of the struck ball.

    Returns:
        The numbers, in the order of `STRIKE_NUMBERS`.
    """
    numbers = np.array(
        [_numbers_of_state(one.states[row], radius * float(one.values[RADIUS_FACTOR])) for one in samples]
    )
    numbers[:, 1] = np.degrees(np.unwrap(np.radians(numbers[:, 1])))
    sigmas = numbers.std(axis=0, ddof=1)
    top, side = sigmas[3] < PRIOR_DOMINATED * STRUCK_SLIP, sigmas[5] < PRIOR_DOMINATED * SIDE_SPIN_SHARE
    is_observable = (True, True, top, top, side, side)
    return list_numbers(STRIKE_NUMBERS, numbers.mean(axis=0), sigmas, is_observable, (ball,) * len(STRIKE_NUMBERS))


def replace_strike(numbers: Sequence[ShotNumber], profile: SlipProfile, radius: float) -> tuple[ShotNumber, ...]:
    """Replace speed and top spin of a shot by those of their profile.

    Args:
        numbers: Numbers of the shot.
        profile: Posterior of speed and top spin.
        radius: m, of the ball.

    Returns:
        The numbers; the side spin is over the new speed.
    """
    prior = STRUCK_SLIP + LEAST_SLIP / profile.speed
    top = profile.share_sigma < PRIOR_DOMINATED * prior
    speed = next(one.value for one in numbers if one.name == "cue_speed")
    changed = {
        "cue_speed": (profile.speed, profile.speed_sigma, True),
        "top_spin": (profile.spin / radius, profile.spin_sigma / radius, top),
        "top_spin_share": (profile.share, profile.share_sigma, top),
    }
    result = []
    for one in numbers:
        if one.name in changed:
            value, sigma, observable = changed[one.name]
            one = replace(one, value=value, sigma=sigma, observable=observable)
        elif one.name == "side_spin_share" and one.observable:
            one = replace(one, value=one.value * speed / profile.speed, sigma=one.sigma * speed / profile.speed)
        result.append(one)
    return tuple(result)


def rolling_share(state: FloatArray) -> float:
    """Return top spin over that of a rolling ball, from place, velocity and slip (6,): 1 rolls, 0 stun, < 0 draw."""
    speed_squared = max(float(state[2] ** 2 + state[3] ** 2), 1e-12)
    return 1.0 - float(state[2] * state[4] + state[3] * state[5]) / speed_squared


def _numbers_of_state(state: FloatArray, radius: float) -> FloatArray:
    """Return the numbers (6,) of a state (7,) of `parametrised_shot`."""
    speed, share, side = float(np.hypot(*state[2:4])), rolling_share(state), -float(state[SIDE_SPIN])
    direction = turn_angle(_X_AXIS, state[2:4])
    return np.array([speed, direction, share * speed / radius, share, side / radius, side / max(speed, 1e-9)])


def list_numbers(
    names: Sequence[tuple[str, str]], values: FloatArray, sigmas: FloatArray, is_observable: Sequence[bool | np.bool_],
    balls: Sequence[str],
) -> list[ShotNumber]:  # fmt: skip
    """List K numbers of a shot.

    Args:
        names: (K,) names and units.
        values: (K,) values, in these units.
        sigmas: (K,) standard deviations.
        is_observable: (K,) whether the data determine them.
        balls: (K,) ids of the balls that they belong to.

    Returns:
        The numbers, in this order.
    """
    return [
        ShotNumber(name, float(value), float(sigma), unit, bool(observable), ball)
        for (name, unit), value, sigma, observable, ball in zip(
            names, values, sigmas, is_observable, balls, strict=True
        )
    ]


_SEED = 1
"""Random seed of the time of the strike."""


@dataclass(frozen=True, slots=True)
class _StruckSample:
    """One sample of N balls and all parameters."""

    states: FloatArray
    """(N, 7) place, velocity, slip, and surface speed of side spin, m and m/s, as in `parametrised_shot`."""
    values: FloatArray
    """(Q,) values of `parametrised_shot.SHOT_PARAMETERS`."""
    ball_model: str
    """Contact model of two balls."""


def rewind_samples(
    whole: WholeShotSolution, ball: str, strike: float, strike_sigma: float, radius: float
) -> tuple[_StruckSample, ...]:
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
        samples.append(_StruckSample(states, values, ball_model))
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
