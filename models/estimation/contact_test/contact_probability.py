"""Probability that two bodies touched, and the time of a certain contact, from the evidence of all possible motions.

Apart from touching or not, a ball may have rolled or slid where its path begins, and errors of successive samples may
be correlated more or less: the evidences of all these hypotheses add up.

The evidence of a hypothesis is its likelihood, integrated over all unknowns (Laplace's approximation; MacKay 2003,
Information Theory, Inference, and Learning Algorithms, ch. 28). No weights are set by hand: a contact has more unknowns
and pays for them, and its impulse follows from where the paths lead, so that a graze, which hardly changes them, stays
undecided. Errors of successive samples are correlated by an unknown amount, and their size is only roughly known: both
are integrated over.

Whether a contact gets the time found here or that of the joint fit is decided in `reconstruction.contact_times`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp, ndtr

from models.core.shot import ContactTestResult
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_motion import (
    CONTACT_COUNT,
    PathPrediction,
    PossibleContact,
    predict_contact_paths,
    predict_free_paths,
    predict_nearest_approach,
)
from models.numerics.least_squares import SearchOptions, minimize_residuals
from models.numerics.statistics import estimate_norm_sigma
from models.physics.effects.billiards_catalogue import find_prior

# Correlations of the errors of successive samples (AR(1)), equally probable before.
CORRELATIONS = (0.0, 0.35, 0.6, 0.8)
# m/s of slip from which a ball slides; with less it duplicates the rolling hypothesis.
MIN_SLIDING_SLIP = 0.05
# ln of the odds at which a hypothesis is dropped.
MAX_LOG_ODDS = 20.0


@dataclass(frozen=True, slots=True)
class WeightedHypothesis:
    """One possible motion and its evidence."""

    contact: PossibleContact
    correlation: float
    fit: _HypothesisFit
    log_evidence: float


def evaluate_contact(
    contact: PossibleContact, t: float, correlations: tuple[float, ...] = CORRELATIONS
) -> ContactTestResult:
    """Evaluate the probability and the time of a contact near t (s).

    The window must hold no other contact. `correlations` are those of errors that are considered possible. Raises
    ValueError with too few samples.
    """
    require_samples(contact)
    is_inlier = select_inliers(contact, t)
    hypotheses = []
    for option in list_motion_hypotheses(contact):
        without_contact = _weigh_hypothesis(option, False, _guess_parameters(option, t)[0], is_inlier, correlations[0])
        hypotheses += [without_contact, fit_contact(option, t, is_inlier, correlations[0], without_contact.fit)]
    best = max(hypothesis.log_evidence for hypothesis in hypotheses)
    for candidate in [hypothesis for hypothesis in hypotheses if hypothesis.log_evidence > best - MAX_LOG_ODDS]:
        start, with_contact = candidate.fit.parameters, _is_contact(candidate)
        hypotheses += [
            _weigh_hypothesis(candidate.contact, with_contact, start, is_inlier, correlation)
            for correlation in correlations[1:]
        ]
    return combine_hypotheses(hypotheses)


def require_samples(contact: PossibleContact) -> None:
    """Raise ValueError with too few samples."""
    count = sum(len(ball.t) for ball in contact.balls)
    if 2 * count < contact.contact_column + CONTACT_COUNT:
        raise ValueError(f"the contact test needs at least {contact.common_column} samples; got {count}")


def select_inliers(contact: PossibleContact, t: float) -> NDArray[np.bool_]:
    """Select samples (K,) that are no outliers, however the balls moved."""
    moving = replace(contact, balls=tuple(replace(ball, rests=False) for ball in contact.balls))
    return _find_inliers(moving, *_guess_parameters(moving, t))


def fit_contact(
    option: PossibleContact,
    t: float,
    is_inlier: NDArray[np.bool_],
    correlation: float,
    without_contact: _HypothesisFit | None = None,
) -> WeightedHypothesis:
    """Fit the contact from the initial guess and from the path without contact; return the better fit."""
    start = _guess_parameters(option, t)[1]
    fitted = _weigh_hypothesis(option, True, start, is_inlier, correlation)
    if without_contact is None or fitted.fit.chi2 < without_contact.chi2:
        return fitted
    column = option.contact_column
    alternative_start = np.concatenate([without_contact.parameters, [without_contact.paths.t], start[column + 1 :]])
    alternative = _weigh_hypothesis(option, True, alternative_start, is_inlier, correlation)
    return max(fitted, alternative, key=lambda hypothesis: hypothesis.log_evidence)


def predict_gap(contact: PossibleContact, t: float) -> tuple[float, float]:
    """Predict the gap and its sigma, m, from the samples before t (s) alone; errors are independent."""
    is_after = np.concatenate([ball.t >= t for ball in contact.balls])
    _, start = _guess_parameters(contact, t)
    noise = _build_noise(contact, ~is_after, 0.0)
    return _free_path_gap(contact, _fit_hypothesis(contact, predict_free_paths, start[: contact.contact_column], noise))


def list_motion_hypotheses(contact: PossibleContact) -> Iterator[PossibleContact]:
    """Yield the contact with every ball rolling or sliding where its path begins, or resting if it may."""
    options = [
        [replace(ball, rests=False, rolls=rolls) for rolls in (True, False)] + [ball] * ball.rests
        for ball in contact.balls
    ]
    for balls in product(*options):
        yield replace(contact, balls=balls)


def _weigh_hypothesis(
    contact: PossibleContact, with_contact: bool, start: FloatArray, is_inlier: NDArray[np.bool_], correlation: float
) -> WeightedHypothesis:
    """Fit one hypothesis and evaluate its evidence."""
    model = predict_contact_paths if with_contact else predict_free_paths
    fitted = _fit_hypothesis(contact, model, start, _build_noise(contact, is_inlier, correlation))
    slips = [fitted.parameters[columns][4:] for columns in contact.columns]
    is_duplicate = any(len(slip) and np.hypot(*slip) < MIN_SLIDING_SLIP for slip in slips)
    return WeightedHypothesis(contact, correlation, fitted, -np.inf if is_duplicate else fitted.log_evidence)


def _is_contact(hypothesis: WeightedHypothesis) -> bool:
    """Return whether a hypothesis includes the contact."""
    return len(hypothesis.fit.parameters) > hypothesis.contact.contact_column


def combine_hypotheses(hypotheses: list[WeightedHypothesis]) -> ContactTestResult:
    """Combine the evidences of all hypotheses into the result."""
    without_contact, with_contact = (
        [item.log_evidence for item in hypotheses if _is_contact(item) is touches] for touches in (False, True)
    )
    probability = float(np.exp(logsumexp(with_contact) - logsumexp([*without_contact, *with_contact])))
    is_contact = probability > 0.5
    best = max((item for item in hypotheses if _is_contact(item) is is_contact), key=lambda item: item.log_evidence)
    contact, fitted = best.contact, best.fit
    gap, gap_sigma = _free_path_gap(contact, fitted)
    column = contact.contact_column
    variance = fitted.covariance[column, column] if is_contact else _nearest_variance(contact, fitted)
    data = 2 * sum(len(ball.t) for ball in contact.balls)
    return ContactTestResult(
        probability, fitted.paths.t, float(np.sqrt(variance)), gap, gap_sigma,
        fitted.chi2 / max(data - len(fitted.parameters), 1), best.correlation,
        max(fitted.paths.closing, 0.0) if is_contact else 0.0,
    )  # fmt: skip


def _free_path_gap(contact: PossibleContact, fitted: _HypothesisFit) -> tuple[float, float]:
    """Return the gap, and its sigma, m: the least distance of the surfaces if the bodies of this fit passed freely.

    It is negative where they would overlap.
    """
    size = contact.contact_column
    paths = predict_nearest_approach(contact, fitted.parameters[:size])
    variance = float(paths.gap_gradient @ fitted.covariance[:size, :size] @ paths.gap_gradient)
    if len(fitted.parameters) == size:
        variance += contact.reach_sigma**2
    return paths.gap, float(np.sqrt(variance))


def _nearest_variance(contact: PossibleContact, fitted: _HypothesisFit) -> float:
    """Return the variance of the time of nearest approach, s^2: where the closing speed passes zero."""
    later = predict_contact_paths(contact, np.concatenate([fitted.parameters, [fitted.paths.t + 1e-3, 1.0, 0.0, 0.0]]))
    rate = (later.closing - fitted.paths.closing) / 1e-3
    gradient = fitted.paths.closing_gradient / min(rate, -1e-6)
    variance = float(gradient @ fitted.covariance @ gradient)
    return min(variance, 0.25)


def estimate_contact_time(contact: PossibleContact, t: float) -> ContactTestResult:
    """Estimate when bodies touched that certainly did, near t (s); errors are independent.

    Args:
        contact: The balls and, if any, the cushion.
        t: s.

    Returns:
        The result with the time of contact.

    Raises:
        ValueError: If there are too few samples.
    """
    require_samples(contact)
    is_inlier = select_inliers(contact, t)
    return combine_hypotheses([fit_contact(option, t, is_inlier, 0.0) for option in list_motion_hypotheses(contact)])


# Degrees of freedom of the prior on the noise level: it is known to a tenth.
NOISE_DOF = 50.0
# Share of the speed, and m/s: slip at the start of the window, one standard deviation.
SLIP_SIGMA_SHARE, SLIP_SIGMA_FLOOR = 0.7, 0.2
# m/s per axis, one standard deviation: of balls on a table.
VELOCITY_SIGMA = 3.0
# m/s^2 per axis: 1.4 mm/m of slope, or nap.
SLOPE_SIGMA = 0.01
# m: gap of surfaces that touch, one standard deviation.
TOUCH_SIGMA = 1e-5
# m: successive values on the way there.
LOOSE_TOUCH_SIGMAS = (1e-3, 1e-4)
# Impulse of friction over the normal one, one standard deviation about 0: Alciatore, technical proof A.14; Han 2005. It
# has a sign and is fitted itself, so these are not the coefficients mu of the effects `ball_friction` and
# `cushion_friction`, which bound its size.
BALL_FRICTION, CUSHION_FRICTION = 0.06, 0.2
# Of the parameters of a hypothesis.
SEARCH = SearchOptions(
    iterations=20, attempts=6, min_gain=3e-3, min_relative_gain=3e-6, lowering=0.1, raising=8.0, raising_offset=1e-6
)
# Relative to the information of a parameter.
RIDGE = 1e-9
# m: half of the gaps in question are within about this much, a Cauchy distribution.
GAP_SCALE = 1e-3
# m/s: least standard deviation of a closing speed.
MIN_CLOSING_SIGMA = 1e-9
# Standard deviations of an outlier under both hypotheses.
OUTLIER_SIGMAS = 4.5


@dataclass(frozen=True, slots=True)
class _CorrelatedNoise:
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
class _HypothesisFit:
    """Best fit of a hypothesis."""

    parameters: FloatArray
    paths: PathPrediction
    chi2: float
    log_evidence: float
    covariance: FloatArray


PathModel = Callable[[PossibleContact, FloatArray], PathPrediction]


def _build_noise(contact: PossibleContact, is_inlier: NDArray[np.bool_], correlation: float) -> _CorrelatedNoise:
    """Build the noise of all samples; outliers, `is_inlier` (K,) False, get no weight."""
    sigma = np.concatenate([ball.sigma for ball in contact.balls])
    carried, row = np.zeros(len(sigma)), 0
    for ball in contact.balls:
        step = np.diff(ball.t)
        usual = float(np.median(step)) if len(step) else 1.0
        carried[row + 1 : row + len(ball.t)] = correlation ** (step / usual) if correlation else 0.0
        row += len(ball.t)
    return _CorrelatedNoise(
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
    shared, moment, (sliding, rolling) = contact.common_column, contact.contact_column, contact.cloth
    sigma[shared : shared + 2] = SLOPE_SIGMA
    mean[shared + 2 : moment] = np.log([sliding.value, rolling.value])
    sigma[shared + 2 : moment] = sliding.sigma, rolling.sigma
    if size > moment:
        wall = contact.cushion is not None
        e = find_prior("cushion_restitution" if wall else "ball_restitution", "e")
        friction = CUSHION_FRICTION if wall else BALL_FRICTION
        mean[moment + 1] = e.value
        sigma[moment + 1 :] = e.sigma, friction, (1.0 if wall else friction)
    return mean, sigma


def _guess_parameters(contact: PossibleContact, t: float) -> tuple[FloatArray, FloatArray]:
    """Guess the parameters of both hypotheses, free paths first."""
    size = contact.contact_column
    mean, _ = _parameter_priors(contact, size + CONTACT_COUNT)
    guesses = []
    for through in (True, False):
        states = [(b.through_state if through else b.start_state)[: b.parameter_count] for b in contact.balls]
        guesses.append(np.concatenate([*states, mean[contact.common_column :]]))
    guesses[1][size] = t
    return guesses[0][:size], guesses[1]


def _find_inliers(contact: PossibleContact, without_contact: FloatArray, with_contact: FloatArray) -> NDArray[np.bool_]:
    """Find the samples (K,) that at least one hypothesis explains."""
    sigma = np.concatenate([ball.sigma for ball in contact.balls])
    all_samples = np.ones(len(sigma), bool)
    noise = _build_noise(contact, all_samples, 0.0)
    misfits = []
    for model, start in ((predict_free_paths, without_contact), (predict_contact_paths, with_contact)):
        paths = _fit_hypothesis(contact, model, start, noise).paths
        misfits.append(np.hypot(*(_places_of_samples(contact) - paths.xy).T) / sigma)
    smallest: FloatArray = np.min(misfits, axis=0)
    usual = max(estimate_norm_sigma(smallest), 1.0)
    return np.asarray(smallest < OUTLIER_SIGMAS * usual, dtype=np.bool_)


def _places_of_samples(contact: PossibleContact) -> FloatArray:
    """Return the places (K, 2) of all samples, ball by ball."""
    return np.concatenate([ball.xy for ball in contact.balls])


def _linearize_model(
    contact: PossibleContact, model: PathModel, parameters: FloatArray, noise: _CorrelatedNoise, touch: float
) -> tuple[FloatArray, FloatArray, PathPrediction]:
    """Return standardized residuals of samples, priors and, last, of the contact, with their derivatives."""
    paths = model(contact, parameters)
    mean, sigma = _parameter_priors(contact, len(parameters))
    has_prior = np.isfinite(sigma)
    residual = [noise.whiten_rows(paths.xy - _places_of_samples(contact)), ((parameters - mean) / sigma)[has_prior]]
    jacobian = [noise.whiten_rows(paths.jacobian), (np.eye(len(parameters)) / sigma[:, None])[has_prior]]
    if len(parameters) > contact.contact_column:
        residual.append(np.array([paths.gap / touch]))
        jacobian.append(paths.gap_gradient[None] / touch)
    return np.concatenate(residual), np.concatenate(jacobian), paths


def _fit_hypothesis(
    contact: PossibleContact, model: PathModel, start: FloatArray, noise: _CorrelatedNoise
) -> _HypothesisFit:
    """Fit a hypothesis by damped least squares; the required gap of the surfaces tightens on the way."""
    final = float(np.hypot(TOUCH_SIGMA, contact.reach_sigma))
    parameters, initial_gap = start, 0.0
    if len(start) > contact.contact_column:
        initial_gap = abs(model(contact, start).gap)
    for touch in sorted({final, *(loose for loose in LOOSE_TOUCH_SIGMAS if final < loose < initial_gap)}, reverse=True):
        parameters = minimize_residuals(
            parameters,
            lambda values, touch=touch: _linearize_model(contact, model, values, noise, touch)[:2],  # type: ignore[misc]
            SEARCH,
            lambda old, new: _limit_contact_time(contact, old, new),
            RIDGE,
        ).point
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
    fit = _HypothesisFit(parameters, paths, chi2, 0.0, covariance)
    return replace(fit, log_evidence=float(evidence + _log_geometry_factor(contact, fit, final)))


def _log_geometry_factor(contact: PossibleContact, fit: _HypothesisFit, touch: float) -> float:
    """Return ln of the geometric and prior probability of a hypothesis.

    Paths that do not meet keep apart; those that meet close in on each other, and a moment of contact stands for the
    paths that lead to it in proportion to their closing speed.
    """
    paths = fit.paths
    if len(fit.parameters) == contact.contact_column:
        spread = float(np.hypot(contact.reach_sigma, np.sqrt(paths.gap_gradient @ fit.covariance @ paths.gap_gradient)))
        gap = np.linspace(0, max(paths.gap, 0.0) + 6 * spread, 400)
        share = _normal_density((gap - paths.gap) / spread) / spread * _gap_prior_density(contact, gap)
        return float(np.log(max(np.trapezoid(share, gap), 1e-300)))
    # two resting balls certainly have no closing speed
    spread = max(float(np.sqrt(paths.closing_gradient @ fit.covariance @ paths.closing_gradient)), MIN_CLOSING_SIGMA)
    z = paths.closing / spread
    mean = spread * (z * ndtr(z) + _normal_density(z))  # mean of max(closing, 0)
    overlap = min(predict_nearest_approach(contact, fit.parameters[: contact.contact_column]).gap, 0.0)
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


def _limit_contact_time(contact: PossibleContact, old: FloatArray, new: FloatArray) -> FloatArray:
    """Keep the contact time within the window, and limit its move to a tenth of the window."""
    column = contact.contact_column
    if len(new) <= column:
        return new
    tenth = 0.1 * (contact.end - contact.begin)
    limited = new.copy()
    limited[column] = np.clip(new[column], old[column] - tenth, old[column] + tenth)
    limited[column] = np.clip(limited[column], contact.begin, contact.end)
    return limited
