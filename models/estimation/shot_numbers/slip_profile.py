"""Speed and top spin after a strike by the profile of their posterior over the top spin.

A ball that soon rolls hides how it slid: a little slip moves it by the square of that slip, so that the posterior is no
normal distribution about the best fit. Later motion has no memory of it. The path until the first contact is therefore
fitted for every value of top spin, and the fits are weighted.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.joint_solution import Observations
from models.core.typing import FloatArray
from models.estimation.joint_fit.segment_prior_residuals import EXTRA_ACCELERATION_SIGMA, LEAST_SLIP, STRUCK_SLIP
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.numerics.robust import HUBER_THRESHOLD
from models.physics.billiards.cloth.closed_form_motion import GRAVITY, sliding_duration

SHARES = np.linspace(-1.3, 1.6, 146)
"""Top spins that are tried, over rolling spin: a cue that does not miscue reaches -1.25 to 1.25 (hit at R/2)."""
_ITERATIONS = 12
_MIN_OBSERVATIONS = 4
_STEPS = np.array([1e-5, 1e-6, 1e-5, 1e-5, 1e-6])
"""Steps of numerical derivatives by the five numbers of a fit."""
_TIME_SIGMA = 0.05
"""s: prior standard deviation of the time of the strike about that of the joint fit; it only bounds the search."""


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
