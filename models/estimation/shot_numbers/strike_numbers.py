"""Speed and spin of the struck ball just after the strike.

A whole shot is fitted from the first frame after the strike; its posterior samples are taken back to the strike.

A ball that soon rolls hides how it slid: a little slip moves it by the square of that slip, so that the posterior is no
normal distribution about the best fit. Later motion has no memory of it. The path until the first contact is therefore
fitted for every value of top spin, and the fits are weighted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from models.core.constants import GRAVITY
from models.core.contact_graph import Observations
from models.core.fit_result import ShotNumber, WholeShotSolution
from models.core.typing import FloatArray
from models.estimation.joint_fit.pseudo_observations import EXTRA_ACCELERATION_SIGMA, LEAST_SLIP, STRUCK_SLIP
from models.estimation.multiple_shooting.shooting_fit import PRIOR_DOMINATED
from models.estimation.shot_numbers.posterior_view import PosteriorView, turn_angle
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.numerics.statistics import HUBER_THRESHOLD
from models.physics.billiards.cloth.closed_form_motion import sliding_duration
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.parametrised_shot import RADIUS_FACTOR, SIDE_SPIN, unpack_start

# Standard deviation of the side spin of all players, as R omega / v: a cue that does not miscue reaches 5/4 (Alciatore
# 2004), and most shots have little.
SIDE_SPIN_SHARE = 0.5
# Names and units.
STRIKE_NUMBERS = (
    ("cue_speed", "m/s"), ("direction", "deg"), ("top_spin", "rad/s"), ("top_spin_share", ""), ("side_spin", "rad/s"),
    ("side_spin_share", ""),
)  # fmt: skip
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


# Random seed of the time of the strike.
_SEED = 1


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


# Top spins that are tried, over rolling spin: a cue that does not miscue reaches -1.25 to 1.25 (hit at R/2).
SHARES = np.linspace(-1.3, 1.6, 146)
_ITERATIONS = 12
_MIN_OBSERVATIONS = 4
# Steps of numerical derivatives by the five numbers of a fit.
_STEPS = np.array([1e-5, 1e-6, 1e-5, 1e-5, 1e-6])
# s: prior standard deviation of the time of the strike about that of the joint fit; it only bounds the search.
_TIME_SIGMA = 0.05


@dataclass(frozen=True, slots=True)
class SlipProfile:
    """Posterior of speed and top spin after a strike: moments of the weighted fits."""

    speed: float
    """m/s; likewise `speed_sigma`."""
    speed_sigma: float
    share: float
    """Top spin over rolling spin."""
    share_sigma: float
    spin: float
    """Top spin times the radius, m/s; likewise `spin_sigma`."""
    spin_sigma: float


@dataclass(frozen=True, slots=True)
class _Path:
    """Observed distances from the place of the strike, along the path."""

    t: FloatArray
    """(K,) s after the strike of the joint fit."""
    distance: FloatArray
    """(K,) m."""
    sigma: FloatArray
    """(K,) m."""
    start_sigma: float
    """m, standard deviation of the place of the strike along the path."""


def profile_slip(
    view: PosteriorView, observations: Observations, segment: int, inflation: float, friction: tuple[float, float]
) -> SlipProfile | None:
    """Profile the posterior of a strike over the top spin.

    Args:
        view: Joint fit with its covariance.
        observations: K observations at capture times.
        segment: Index of the segment after the strike.
        inflation: Factor on the variances of observations.
        friction: Sliding friction, and standard deviation of its logarithm.

    Returns:
        The posterior; None if the ball still slides at its next contact, whose outcome shows the spin, or too few
        frames show it.
    """
    graph = view.solution.graph
    one, begin = graph.segments[segment], graph.start_time(segment)
    slide = float(sliding_duration(one.state[None], view.solution.friction)[0])
    if one.start is None or begin + slide > view.end_time(segment):
        return None
    path = _select_path(view, observations, segment)
    if len(path.t) < _MIN_OBSERVATIONS:
        return None
    mu, log_mu_sigma = view.rolling_friction
    rolling_sigma = float(np.hypot(mu * GRAVITY * log_mu_sigma, EXTRA_ACCELERATION_SIGMA))
    start = np.array([float(np.hypot(*one.state[2:4])), 0.0, np.log(friction[0]), mu * GRAVITY, 0.0])
    sigmas = np.array([np.inf, _TIME_SIGMA, max(friction[1], 1e-3), rolling_sigma, path.start_sigma])
    fits, log_weights, spreads = _fit_all(path, start, sigmas, inflation)
    weights = np.exp(log_weights - log_weights.max())
    weights = weights / weights.sum()
    speed, spin = fits[:, 0], fits[:, 0] * SHARES
    mean = weights @ np.stack([speed, SHARES, spin], axis=1)
    spread = [
        float(np.sqrt(weights @ ((values - middle) ** 2 + inner**2)))
        for values, middle, inner in zip(
            (speed, SHARES, spin), mean, (spreads, np.zeros_like(SHARES), spreads * SHARES), strict=True
        )
    ]
    return SlipProfile(float(mean[0]), spread[0], float(mean[1]), spread[1], float(mean[2]), spread[2])


def _select_path(view: PosteriorView, observations: Observations, segment: int) -> _Path:
    """Select the observations from the last ones at rest to the end of a segment."""
    graph = view.solution.graph
    one, begin = graph.segments[segment], graph.start_time(segment)
    end = view.end_time(segment)
    rows = (observations.ball == one.ball) & (observations.t > begin - _TIME_SIGMA) & (observations.t < end)
    along = one.state[2:4] / max(float(np.hypot(*one.state[2:4])), 1e-9)
    distance = (observations.xy[rows] - one.state[:2]) @ along
    covariance = np.linalg.inv(np.einsum("kij,kil->kjl", observations.whiten[rows], observations.whiten[rows]))
    sigma = np.sqrt(np.einsum("i,kij,j->k", along, covariance, along))
    start = view.state_at_start(segment)
    start_sigma = view.sigma_of(along @ start.jacobian[:2])
    return _Path(observations.t[rows] - begin, distance, sigma, start_sigma)


def _fit_all(
    path: _Path, start: FloatArray, sigmas: FloatArray, inflation: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit the five numbers (F, 5) of `_distances` for all top spins by Gauss-Newton steps, with priors about `start`.

    Also returns the log weights (F,), which contain the prior of the top spin and the widths of the fits, and the
    standard deviations (F,) of the speed.
    """
    values = np.tile(start, (len(SHARES), 1))
    prior = np.diag(1 / sigmas**2)
    scale = np.sqrt(inflation) * path.sigma
    information = np.zeros((len(SHARES), len(start), len(start)))
    for _ in range(_ITERATIONS):
        residual = (_distances(path.t, values) - path.distance) / scale
        slopes = np.stack(
            [
                (_distances(path.t, values + step) - _distances(path.t, values - step)) / (2 * step.max() * scale)
                for step in np.diag(_STEPS)
            ],
            axis=2,
        )
        weighted = slopes * np.minimum(1.0, HUBER_THRESHOLD / np.maximum(abs(residual), 1e-9))[..., None]
        information = np.einsum("fki,fkj->fij", weighted, slopes) + prior
        gradient = np.einsum("fki,fk->fi", weighted, residual) + (values - start) @ prior
        values = values - np.clip(np.linalg.solve(information, gradient[..., None])[..., 0], -0.3, 0.3)
        values[:, 0] = np.maximum(values[:, 0], 0.05)
    residual = (_distances(path.t, values) - path.distance) / scale
    bounded = np.minimum(abs(residual), HUBER_THRESHOLD)
    cost = (2 * bounded * abs(residual) - bounded**2).sum(axis=1)
    cost += np.einsum("fi,ij,fj->f", values - start, prior, values - start)
    share_sigma = STRUCK_SLIP + LEAST_SLIP / values[:, 0]
    log_weights = -0.5 * (cost + (SHARES / share_sigma) ** 2 + np.linalg.slogdet(information)[1])
    return values, log_weights, np.sqrt(np.linalg.inv(information)[:, 0, 0])


def _distances(t: FloatArray, values: FloatArray) -> FloatArray:
    """Return the distances (F, K), m, at times t (K,), s.

    `values` (F, 5) are speed (m/s), time of the strike (s), ln sliding friction, deceleration of a rolling ball (m/s^2)
    and distance at the strike (m).
    """
    rolling = np.maximum(values[:, 3:4], 1e-3)
    speed, braking = values[:, :1], np.exp(values[:, 2:3]) * GRAVITY
    slip = speed * (1 - SHARES[:, None])
    tau = np.maximum(t - values[:, 1:2], 0.0)
    slide = 2 / 7 * np.abs(slip) / braking
    sliding, after = np.minimum(tau, slide), np.maximum(tau - slide, 0.0)
    brake = np.sign(slip) * braking
    end = np.maximum(speed - brake * slide, 0.0)
    after = np.minimum(after, end / rolling)
    distances: FloatArray = (
        values[:, 4:] + speed * sliding - 0.5 * brake * sliding**2 + end * after - 0.5 * rolling * after**2
    )
    return distances
