"""Training of the ball network on rendered images.

Initial weights from an exported network.

The exporter folds every batch normalisation that follows a convolution into it. Training needs them back: each is given
the statistics of some images and inverts them, so that it changes nothing at first and is trained from there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from detectors.network.ball_model import CentreModel, open_ball_model
from detectors.training.augmentation import augment_image
from detectors.training.detector_networks import BallNetwork, build_targets, compute_ball_loss
from detectors.training.training_loop import StepCallback, TrainOptions, run_training
from detectors.training.training_shards import ShardRotation, TrainingShard, prepare_shard_file, read_shard
from models.core.errors import ModelError
from models.core.typing import ByteArray, Float32Array

CHECKPOINT = "checkpoint.pt"
# Files of training images in memory.
SHARDS_IN_MEMORY = 20
# Images for the initial statistics of the normalisations of a network from a file.
STATISTICS_IMAGES = 64


def train_ball_network(folder: Path, options: TrainOptions, watch: StepCallback) -> BallNetwork:
    """Train the ball network; a second call continues an interrupted training.

    Args:
        folder: Folder of checkpoints and training images.
        options: Length of the training, batch size and seed.
        watch: Called after each step.

    Returns:
        The network with averaged weights.
    """
    return run_training(BallTraining(folder, options), folder, options, watch)


@dataclass(slots=True)
class BallTraining:
    """The training task of the ball network."""

    folder: Path
    options: TrainOptions
    checkpoint: str = CHECKPOINT
    shards: ShardRotation[TrainingShard] = field(init=False)

    def __post_init__(self) -> None:
        self.shards = ShardRotation(self._read_shard, self.options.files, SHARDS_IN_MEMORY)

    def _read_shard(self, number: int, turn: int) -> TrainingShard:
        return read_shard(prepare_shard_file(self.folder, number))

    def create_network(self) -> BallNetwork:
        """Create a network to load weights into."""
        return BallNetwork()

    def create_initial_network(self) -> BallNetwork:
        """Create the network that training begins with."""
        network = BallNetwork()
        if self.options.start is not None:
            first = read_shard(prepare_shard_file(self.folder, 0)).rgb[:STATISTICS_IMAGES]
            load_exported_weights(network, self.options.start, to_network_input(first))
        return network

    def compute_loss(self, network: BallNetwork, step: int) -> tuple[Tensor, dict[str, float]]:
        """Compute the loss of the images of a step."""
        rgb, balls = self._draw_batch(step)
        return compute_ball_loss(network(to_network_input(rgb)), build_targets(torch.from_numpy(balls), rgb.shape[1]))

    def _draw_batch(self, step: int) -> tuple[ByteArray, Float32Array]:
        """Draw augmented images (B, S, S, 3) and their balls (B, N, 7)."""
        rng = np.random.default_rng((self.options.seed, step))
        shards = self.shards.shards_at(step)
        chosen = [shards[i] for i in rng.integers(0, len(shards), self.options.batch)]
        rows = [int(rng.integers(len(shard))) for shard in chosen]
        varied = [augment_image(rng, p.rgb[row], p.balls[row]) for p, row in zip(chosen, rows, strict=True)]
        return np.stack([rgb for rgb, _ in varied]), np.stack([balls for _, balls in varied])


def to_network_input(rgb: ByteArray) -> Tensor:
    """Convert images (B, H, W, 3) of bytes to the input (B, 3, H, W) of a network, in [0, 1]."""
    return torch.from_numpy(rgb).permute(0, 3, 1, 2).float() / 255  # memory layout unchanged: channels last


# Prefix of the names of the network's arrays in a file.
NAME_PREFIX = "network."
# Name of a convolution's shift that was that of the normalisation.
FOLDED_SHIFT = "weight_bias"

Arrays = dict[str, Tensor]


@torch.no_grad()
def load_exported_weights(network: BallNetwork, path: Path, images: Tensor) -> None:
    """Load the weights of an exported network; blocks that the file lacks begin as identities.

    Args:
        path: ONNX file of a ball network of the project's own.
        images: Images (B, 3, H, W) like those of the training, for the statistics of the normalisations.

    Raises:
        ModelError: The file holds another network.
    """
    if not isinstance(open_ball_model(path), CentreModel):
        raise ModelError(f"{path} should be one of trueroll's own networks to continue from; it is a YOLO export")
    arrays = _read_arrays(path)
    weights = {name: arrays[name] for name in network.state_dict() if name in arrays}
    try:
        network.load_state_dict(weights, strict=False)
    except RuntimeError as error:
        raise ModelError(
            f"{path} should hold a network as wide as this version's to continue from; its arrays have other shapes"
        ) from error
    for block in network.blocks:
        last = block.get_submodule("inner.3")
        assert isinstance(last, nn.BatchNorm2d)
        nn.init.zeros_(last.weight)
    hooks = [
        norm.register_forward_pre_hook(_undo_normalisation(arrays[f"{conv}.{FOLDED_SHIFT}"]))
        for conv, norm in _find_normalised_convolutions(network)
        if f"{conv}.{FOLDED_SHIFT}" in arrays
    ]
    network.eval()(images)
    for hook in hooks:
        hook.remove()


def _read_arrays(path: Path) -> Arrays:
    """Read the arrays of an ONNX file, by their names in the network."""
    import onnx  # from the extra `train`, which training from random weights does not need

    initializers = onnx.load(str(path)).graph.initializer
    return {
        each.name.removeprefix(NAME_PREFIX): torch.from_numpy(np.array(onnx.numpy_helper.to_array(each)))
        for each in initializers
        if each.name.startswith(NAME_PREFIX)
    }


def _find_normalised_convolutions(network: BallNetwork) -> list[tuple[str, nn.BatchNorm2d]]:
    """Find the names of the convolutions that a normalisation follows, and those normalisations."""
    return [
        (f"{name}.{number}", after)
        for name, chain in network.named_modules()
        if isinstance(chain, nn.Sequential)
        for number, (before, after) in enumerate(pairwise(chain))
        if isinstance(before, nn.Conv2d) and isinstance(after, nn.BatchNorm2d)
    ]


def _undo_normalisation(shift: Tensor) -> Callable[[nn.BatchNorm2d, tuple[Tensor]], None]:
    """Build a hook that gives a normalisation the statistics of its first input, and lets it only add `shift` (C,)."""

    def learn(norm: nn.BatchNorm2d, given: tuple[Tensor]) -> None:
        variance, mean = torch.var_mean(given[0], dim=(0, 2, 3), correction=0)
        norm.running_mean, norm.running_var = mean, variance
        norm.weight.copy_((variance + norm.eps).sqrt())
        norm.bias.copy_(mean + shift)

    return learn
