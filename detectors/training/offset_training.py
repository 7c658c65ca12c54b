"""Training of the offset regressors."""

from __future__ import annotations

from collections.abc import Sized
from dataclasses import dataclass, field
from pathlib import Path
from typing import Generic, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from detectors.network.offset_regressor import INPUT_NAME, OUTPUT_NAME
from detectors.network.peak_decoding import LOG_SIGMA_LIMITS
from detectors.training.ball_training import to_network_input
from detectors.training.data.offset_samples import LightAugmentation, OffsetSamples, SampleSource
from detectors.training.data.training_shards import ShardRotation
from detectors.training.networks.offset_network import OffsetNetwork, offset_loss
from detectors.training.offset_evaluation import DiscFigures, StreakFigures, round_figures
from detectors.training.onnx_export import encode_json_values, write_onnx_network
from detectors.training.training_loop import StepCallback, TrainOptions, run_training
from models.core.typing import ByteArray, Float32Array, FloatArray

S = TypeVar("S", bound=Sized)

SHARDS_IN_MEMORY = 40
# Share of the samples that each mirror reverses.
MIRROR_SHARE = 0.5
# Least level, of 1, before gamma is applied: a power of 0 has no slope.
MIN_LEVEL = 1e-3


def train_offset_network(
    source: SampleSource[S], folder: Path, options: TrainOptions, watch: StepCallback
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
class OffsetTraining(Generic[S]):
    """The training task of an offset regressor."""

    source: SampleSource[S]
    options: TrainOptions
    checkpoint: str = field(init=False)
    shards: ShardRotation[S] = field(init=False)

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
        return self.source.draw_samples(rng, [(shards[i], int(row)) for i, row in zip(which, rows, strict=True)])


def _mirror_samples(
    rng: np.random.Generator, samples: OffsetSamples, source: SampleSource[S], draws: int
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


# Numbers of crops for which the exported network is compared with the trained one.
PARITY_COUNTS = (4, 1, 7)


class ExportedOffsetNetwork(nn.Module):
    """A network with its pre- and post-processing: bytes in, offsets and calibrated log sigmas out."""

    def __init__(self, network: OffsetNetwork, sigma_factor: float) -> None:
        super().__init__()
        self.network = network.eval()
        self.log_factor = float(np.log(sigma_factor))

    def forward(self, shown: Tensor) -> Tensor:
        """Map crops (B, rows, columns, 3) of RGB bytes to (B, 2 n)."""
        outputs = self.network(shown.permute(0, 3, 1, 2).to(torch.float32) / 255)
        n = len(self.network.kind.outputs)
        return torch.cat([outputs[:, :n], outputs[:, n:].clamp(*LOG_SIGMA_LIMITS) + self.log_factor], dim=1)


def export_offset_network(
    network: OffsetNetwork, factor: float, figures: DiscFigures | StreakFigures, recipe: dict[str, object], path: Path
) -> dict[str, float]:
    """Write an offset regressor as an ONNX file with metadata.

    Args:
        network: The trained network.
        factor: Factor of its sigmas.
        figures: Its figures on hold-out samples, for the metadata.
        recipe: How it was trained, for the metadata.
        path: The file.

    Returns:
        The rounded figures by name.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    kind, rng, rounded = network.kind, np.random.default_rng(0), round_figures(figures)
    parity_inputs = [
        rng.integers(0, 256, (count, kind.rows, kind.columns, 3), dtype=np.uint8) for count in PARITY_COUNTS
    ]
    shape = f"{kind.rows}, {kind.columns}"
    contract = {
        "trueroll.schema": kind.schema,
        "trueroll.input": f"RGB bytes (B, {shape}, 3), {kind.crop_content}; scaled to [0, 1] inside",
        "trueroll.told": ",".join(kind.outputs),
    }
    values = {"trueroll.calibration": {"sigma_factor": factor}, "trueroll.held_out": rounded, "trueroll.recipe": recipe}
    sides = {0: torch.export.Dim("pictures", min=1)}
    exported = ExportedOffsetNetwork(network, factor).eval()
    metadata = contract | encode_json_values(values)
    write_onnx_network(exported, sides, (INPUT_NAME, OUTPUT_NAME), metadata, parity_inputs, path)
    return rounded
