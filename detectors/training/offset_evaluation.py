"""Errors of a trained offset regressor on hold-out samples, and the calibration of its standard deviations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from detectors.network.offset_regressor import DISC, STREAK
from detectors.network.peak_decoding import LOG_SIGMA_LIMITS
from detectors.training.ball_evaluation import MAX_PULL
from detectors.training.ball_training import to_network_input
from detectors.training.data.offset_samples import OffsetSamples
from detectors.training.networks.offset_network import OffsetNetwork
from models.core.typing import BoolArray, ByteArray, FloatArray

EVALUATION_BATCH = 256
# Unoccluded share of the balls that the figures are about, and of a ball that nothing hides.
CLEAR_SHARE, WHOLE_SHARE = 0.5, 0.999
# Share of the samples with the smallest errors that some figures are restricted to.
BEST_SHARE = 0.95
# The first outputs of every offset regressor are those of the centre.
CENTRE_OUTPUTS = 2


@dataclass(frozen=True, slots=True)
class HoldOutErrors:
    """Errors of a regressor on K hold-out samples of sufficiently visible balls, ball radii along the crop's axes."""

    initial: NDArray[np.floating]
    """(K, 2) offsets of the centre before the measurement."""
    remaining: NDArray[np.floating]
    """(K, 2) errors of the measured centre."""
    is_whole: BoolArray
    """(K,) whether nothing hides the ball."""
    pull_std: float
    """Standard deviation of all centre errors over their sigmas; NaN without any."""


@dataclass(frozen=True, slots=True)
class DiscFigures:
    """Figures of the regressor for balls at rest on hold-out samples, one pass, ball radii."""

    discs: int
    """Number of samples."""
    right: float
    down: float
    """Root mean square error of the centre per axis."""
    of_best: float
    """The same, both axes together, of the best 95 %."""
    of_whole: float
    """The same, both axes together, of balls that nothing hides."""
    pull_std: float


@dataclass(frozen=True, slots=True)
class StreakFigures:
    """Figures of the regressor for streaks on hold-out samples, one pass, ball radii."""

    streaks: int
    """Number of samples."""
    shown_along: float
    shown_across: float
    """Root mean square error of the centre that the ball network gave."""
    along: float
    across: float
    """The same of this network."""
    along_of_best: float
    """The same along the streak, of the best 95 %."""
    pull_std: float


def predict_offsets(network: OffsetNetwork, crops: ByteArray) -> tuple[FloatArray, FloatArray]:
    """Run a network on crops (K, rows, columns, 3); offsets (K, n) and their sigmas (K, n), ball radii."""
    network.eval()
    n = len(network.kind.outputs)
    starts = range(0, len(crops), EVALUATION_BATCH)
    with torch.no_grad():
        parts = [network(to_network_input(crops[k : k + EVALUATION_BATCH])).numpy() for k in starts]
    outputs = np.concatenate([np.empty((0, 2 * n)), *parts])
    return outputs[:, :n], np.exp(np.clip(outputs[:, n:], *LOG_SIGMA_LIMITS))


def fit_sigma_factor(network: OffsetNetwork, samples: OffsetSamples) -> float:
    """Fit the factor of the sigmas for which the pulls of the centres have unit spread; 1 without samples."""
    pulls = centre_pulls(*predict_offsets(network, samples.crops), samples.offsets)
    return float(np.std(pulls)) if len(pulls) > 1 else 1.0


def centre_pulls(predicted: FloatArray, sigma: FloatArray, offsets: NDArray[np.floating]) -> FloatArray:
    """Errors (n,) of the centres over their sigmas, without outliers."""
    pulls = ((offsets - predicted) / sigma)[:, :CENTRE_OUTPUTS].ravel()
    return np.asarray(pulls[np.abs(pulls) < MAX_PULL], dtype=np.float64)


def evaluate_offset_network(
    network: OffsetNetwork, factor: float, samples: OffsetSamples
) -> DiscFigures | StreakFigures:
    """Compute the figures of a trained network on hold-out samples.

    Args:
        factor: Factor of its sigmas, from `fit_sigma_factor`.
        samples: Samples that it was not trained on.

    Returns:
        The figures of the network's kind.
    """
    predicted, sigma = predict_offsets(network, samples.crops)
    pulls = centre_pulls(predicted, factor * sigma, samples.offsets)
    is_clear = samples.visible >= CLEAR_SHARE
    errors = HoldOutErrors(
        samples.offsets[is_clear, :CENTRE_OUTPUTS],
        (samples.offsets - predicted)[is_clear, :CENTRE_OUTPUTS],
        samples.visible[is_clear] >= WHOLE_SHARE,
        float(np.std(pulls)) if len(pulls) else np.nan,
    )
    return SUMMARIES[network.kind.name](errors)


def summarize_disc_errors(errors: HoldOutErrors) -> DiscFigures:
    """Summarize the errors of balls at rest."""
    remaining = errors.remaining
    best = remaining[_is_best(np.abs(remaining).max(axis=1))]
    right, down = _rms_per_axis(remaining)
    of_whole = _rms_of_both(remaining[errors.is_whole])
    return DiscFigures(len(remaining), right, down, _rms_of_both(best), of_whole, errors.pull_std)


def summarize_streak_errors(errors: HoldOutErrors) -> StreakFigures:
    """Summarize the errors of streaks."""
    remaining = errors.remaining
    best = remaining[_is_best(np.abs(remaining[:, 0]))]
    initial_rms, rms = _rms_per_axis(errors.initial), _rms_per_axis(remaining)
    return StreakFigures(len(remaining), *initial_rms, *rms, _rms_per_axis(best)[0], errors.pull_std)


SUMMARIES: dict[str, Callable[[HoldOutErrors], DiscFigures | StreakFigures]] = {
    DISC.name: summarize_disc_errors,
    STREAK.name: summarize_streak_errors,
}


def round_figures(figures: DiscFigures | StreakFigures) -> dict[str, float]:
    """The figures by name, rounded; NaN is left out."""
    return {name: round(float(value), 4) for name, value in asdict(figures).items() if value == value}


def _is_best(size: NDArray[np.floating]) -> BoolArray:
    """Which errors (K,) are among the smallest 95 %."""
    return np.asarray(size <= np.quantile(size, BEST_SHARE)) if len(size) else np.zeros(0, dtype=bool)


def _rms_per_axis(errors: NDArray[np.floating]) -> tuple[float, float]:
    """Root mean square of errors (n, 2) per axis; NaN without any."""
    first, second = np.sqrt((errors**2).mean(axis=0)) if len(errors) else (np.nan, np.nan)
    return float(first), float(second)


def _rms_of_both(errors: NDArray[np.floating]) -> float:
    """Root mean square of errors (n, 2), both axes together; NaN without any."""
    return float(np.sqrt((errors**2).mean())) if len(errors) else np.nan
