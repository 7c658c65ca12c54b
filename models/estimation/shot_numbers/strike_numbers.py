"""Speed and spin of the struck ball just after the strike."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from models.core.shot_numbers import ShotNumber
from models.core.typing import FloatArray
from models.estimation.joint_fit.segment_prior_residuals import LEAST_SLIP, STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import PosteriorView, turn_angle
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.estimation.shot_numbers.slip_profile import SlipProfile
from models.estimation.shot_numbers.struck_samples import StruckSample
from models.physics.billiards.simulation.parametrised_shot import RADIUS_FACTOR, SIDE_SPIN

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


def measure_strike_of_samples(samples: Sequence[StruckSample], row: int, radius: float, ball: str) -> list[ShotNumber]:
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
