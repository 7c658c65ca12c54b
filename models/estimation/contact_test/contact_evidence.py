"""Evidence of two hypotheses, contact or none, fitted to the same samples.

The evidence of a hypothesis is its likelihood, integrated over all unknowns (Laplace's approximation; MacKay 2003,
Information Theory, Inference, and Learning Algorithms, ch. 28). No weights are set by hand: a contact has more unknowns
and pays for them, and its impulse follows from where the paths lead, so that a graze, which hardly changes them, stays
undecided. Errors of successive samples are correlated by an unknown amount, and their size is only roughly known: both
are integrated over.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from models.core.typing import FloatArray
from models.estimation.contact_test.contact_moment import (
    CONTACT_COUNT,
    SHARED_COUNT,
    PathPrediction,
    PossibleContact,
    predict_contact_paths,
    predict_free_paths,
    predict_nearest_approach,
)
from models.numerics.least_squares import SearchOptions, minimize_residuals
from models.numerics.robust_scale import estimate_norm_sigma
from models.physics.effects.catalogue import find_prior

NOISE_DOF = 50.0
"""Degrees of freedom of the prior on the noise level: it is known to a tenth."""
SLIP_SIGMA_SHARE, SLIP_SIGMA_FLOOR = 0.7, 0.2
"""Share of the speed, and m/s: slip at the start of the window, one standard deviation."""
VELOCITY_SIGMA = 3.0
"""m/s per axis, one standard deviation: of balls on a table."""
SLOPE_SIGMA = 0.01
"""m/s^2 per axis: 1.4 mm/m of slope, or nap."""
TOUCH_SIGMA = 1e-5
"""m: gap of surfaces that touch, one standard deviation."""
LOOSE_TOUCH_SIGMAS = (1e-3, 1e-4)
"""m: successive values on the way there."""
BALL_FRICTION, CUSHION_FRICTION = 0.06, 0.2
"""Impulse of friction over the normal one, one standard deviation: Alciatore, technical proof A.14; Han 2005."""
SEARCH = SearchOptions(
    iterations=20, attempts=6, min_gain=3e-3, min_relative_gain=3e-6, lowering=0.1, raising=8.0, raising_offset=1e-6
)
"""Of the parameters of a hypothesis."""
RIDGE = 1e-9
"""Relative to the information of a parameter."""
GAP_SCALE = 1e-3
"""m: half of the gaps in question are within about this much, a Cauchy distribution."""
MIN_CLOSING_SIGMA = 1e-9
"""m/s: least standard deviation of a closing speed."""
OUTLIER_SIGMAS = 4.5
"""Standard deviations of an outlier under both hypotheses."""


@dataclass(frozen=True, slots=True)
class CorrelatedNoise:
    """Noise of K samples whose errors are correlated."""

    sigma: FloatArray
    """(K,) m."""
    correlation: FloatArray
    """(K,) correlation with the sample before; 0 for the first of a ball."""

    def whiten_rows(self, rows: FloatArray) -> FloatArray:
        """Whiten rows (K, 2, ...) in m into independent standard errors, flat (2 K, ...)."""
        shape = (-1,) + (1,) * (rows.ndim - 1)
        scaled: FloatArray = rows / self.sigma.reshape(shape)
        correlation = self.correlation.reshape(shape)
        previous = np.concatenate([np.zeros_like(scaled[:1]), scaled[:-1]])
        whitened: FloatArray = (scaled - correlation * previous) / np.sqrt(1 - correlation**2)
        return whitened.reshape(2 * len(rows), *rows.shape[2:])

    @property
    def log_volume(self) -> float:
        """Sum of ln of the conditional standard deviations, both axes, without the contribution of `sigma`."""
        return float(np.log1p(-(self.correlation**2)).sum())


@dataclass(frozen=True, slots=True)
class HypothesisFit:
    """Best fit of a hypothesis."""

    parameters: FloatArray
    paths: PathPrediction
    chi2: float
    log_evidence: float
    covariance: FloatArray


PathModel = Callable[[PossibleContact, FloatArray], PathPrediction]


def build_noise(contact: PossibleContact, is_inlier: NDArray[np.bool_], correlation: float) -> CorrelatedNoise:
    """Build the noise of all samples; outliers, `is_inlier` (K,) False, get no weight."""
    sigma = np.concatenate([ball.sigma for ball in contact.balls])
    carried, row = np.zeros(len(sigma)), 0
    for ball in contact.balls:
        step = np.diff(ball.t)
        usual = float(np.median(step)) if len(step) else 1.0
        carried[row + 1 : row + len(ball.t)] = correlation ** (step / usual) if correlation else 0.0
        row += len(ball.t)
    return CorrelatedNoise(
        np.where(is_inlier, sigma, 1e3 * sigma), np.where(is_inlier & np.roll(is_inlier, 1), carried, 0.0)
    )


def _parameter_priors(contact: PossibleContact, size: int) -> tuple[FloatArray, FloatArray]:
    """Return prior means and standard deviations (P,); infinite without a prior."""
    mean, sigma = np.zeros(size), np.full(size, np.inf)
    for ball, columns in zip(contact.balls, contact.columns, strict=True):
        if not ball.rests:
            sigma[columns.start + 2 : columns.start + 4] = VELOCITY_SIGMA
            sigma[columns.start + 4 : columns.stop] = (
                SLIP_SIGMA_SHARE * float(np.hypot(*ball.start_state[2:4])) + SLIP_SIGMA_FLOOR
            )
    shared = contact.common_column
    sliding, rolling = contact.cloth
    sigma[shared : shared + 2] = SLOPE_SIGMA
    mean[shared + 2 : shared + SHARED_COUNT] = np.log([sliding.value, rolling.value])
    sigma[shared + 2 : shared + SHARED_COUNT] = sliding.sigma, rolling.sigma
    if size > shared + SHARED_COUNT:
        wall = contact.cushion is not None
        e = find_prior("cushion_restitution" if wall else "ball_restitution", "e")
        friction = CUSHION_FRICTION if wall else BALL_FRICTION
        mean[shared + SHARED_COUNT + 1] = e.value
        sigma[shared + SHARED_COUNT + 1 :] = e.sigma, friction, (1.0 if wall else friction)
    return mean, sigma


def guess_parameters(contact: PossibleContact, t: float) -> tuple[FloatArray, FloatArray]:
    """Guess the parameters of both hypotheses, free paths first."""
    size = contact.common_column + SHARED_COUNT
    mean, _ = _parameter_priors(contact, size + CONTACT_COUNT)
    guesses = []
    for through in (True, False):
        states = [(b.through_state if through else b.start_state)[: b.parameter_count] for b in contact.balls]
        guesses.append(np.concatenate([*states, mean[contact.common_column :]]))
    guesses[1][size] = t
    return guesses[0][:size], guesses[1]


def find_inliers(contact: PossibleContact, without_contact: FloatArray, with_contact: FloatArray) -> NDArray[np.bool_]:
    """Find the samples (K,) that at least one hypothesis explains."""
    sigma = np.concatenate([ball.sigma for ball in contact.balls])
    all_samples = np.ones(len(sigma), bool)
    noise = build_noise(contact, all_samples, 0.0)
    misfits = []
    for model, start in ((predict_free_paths, without_contact), (predict_contact_paths, with_contact)):
        paths = fit_hypothesis(contact, model, start, noise).paths
        misfits.append(np.hypot(*(_places_of_samples(contact) - paths.xy).T) / sigma)
    smallest: FloatArray = np.min(misfits, axis=0)
    usual = max(estimate_norm_sigma(smallest), 1.0)
    return np.asarray(smallest < OUTLIER_SIGMAS * usual, dtype=np.bool_)


def _places_of_samples(contact: PossibleContact) -> FloatArray:
    """Return the places (K, 2) of all samples, ball by ball."""
    return np.concatenate([ball.xy for ball in contact.balls])


def _linearize_model(
    contact: PossibleContact, model: PathModel, parameters: FloatArray, noise: CorrelatedNoise, touch: float
) -> tuple[FloatArray, FloatArray, PathPrediction]:
    """Return standardized residuals of samples, priors and, last, of the contact, with their derivatives."""
    paths = model(contact, parameters)
    mean, sigma = _parameter_priors(contact, len(parameters))
    has_prior = np.isfinite(sigma)
    residual = [noise.whiten_rows(paths.xy - _places_of_samples(contact)), ((parameters - mean) / sigma)[has_prior]]
    jacobian = [noise.whiten_rows(paths.jacobian), (np.eye(len(parameters)) / sigma[:, None])[has_prior]]
    if len(parameters) > contact.common_column + SHARED_COUNT:
        residual.append(np.array([paths.gap / touch]))
        jacobian.append(paths.gap_gradient[None] / touch)
    return np.concatenate(residual), np.concatenate(jacobian), paths


def fit_hypothesis(
    contact: PossibleContact, model: PathModel, start: FloatArray, noise: CorrelatedNoise
) -> HypothesisFit:
    """Fit a hypothesis by damped least squares; the required gap of the surfaces tightens on the way."""
    final = float(np.hypot(TOUCH_SIGMA, contact.reach_sigma))
    parameters, initial_gap = start, 0.0
    if len(start) > contact.common_column + SHARED_COUNT:
        initial_gap = abs(model(contact, start).gap)
    for touch in sorted({final, *(loose for loose in LOOSE_TOUCH_SIGMAS if final < loose < initial_gap)}, reverse=True):
        parameters = _minimize_residuals(contact, model, parameters, noise, touch)
    residual, jacobian, paths = _linearize_model(contact, model, parameters, noise, final)
    if model is predict_free_paths:
        paths = predict_nearest_approach(contact, parameters)
    data = 2 * len(_places_of_samples(contact))
    chi2 = float(residual[:data] @ residual[:data])
    rest = float(residual[data:] @ residual[data:])
    heavy = (data + NOISE_DOF) / (NOISE_DOF + chi2)  # precision at the likeliest size of the noise
    weight = np.concatenate([np.full(data, heavy), np.ones(len(residual) - data)])
    information = (jacobian.T * weight) @ jacobian
    scale = 1 / np.sqrt(np.maximum(np.diag(information), 1e-12))
    scaled = information * scale * scale[:, None] + 1e-12 * np.eye(len(parameters))
    covariance = np.linalg.inv(scaled) * scale * scale[:, None]
    log_volume = 0.5 * np.linalg.slogdet(scaled)[1] - float(np.log(scale).sum())
    likelihood = -(data + NOISE_DOF) / 2 * float(np.log1p(chi2 / NOISE_DOF)) - noise.log_volume - rest / 2
    _, sigma = _parameter_priors(contact, len(parameters))
    prior_sigma = sigma[np.isfinite(sigma)]
    density = -float(np.log(prior_sigma).sum()) - 0.5 * len(prior_sigma) * np.log(2 * np.pi)
    evidence = likelihood + density + 0.5 * len(parameters) * np.log(2 * np.pi) - log_volume
    hypothesis = HypothesisFit(parameters, paths, chi2, 0.0, covariance)
    return HypothesisFit(
        parameters, paths, chi2, float(evidence + _log_geometry_factor(contact, hypothesis, final)), covariance
    )


def _log_geometry_factor(contact: PossibleContact, fit: HypothesisFit, touch: float) -> float:
    """Return ln of the geometric and prior probability of a hypothesis.

    Paths that do not meet keep apart; those that meet close in on each other, and a moment of contact stands for the
    paths that lead to it in proportion to their closing speed.
    """
    paths = fit.paths
    if len(fit.parameters) == contact.common_column + SHARED_COUNT:
        spread = float(np.hypot(contact.reach_sigma, np.sqrt(paths.gap_gradient @ fit.covariance @ paths.gap_gradient)))
        gap = np.linspace(0, max(paths.gap, 0.0) + 6 * spread, 400)
        share = _normal_density((gap - paths.gap) / spread) / spread * _gap_prior_density(contact, gap)
        return float(np.log(max(np.trapezoid(share, gap), 1e-300)))
    # two resting balls certainly have no closing speed
    spread = max(float(np.sqrt(paths.closing_gradient @ fit.covariance @ paths.closing_gradient)), MIN_CLOSING_SIGMA)
    z = paths.closing / spread
    mean = spread * (z * ndtr(z) + _normal_density(z))  # mean of max(closing, 0)
    overlap = min(predict_nearest_approach(contact, fit.parameters[: contact.common_column + SHARED_COUNT]).gap, 0.0)
    weight = max(mean * float(_gap_prior_density(contact, np.array(overlap))), 1e-300)
    return float(np.log(weight) - np.log(touch) - 0.5 * np.log(2 * np.pi))


def _normal_density(z: FloatArray | float) -> FloatArray:
    """Return the density of the standard normal distribution."""
    density: FloatArray = np.exp(-0.5 * np.square(z)) / np.sqrt(2 * np.pi)
    return density


def _gap_prior_density(contact: PossibleContact, gap: FloatArray) -> FloatArray:
    """Return the prior density (1/m) of gaps in question: every other one is close, the rest are uniform."""
    near: FloatArray = 0.5 / (np.pi * GAP_SCALE * (1 + (gap / GAP_SCALE) ** 2))
    return near + 0.25 / contact.reach


def _minimize_residuals(
    contact: PossibleContact, model: PathModel, parameters: FloatArray, noise: CorrelatedNoise, touch: float
) -> FloatArray:
    """Minimize the residuals by damped least squares."""
    return minimize_residuals(
        parameters,
        lambda values: _linearize_model(contact, model, values, noise, touch)[:2],
        SEARCH,
        lambda old, new: _limit_contact_time(contact, old, new),
        RIDGE,
    ).point


def _limit_contact_time(contact: PossibleContact, old: FloatArray, new: FloatArray) -> FloatArray:
    """Keep the contact time within the window, and limit its move to a tenth of the window."""
    column = contact.common_column + SHARED_COUNT
    if len(new) <= column:
        return new
    last = max(float(ball.t[-1]) for ball in contact.balls)
    tenth = 0.1 * (last - contact.begin)
    limited = new.copy()
    limited[column] = np.clip(new[column], old[column] - tenth, old[column] + tenth)
    limited[column] = np.clip(limited[column], contact.begin, last)
    return limited
