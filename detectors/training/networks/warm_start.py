"""Training that goes on from an exported network instead of from nothing.

The exporter folds every batch normalisation that follows a convolution into it. Training needs them back: each is given
the statistics of some pictures and undoes them again, so that it changes nothing at first and is learnt from there.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from detectors.network.network_file import CentreModel, open_model
from detectors.training.networks.ball_network import BallNetwork
from models.core.errors import ModelError

PREFIX = "network."
"""Of the names of the network's arrays in a file."""
FOLDED = "weight_bias"
"""Name of a convolution's shift that was the normalisation's."""

Arrays = dict[str, Tensor]


@torch.no_grad()
def start_from(network: BallNetwork, path: Path, pictures: Tensor) -> None:
    """Give a network the weights in an exported file, seeing `pictures` (B, 3, H, W) like those it will be trained on.

    Blocks that the file lacks begin as identities. ModelError where the file holds something else.
    """
    if not isinstance(open_model(path), CentreModel):
        raise ModelError(f"{path} should be one of trueroll's own networks to go on from; it is a YOLO export")
    arrays = _arrays(path)
    given = {name: arrays[name] for name in network.state_dict() if name in arrays}
    try:
        network.load_state_dict(given, strict=False)
    except RuntimeError as error:
        raise ModelError(
            f"{path} should hold a network as wide as this version's to go on from; its arrays have other shapes"
        ) from error
    for block in network.blocks:
        last = block.get_submodule("inner.3")
        assert isinstance(last, nn.BatchNorm2d)
        nn.init.zeros_(last.weight)
    hooks = [
        norm.register_forward_pre_hook(_undone(arrays[f"{conv}.{FOLDED}"]))
        for conv, norm in _normalised(network)
        if f"{conv}.{FOLDED}" in arrays
    ]
    network.eval()(pictures)
    for hook in hooks:
        hook.remove()


def _arrays(path: Path) -> Arrays:
    """Of an ONNX file, by the names that they have in the network."""
    import onnx  # of the extra `train`, which training from nothing does without

    held = onnx.load(str(path)).graph.initializer
    return {
        each.name.removeprefix(PREFIX): torch.from_numpy(np.array(onnx.numpy_helper.to_array(each)))
        for each in held
        if each.name.startswith(PREFIX)
    }


def _normalised(network: BallNetwork) -> list[tuple[str, nn.BatchNorm2d]]:
    """Names of the convolutions that a normalisation follows, and those."""
    return [
        (f"{name}.{number}", after)
        for name, chain in network.named_modules()
        if isinstance(chain, nn.Sequential)
        for number, (before, after) in enumerate(pairwise(chain))
        if isinstance(before, nn.Conv2d) and isinstance(after, nn.BatchNorm2d)
    ]


def _undone(shift: Tensor) -> Callable[[nn.BatchNorm2d, tuple[Tensor]], None]:
    """Before a normalisation sees its first pictures: let it know them, and only add `shift` (C,) to them."""

    def learn(norm: nn.BatchNorm2d, given: tuple[Tensor]) -> None:
        variance, mean = torch.var_mean(given[0], dim=(0, 2, 3), correction=0)
        norm.running_mean, norm.running_var = mean, variance
        norm.weight.copy_((variance + norm.eps).sqrt())
        norm.bias.copy_(mean + shift)

    return learn
