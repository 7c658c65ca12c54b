"""Training of the network that corrects a cushion model, on what the model leaves unexplained.

Side spin is hidden: filtering it and training the network alternate. Shots are split into fitting shots, selection
shots, on which training stops, and reporting shots, which judge once whether the correction is switched on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from models.core.typing import FloatArray
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.learned_table import DEGREES_OF_FREEDOM, ContactScatter
from models.estimation.table_learning.side_spin import (
    MIN_CONTACT_SPEED,
    Rebounds,
    filter_side_spin,
    predict_rebounds,
    whiten_innovations,
)
from models.physics.billiards.ball_cushion.rebound_correction import (
    HIDDEN,
    INPUTS,
    LARGEST_SHARE,
    LEAST_SPEED,
    OUTPUTS,
    WEIGHT_COUNT,
)
from models.physics.billiards.parameter_vector import SPIN_DECAY

# Contacts below which no network is trained: it has 88 weights.
MIN_TRAINING_CONTACTS = 150
# Shots below which too few would judge the network.
MIN_TRAINING_SHOTS = 10
# Share of the mean squared deviation of reporting shots that a correction must remove to be switched on.
MIN_GAIN = 0.1
# Alternations of filter and training, steps of each training, and steps without a gain that end it.
ROUNDS, STEPS, PATIENCE = 3, 600, 60
# Prior standard deviations of the weights.
_OUTPUT_SIGMA, _HIDDEN_SIGMA = 0.05, 1.0
_LEARNING_RATE = 0.01
# Of squared deviations; larger ones are wrongly cut contacts.
_KEPT_QUANTILE = 0.95


@dataclass(frozen=True, slots=True)
class TrainedCorrection:
    """A correction and what it gains on shots that it has not seen."""

    weights: FloatArray
    """(WEIGHT_COUNT,)"""
    gain: float
    """Share of the mean squared deviation of the reporting shots that it removes."""

    @property
    def is_worthwhile(self) -> bool:
        """Whether it gains enough to be switched on."""
        return self.gain >= MIN_GAIN


def train_correction(
    contacts: CushionContacts, law: int, physics: FloatArray, radius: float, mass: float, scatter: ContactScatter,
    seed: int = 0,
) -> TrainedCorrection | None:  # fmt: skip
    """Train the correction of a fitted cushion model.

    Args:
        contacts: Contacts of all shots.
        law: Index of the cushion model in `CUSHION_MODELS`.
        physics: (P,) its fitted parameters.
        radius: m, of the balls.
        mass: kg, of the balls.
        scatter: Fitted scatter.
        seed: Random seed of the first weights and of the split.

    Returns:
        The correction; None with too few contacts or shots.
    """
    if len(contacts.t) < MIN_TRAINING_CONTACTS or len(np.unique(contacts.shot)) < MIN_TRAINING_SHOTS:
        return None
    rng = np.random.default_rng(seed)
    part = split_shots(contacts, rng)
    decay, weights = float(physics[SPIN_DECAY]), _draw_weights(rng)
    plain = predict_rebounds(contacts, law, physics, radius, mass)
    for _ in range(ROUNDS):
        rebounds = predict_rebounds(contacts, law, physics, radius, mass, weights)
        spin = filter_side_spin(contacts, rebounds, radius, scatter, decay).mean_before
        weights = _fit_weights(contacts, plain, spin, scatter, weights, part)
    corrected = predict_rebounds(contacts, law, physics, radius, mass, weights)
    return TrainedCorrection(weights, measure_gain(contacts, plain, corrected, part == 2, radius, scatter, decay))


def measure_gain(
    contacts: CushionContacts, plain: Rebounds, better: Rebounds, rows: FloatArray, radius: float,
    scatter: ContactScatter, decay: float,
) -> float:  # fmt: skip
    """Measure the share of the mean squared deviation that other predictions remove.

    Args:
        contacts: K contacts.
        plain: Predictions of a cushion model.
        better: Other predictions.
        rows: (K,) mask of the contacts that count.
        radius: m, of the balls.
        scatter: Scatter of contacts about the model.
        decay: rad/s^2, deceleration of side spin.

    Returns:
        The share, without the largest deviations.
    """
    before, after = (_measure_deviation(contacts, one, radius, scatter, decay)[rows] for one in (plain, better))
    return 1.0 - _trimmed_mean(after) / _trimmed_mean(before)


def split_shots(contacts: CushionContacts, rng: np.random.Generator) -> FloatArray:
    """Split shots at random.

    Args:
        contacts: K contacts.
        rng: Random numbers.

    Returns:
        (K,) 0 for contacts of fitting shots (three fifths), 1 for selection shots, 2 for reporting shots.
    """
    shots = np.unique(contacts.shot)
    role = np.array([0, 0, 0, 1, 2])[rng.permutation(len(shots)) % 5]
    return np.asarray(role[np.searchsorted(shots, contacts.shot)])


def _draw_weights(rng: np.random.Generator) -> FloatArray:
    """Draw hidden weights from their prior; the outputs begin at zero."""
    weights = np.zeros(WEIGHT_COUNT)
    hidden = HIDDEN * (INPUTS + 1)
    weights[:hidden] = _HIDDEN_SIGMA * rng.standard_normal(hidden)
    return weights


def _measure_deviation(
    contacts: CushionContacts, rebounds: Rebounds, radius: float, scatter: ContactScatter, decay: float
) -> FloatArray:
    """Return the squared whitened deviations (K,) at the filtered side spin."""
    result = filter_side_spin(contacts, rebounds, radius, scatter, decay)
    whitening, _ = whiten_innovations(contacts, rebounds.by_before, scatter)
    residual = result.deviation * np.maximum(contacts.speed, MIN_CONTACT_SPEED)[:, None]
    return np.asarray((np.einsum("kij,kj->ki", whitening, residual) ** 2).sum(axis=1))


def _trimmed_mean(squares: FloatArray) -> float:
    return float(squares[squares <= np.quantile(squares, _KEPT_QUANTILE)].mean())


def _fit_weights(
    contacts: CushionContacts, plain: Rebounds, spin: FloatArray, scatter: ContactScatter, weights: FloatArray,
    part: FloatArray,
) -> FloatArray:  # fmt: skip
    """Fit the weights to the contacts at their mean side spin; stop on the selection shots."""
    row = np.arange(len(spin))
    step = plain.grid[:, 1] - plain.grid[:, 0]
    nearest = np.rint((spin - plain.grid[:, 0]) / step).astype(np.int64)
    base = plain.predicted[row, nearest, :4]
    whitening, _ = whiten_innovations(contacts, plain.by_before, scatter)
    speed = contacts.speed
    inputs = np.column_stack([contacts.before, spin]) / np.maximum(speed, 1e-9)[:, None]
    x = torch.tensor(np.column_stack([inputs, np.log(speed + LEAST_SPEED)]))
    mirrored = x * torch.tensor([1.0, -1.0, 1.0, -1.0, -1.0, 1.0], dtype=torch.float64)
    residual, root, scale = torch.tensor(contacts.after - base), torch.tensor(whitening), torch.tensor(speed)[:, None]
    w = torch.tensor(weights, requires_grad=True)
    sigma = torch.full((WEIGHT_COUNT,), _OUTPUT_SIGMA, dtype=torch.float64)
    sigma[: HIDDEN * (INPUTS + 1)] = _HIDDEN_SIGMA
    fitting, selection = (torch.tensor(part == role) for role in (0, 1))
    optimizer = torch.optim.Adam([w], lr=_LEARNING_RATE)
    best, best_cost, since = weights, np.inf, 0
    for _ in range(STEPS):
        squares = ((root @ (residual - scale * _correct(w, x, mirrored))[..., None])[..., 0] ** 2).sum(dim=1)
        costs = 0.5 * (DEGREES_OF_FREEDOM + 4) * torch.log1p(squares / (DEGREES_OF_FREEDOM - 2))
        selected = float(costs.detach()[selection].sum())
        if selected < best_cost - 1e-3:
            best, best_cost, since = w.detach().numpy().copy(), selected, 0
        since += 1
        if since > PATIENCE:
            break
        optimizer.zero_grad()
        (costs[fitting].sum() + 0.5 * ((w / sigma) ** 2).sum()).backward()  # type: ignore[no-untyped-call]
        optimizer.step()
    return best


def _correct(w: torch.Tensor, x: torch.Tensor, mirrored: torch.Tensor) -> torch.Tensor:
    """Evaluate the shares (K, 4) of `rebound_correction`, without its limit on energy."""
    hidden, outer = w[: HIDDEN * (INPUTS + 1)].reshape(HIDDEN, INPUTS + 1), w[HIDDEN * (INPUTS + 1) :]

    def evaluate(rows: torch.Tensor) -> torch.Tensor:
        units = torch.tanh(rows @ hidden[:, :INPUTS].T + hidden[:, INPUTS])
        return units @ outer.reshape(OUTPUTS, HIDDEN).T

    one, other = evaluate(x), evaluate(mirrored)
    even = torch.tensor([True, False, True, False])
    half = 0.5 * torch.where(even, one + other, one - other)
    return LARGEST_SHARE * torch.tanh(half / LARGEST_SHARE)
