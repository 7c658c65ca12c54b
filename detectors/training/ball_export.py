"""A trained ball network to an ONNX file that says what it is."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.network.network_file import SCHEMA
from detectors.network.peak_decoding import CHANNELS, COARSE_STRIDE, LOOKS, RADIUS_UNIT_PX, STREAK_UNIT_PX, STRIDE
from detectors.training.networks.ball_network import BallNetwork
from detectors.training.onnx_export import as_json, write_onnx

SIZES = ((24, 32), (4, 5), (20, 12), (45, 80))
"""Rows and columns, times COARSE_STRIDE, of the pictures for which the exported network is compared."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What turns a network's outputs into probabilities and honest errors, fitted on held-out pictures."""

    slope: float = 1.0
    offset: float = 0.0
    """score = logistic(slope * logit + offset) (Platt 1999)."""
    sigma_factor: float = 1.0
    """Of the sigmas across and along."""


class ShippedNetwork(nn.Module):
    """A network with what comes before and after it: bytes in, calibrated maps out."""

    def __init__(self, network: BallNetwork, calibration: Calibration) -> None:
        super().__init__()
        self.network = network.eval()
        self.calibration = calibration

    def forward(self, picture: Tensor) -> Tensor:
        """(1, H, W, 3) RGB bytes, sides multiples of 8, to (1, 12, H / 4, W / 4)."""
        maps = self.network(picture.permute(0, 3, 1, 2).to(torch.float32) / 255)
        score = torch.sigmoid(self.calibration.slope * maps[:, :1] + self.calibration.offset)
        sigma = maps[:, 6:8] + float(np.log(self.calibration.sigma_factor))
        return torch.cat([score, maps[:, 1:6], sigma, maps[:, 8:]], dim=1)


def export(network: BallNetwork, calibration: Calibration, facts: dict[str, object], path: Path) -> None:
    """Write an ONNX file with metadata; `facts` are the recipe and the figures. RuntimeError if it does not agree."""
    shipped = ShippedNetwork(network, calibration).eval()
    sides = {1: COARSE_STRIDE * torch.export.Dim("rows", min=2), 2: COARSE_STRIDE * torch.export.Dim("columns", min=2)}
    write_onnx(shipped, sides, ("picture", "maps"), _contract() | as_json(facts), pictures_tried(), path)


def pictures_tried() -> list[NDArray[np.uint8]]:
    """Pictures (1, H, W, 3) of several sizes."""
    rng = np.random.default_rng(0)
    step = COARSE_STRIDE
    return [rng.integers(0, 256, (1, step * rows, step * columns, 3), dtype=np.uint8) for rows, columns in SIZES]


def _contract() -> dict[str, str]:
    return {
        "trueroll.schema": SCHEMA,
        "trueroll.channels": ",".join(CHANNELS),
        "trueroll.looks": ",".join(LOOKS),
        "trueroll.stride": str(STRIDE),
        "trueroll.side_multiple": str(COARSE_STRIDE),
        "trueroll.units": json.dumps({"radius_px": RADIUS_UNIT_PX, "streak_px": STREAK_UNIT_PX}),
        "trueroll.input": "RGB bytes (1, H, W, 3), balls with radii of 4 to 12 px; scaled to [0, 1] inside",
    }
