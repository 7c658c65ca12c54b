"""Probability that two bodies touched, and the time of a certain contact, from the evidence of all possible motions.

Apart from touching or not, a ball may have rolled or slid where its path begins, and errors of successive samples may
be correlated more or less: the evidences of all these hypotheses add up.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.core.shot import ContactTestResult
from models.core.typing import FloatArray
from models.estimation.contact_test.contact_evidence import (
    HypothesisFit,
    build_noise,
    find_inliers,
    fit_hypothesis,
    guess_parameters,
)
from models.estimation.contact_test.contact_moment import (
    CONTACT_COUNT,
    SHARED_COUNT,
    PossibleContact,
    predict_contact_paths,
    predict_free_paths,
    predict_nearest_approach,
)

CORRELATIONS = (0.0, 0.35, 0.6, 0.8)
"""Correlations of the errors of successive samples (AR(1)), equally probable before."""
MIN_SLIDING_SLIP = 0.05
"""m/s of slip from which a ball slides; with less it duplicates the rolling hypothesis."""
MAX_LOG_ODDS = 20.0
"""ln of the odds at which a hypothesis is dropped."""


@dataclass(frozen=True, slots=True)
class WeightedHypothesis:
    """One possible motion and its evidence."""

    contact: PossibleContact
    correlation: float
    fit: HypothesisFit
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
        without_contact = _weigh_hypothesis(option, False, guess_parameters(option, t)[0], is_inlier, correlations[0])
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
    if 2 * count < contact.common_column + SHARED_COUNT + CONTACT_COUNT:
        raise ValueError(f"the contact test needs at least {contact.common_column} samples; got {count}")


def select_inliers(contact: PossibleContact, t: float) -> NDArray[np.bool_]:
    """Select samples (K,) that are no outliers, however the balls moved."""
    moving = replace(contact, balls=tuple(replace(ball, rests=False) for ball in contact.balls))
    return find_inliers(moving, *guess_parameters(moving, t))


def fit_contact(
    option: PossibleContact,
    t: float,
    is_inlier: NDArray[np.bool_],
    correlation: float,
    without_contact: HypothesisFit | None = None,
) -> WeightedHypothesis:
    """Fit the contact from the initial guess and from the path without contact; return the better fit."""
    start = guess_parameters(option, t)[1]
    fitted = _weigh_hypothesis(option, True, start, is_inlier, correlation)
    if without_contact is None or fitted.fit.chi2 < without_contact.chi2:
        return fitted
    column = option.common_column + SHARED_COUNT
    alternative_start = np.concatenate([without_contact.parameters, [without_contact.paths.t], start[column + 1 :]])
    alternative = _weigh_hypothesis(option, True, alternative_start, is_inlier, correlation)
    return max(fitted, alternative, key=lambda hypothesis: hypothesis.log_evidence)


def predict_gap(contact: PossibleContact, t: float) -> tuple[float, float]:
    """Predict the gap and its sigma, m, from the samples before t (s) alone; errors are independent."""
    is_after = np.concatenate([ball.t >= t for ball in contact.balls])
    _, start = guess_parameters(contact, t)
    fitted = fit_hypothesis(
        contact, predict_free_paths, start[: contact.common_column + SHARED_COUNT], build_noise(contact, ~is_after, 0.0)
    )
    return _free_path_gap(contact, fitted)


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
    fitted = fit_hypothesis(
        contact,
        predict_contact_paths if with_contact else predict_free_paths,
        start,
        build_noise(contact, is_inlier, correlation),
    )
    slips = [fitted.parameters[columns][4:] for columns in contact.columns]
    is_duplicate = any(len(slip) and np.hypot(*slip) < MIN_SLIDING_SLIP for slip in slips)
    return WeightedHypothesis(contact, correlation, fitted, -np.inf if is_duplicate else fitted.log_evidence)


def _is_contact(hypothesis: WeightedHypothesis) -> bool:
    """Return whether a hypothesis includes the contact."""
    return len(hypothesis.fit.parameters) > hypothesis.contact.common_column + SHARED_COUNT


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
    column = contact.common_column + SHARED_COUNT
    variance = fitted.covariance[column, column] if is_contact else _nearest_variance(contact, fitted)
    data = 2 * sum(len(ball.t) for ball in contact.balls)
    return ContactTestResult(
        probability, fitted.paths.t, float(np.sqrt(variance)), gap, gap_sigma,
        fitted.chi2 / max(data - len(fitted.parameters), 1), best.correlation,
        max(fitted.paths.closing, 0.0) if is_contact else 0.0,
    )  # fmt: skip


def _free_path_gap(contact: PossibleContact, fitted: HypothesisFit) -> tuple[float, float]:
    """Return the gap of the free paths that begin like this fit, and its sigma, m."""
    size = contact.common_column + SHARED_COUNT
    paths = predict_nearest_approach(contact, fitted.parameters[:size])
    variance = float(paths.gap_gradient @ fitted.covariance[:size, :size] @ paths.gap_gradient)
    if len(fitted.parameters) == size:
        variance += contact.reach_sigma**2
    return paths.gap, float(np.sqrt(variance))


def _nearest_variance(contact: PossibleContact, fitted: HypothesisFit) -> float:
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
