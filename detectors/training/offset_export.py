"""Export of a trained offset regressor to an ONNX file with metadata."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from detectors.network.offset_regressor import INPUT_NAME, OUTPUT_NAME
from detectors.network.peak_decoding import LOG_SIGMA_LIMITS
from detectors.training.networks.offset_network import OffsetNetwork
from detectors.training.offset_evaluation import DiscFigures, StreakFigures, round_figures
from detectors.training.onnx_export import encode_json_values, write_onnx_network

PARITY_COUNTS = (4, 1, 7)
"""Numbers of crops for which the exported network is compared with the trained one."""


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
    network: OffsetNetwork,
    factor: float,
    figures: DiscFigures | StreakFigures,
    recipe: dict[str, object],
    path: Path,
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
