"""A trained measuring network, its errors made honest on halls it never saw, to an ONNX file that says what it is."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.network.peak_decoding import SIGMA_LIMITS
from detectors.training.ball_training import as_input
from detectors.training.evaluation import MOST_PULL
from detectors.training.networks.offset_network import MeasuringNetwork
from detectors.training.onnx_export import as_json, write_onnx
from models.core.typing import ByteArray, Float32Array, FloatArray

AT_ONCE = 256
CLEAR_SHARE = 0.5
"""Visible share of the balls that figures are of."""
CENTRE = 2
"""The first numbers that such a network tells are of the centre."""


class Shipped(nn.Module):
    """A network with what comes before and after it: bytes in, honest errors out."""

    def __init__(self, network: MeasuringNetwork, sigma_factor: float) -> None:
        super().__init__()
        self.network = network.eval()
        self.wider = float(np.log(sigma_factor))

    def forward(self, shown: Tensor) -> Tensor:
        """(B, rows, columns, 3) RGB bytes to (B, 2 n)."""
        said = self.network(shown.permute(0, 3, 1, 2).to(torch.float32) / 255)
        n = len(self.network.names)
        return torch.cat([said[:, :n], said[:, n:].clamp(*SIGMA_LIMITS) + self.wider], dim=1)


def said_of(network: MeasuringNetwork, shown: ByteArray) -> tuple[FloatArray, FloatArray]:
    """What the network says of each picture (K, rows, columns, 3): n numbers (K, n), and their sigmas (K, n)."""
    network.eval()
    n = len(network.names)
    with torch.no_grad():
        parts = [network(as_input(shown[k : k + AT_ONCE])).numpy() for k in range(0, len(shown), AT_ONCE)]
    said = np.concatenate([np.empty((0, 2 * n)), *parts])
    return said[:, :n], np.exp(np.clip(said[:, n:], *SIGMA_LIMITS))


def sigma_factor(network: MeasuringNetwork, shown: ByteArray, told: Float32Array) -> float:
    """By how much the sigmas have to be larger for the pulls of the centres to be one; 1 without pictures."""
    pulls = pulls_of(*said_of(network, shown), told)
    return float(np.std(pulls)) if len(pulls) > 1 else 1.0


def pulls_of(said: FloatArray, sigma: FloatArray, told: Float32Array) -> FloatArray:
    """Misses of the centres over their sigmas (n,), without what is another thing."""
    pulls = ((told - said) / sigma)[:, :CENTRE].ravel()
    return np.asarray(pulls[np.abs(pulls) < MOST_PULL], dtype=np.float64)


def rms(misses: NDArray[np.floating]) -> tuple[float, float]:
    """Of misses (n, 2) along both axes; NaN without any."""
    along, across = np.sqrt((misses**2).mean(axis=0)) if len(misses) else (np.nan, np.nan)
    return float(along), float(across)


def rounded(figures: Any) -> dict[str, float]:
    """The fields of a dataclass of numbers; NaN is left out."""
    return {name: round(float(value), 4) for name, value in asdict(figures).items() if value == value}


def export_measuring(
    network: MeasuringNetwork,
    factor: float,
    contract: dict[str, str],
    facts: dict[str, object],
    side: tuple[int, int],
    path: Path,
) -> None:
    """Write an ONNX file with metadata `contract` and, as JSON, `facts`; `side` are rows and columns of a picture.

    RuntimeError if it does not agree with the network.
    """
    rng = np.random.default_rng(0)
    tried = [rng.integers(0, 256, (count, *side, 3), dtype=np.uint8) for count in (4, 1, 7)]
    told = {"trueroll.told": ",".join(network.names)}
    calibration = as_json({"trueroll.calibration": {"sigma_factor": factor}, **facts})
    shapes = {0: torch.export.Dim("pictures", min=1)}
    shipped = Shipped(network, factor).eval()
    write_onnx(shipped, shapes, ("shown", "told"), contract | told | calibration, tried, path)
