"""Export of a trained ball network to an ONNX file with metadata."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.network.ball_model import SCHEMA
from detectors.network.peak_decoding import APPEARANCES, CHANNELS, COARSE_STRIDE, RADIUS_UNIT_PX, STREAK_UNIT_PX, STRIDE
from detectors.training.networks.ball_network import BallNetwork
from detectors.training.onnx_export import encode_json_values, write_onnx_network

# Rows and columns, times COARSE_STRIDE, of the images for which the exported network is compared with the trained one.
PARITY_SIZES = ((24, 32), (4, 5), (20, 12), (45, 80))


@dataclass(frozen=True, slots=True)
class NetworkCalibration:
    """Calibration of a network's scores to probabilities and of its sigmas, fitted on hold-out images."""

    slope: float = 1.0
    offset: float = 0.0
    """score = logistic(slope * logit + offset) (Platt 1999)."""
    sigma_factor: float = 1.0
    """Factor of the sigmas across and along the streak."""


class ExportedBallNetwork(nn.Module):
    """A network with its pre- and post-processing: bytes in, calibrated maps out."""

    def __init__(self, network: BallNetwork, calibration: NetworkCalibration) -> None:
        super().__init__()
        self.network = network.eval()
        self.calibration = calibration

    def forward(self, image: Tensor) -> Tensor:
        """Map RGB bytes (1, H, W, 3), sides multiples of 8, to (1, 12, H / 4, W / 4)."""
        maps = self.network(image.permute(0, 3, 1, 2).to(torch.float32) / 255)
        score = torch.sigmoid(self.calibration.slope * maps[:, :1] + self.calibration.offset)
        sigma = maps[:, 6:8] + float(np.log(self.calibration.sigma_factor))
        return torch.cat([score, maps[:, 1:6], sigma, maps[:, 8:]], dim=1)


def export_ball_network(
    network: BallNetwork, calibration: NetworkCalibration, facts: dict[str, object], path: Path
) -> None:
    """Write a ball network as an ONNX file with metadata.

    Args:
        network: The trained network.
        calibration: Its calibration.
        facts: Recipe and figures, for the metadata.
        path: The file.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    shipped = ExportedBallNetwork(network, calibration).eval()
    sides = {1: COARSE_STRIDE * torch.export.Dim("rows", min=2), 2: COARSE_STRIDE * torch.export.Dim("columns", min=2)}
    write_onnx_network(
        shipped,
        sides,
        ("picture", "maps"),
        _contract_metadata() | encode_json_values(facts),
        build_parity_inputs(),
        path,
    )


def build_parity_inputs() -> list[NDArray[np.uint8]]:
    """Build random images (1, H, W, 3) of several sizes."""
    rng = np.random.default_rng(0)
    step = COARSE_STRIDE
    return [rng.integers(0, 256, (1, step * rows, step * columns, 3), dtype=np.uint8) for rows, columns in PARITY_SIZES]


def _contract_metadata() -> dict[str, str]:
    return {
        "trueroll.schema": SCHEMA,
        "trueroll.channels": ",".join(CHANNELS),
        "trueroll.looks": ",".join(APPEARANCES),
        "trueroll.stride": str(STRIDE),
        "trueroll.side_multiple": str(COARSE_STRIDE),
        "trueroll.units": json.dumps({"radius_px": RADIUS_UNIT_PX, "streak_px": STREAK_UNIT_PX}),
        "trueroll.input": "RGB bytes (1, H, W, 3), balls with radii of 4 to 12 px; scaled to [0, 1] inside",
    }
