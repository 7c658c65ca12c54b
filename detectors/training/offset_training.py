"""Training of the offset regressors, and their evaluation on hold-out samples."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from detectors.network.offset_regressor import DISC
from detectors.network.peak_decoding import LOG_SIGMA_LIMITS
from detectors.training.ball_evaluation import MAX_PULL, round_figures
from detectors.training.ball_training import to_network_input
from detectors.training.detector_networks import OffsetNetwork, offset_loss
from detectors.training.offset_samples import LightAugmentation, OffsetSamples, SampleShard, SampleSource, stack_samples
from detectors.training.training_loop import StepCallback, TrainOptions, run_training
from detectors.training.training_shards import ShardRotation
from models.core.typing import ByteArray, Float32Array, FloatArray

SHARDS_IN_MEMORY = 40
# Share of the samples that each mirror reverses.
MIRROR_SHARE = 0.5
# Least level, of 1, before gamma is applied: a power of 0 has no slope.
MIN_LEVEL = 1e-3


def train_offset_network(
    source: SampleSource, folder: Path, options: TrainOptions, watch: StepCallback
) -> OffsetNetwork:
    """Train an offset regressor on the samples of a source; a second call continues an interrupted training.

    Args:
        source: Source of the samples.
        folder: Folder of the checkpoint.
        options: Length of the training, batch size and seed.
        watch: Called after each step.

    Returns:
        The network with averaged weights.
    """
    return run_training(OffsetTraining(source, options), folder, options, watch)


@dataclass(slots=True)
class OffsetTraining:
    """The training task of an offset regressor."""

    source: SampleSource
    options: TrainOptions
    checkpoint: str = field(init=False)
    shards: ShardRotation[SampleShard] = field(init=False)

    def __post_init__(self) -> None:
        self.checkpoint = self.source.kind.checkpoint
        self.shards = ShardRotation(self.source.read_shard, self.options.files, SHARDS_IN_MEMORY)

    def create_network(self) -> OffsetNetwork:
        """Create a network to load weights into."""
        return OffsetNetwork(self.source.kind)

    create_initial_network = create_network

    def compute_loss(self, network: OffsetNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the samples of a step, mirrored at random and in random light."""
        kind, light = self.source.kind, self.source.light
        rng = np.random.default_rng((self.options.seed, step))
        samples = self._draw_batch(rng, step)
        draws = len(samples) if light.per_sample else 1
        crops, offsets = _mirror_samples(rng, samples, self.source, draws)
        return offset_loss(network(_change_light(rng, crops, light, draws)), torch.from_numpy(offsets), kind.outputs)

    def _draw_batch(self, rng: np.random.Generator, step: int) -> OffsetSamples:
        """Draw the samples of a step, uniformly from all rows of the shards in memory."""
        shards = self.shards.shards_at(step)
        ends = np.cumsum([len(shard) for shard in shards])
        chosen = rng.integers(0, ends[-1], self.options.batch)
        which = np.searchsorted(ends, chosen, side="right")
        rows = chosen - np.concatenate([[0], ends])[which]
        drawn = [shards[i].draw_sample(rng, int(row)) for i, row in zip(which, rows, strict=True)]
        return stack_samples(self.source.kind, drawn)


def _mirror_samples(
    rng: np.random.Generator, samples: OffsetSamples, source: SampleSource, draws: int
) -> tuple[ByteArray, Float32Array]:
    """Mirror crops and offsets at random, each by its own draw or (`draws` is 1) all by the same."""
    crops, offsets = samples.crops.copy(), samples.offsets.copy()
    for mirror in source.kind.mirrors:
        reversed_rows = np.broadcast_to(rng.random(draws) < MIRROR_SHARE, len(crops))
        crops[reversed_rows] = np.flip(crops[reversed_rows], mirror.axis)
        offsets[reversed_rows] *= np.array(mirror.signs, dtype=np.float32)
    return crops, offsets


def _change_light(rng: np.random.Generator, crops: ByteArray, light: LightAugmentation, draws: int) -> Tensor:
    """Change gamma and gains of crops (B, rows, columns, 3) at random; network input (B, 3, rows, columns)."""
    gamma = _exponential_tensor(rng.normal(0, light.gamma, (draws, 1, 1, 1)))
    log_gain = rng.normal(0, light.gain, (draws, 1, 1, 1)) if light.gain else 0.0
    gain = _exponential_tensor(log_gain + rng.normal(0, light.tint, (draws, 3, 1, 1)))
    return to_network_input(crops).clamp(min=MIN_LEVEL) ** gamma * gain


def _exponential_tensor(logarithms: FloatArray) -> Tensor:
    return torch.from_numpy(np.exp(logarithms).astype(np.float32))


EVALUATION_BATCH = 256
# Unoccluded share of the balls that the figures are about, and of a ball that nothing hides.
CLEAR_SHARE, WHOLE_SHARE = 0.5, 0.999
# Share of the samples with the smallest errors that some figures are restricted to.
BEST_SHARE = 0.95
# The first outputs of every offset regressor are those of the centre.
CENTRE_OUTPUTS = 2


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


def evaluate_offset_network(network: OffsetNetwork, factor: float, samples: OffsetSamples) -> dict[str, float]:
    """Compute the figures of a trained network on hold-out samples of sufficiently visible balls, one pass.

    Args:
        factor: Factor of its sigmas, from `fit_sigma_factor`.
        samples: Samples that it was not trained on.

    Returns:
        Number of samples, root mean square errors of the centre in ball radii, and the spread of the errors over their
        sigmas, rounded; without undefined ones. `of_best` and `of_whole`: both axes together, of the best 95 % and of
        balls that nothing hides; `shown_*`: of the ball network.
    """
    predicted, sigma = predict_offsets(network, samples.crops)
    pulls = centre_pulls(predicted, factor * sigma, samples.offsets)
    is_clear = samples.visible >= CLEAR_SHARE
    initial = samples.offsets[is_clear, :CENTRE_OUTPUTS].astype(np.float64)
    remaining = (samples.offsets - predicted)[is_clear, :CENTRE_OUTPUTS]
    (first, second), size = _measure_rms(remaining, axis=0), np.abs(remaining)
    if network.kind.name == DISC.name:
        whole = remaining[samples.visible[is_clear] >= WHOLE_SHARE]
        figures = {
            "discs": len(remaining), "right": first, "down": second,
            "of_best": _measure_rms(_select_best(remaining, size.max(axis=1))), "of_whole": _measure_rms(whole),
        }  # fmt: skip
    else:
        shown_along, shown_across = _measure_rms(initial, axis=0)
        figures = {
            "streaks": len(remaining), "shown_along": shown_along, "shown_across": shown_across, "along": first,
            "across": second, "along_of_best": _measure_rms(_select_best(remaining, size[:, 0]), axis=0)[0],
        }  # fmt: skip
    return round_figures(figures | {"pull_std": np.std(pulls) if len(pulls) else np.nan})


def _select_best(errors: FloatArray, size: FloatArray) -> FloatArray:
    """Select the smallest 95 % of errors (n, 2) of sizes (n,)."""
    return errors[size <= np.quantile(size, BEST_SHARE)] if len(size) else errors


def _measure_rms(errors: FloatArray, axis: int | None = None) -> Any:
    """Measure the root mean square of errors (n, 2) along an axis, or of all; NaN without any."""
    return np.sqrt(np.mean(errors**2, axis=axis)) if len(errors) else np.full(2 if axis == 0 else (), np.nan)
