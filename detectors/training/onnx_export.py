"""Export of trained networks to ONNX files with metadata, with a check that both compute the same."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.network.ball_model import SCHEMA
from detectors.network.offset_regressor import INPUT_NAME, OUTPUT_NAME
from detectors.network.peak_decoding import (
    APPEARANCES,
    CHANNELS,
    COARSE_STRIDE,
    LOG_SIGMA_LIMITS,
    RADIUS_UNIT_PX,
    STREAK_UNIT_PX,
    STRIDE,
)
from detectors.training.detector_networks import BallNetwork, OffsetNetwork
from models.core.typing import ByteArray
from video.io.onnx_session import onnxruntime

# Version of the ONNX operators.
OPSET = 18
# Largest accepted difference of the outputs of the exported and the trained network: float32 in another order.
MAX_DISAGREEMENT = 2e-3


def write_onnx_network(
    network: nn.Module,
    dynamic_sides: dict[int, Any],
    names: tuple[str, str],
    contract: dict[str, str],
    facts: dict[str, object],
    parity_inputs: list[ByteArray],
    path: Path,
) -> None:
    """Write a network with one input and one output as an ONNX file.

    Args:
        network: The trained network with its pre- and post-processing.
        dynamic_sides: Sides of the input that are open (`torch.export.Dim`), by axis.
        names: Names of the input and the output.
        metadata: Values by name.
        parity_inputs: Inputs for which both must agree; the first is also the exporter's example.
        path: The file.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    with _silence_exporter():
        program = torch.onnx.export(
            network, (torch.from_numpy(parity_inputs[0]),), dynamo=True, opset_version=OPSET,
            dynamic_shapes=(dynamic_sides,), input_names=[names[0]], output_names=[names[1]],
        )  # fmt: skip
    if program is None:
        raise RuntimeError("torch could not export the network to ONNX")
    model = program.model_proto
    for name, value in (contract | {name: json.dumps(fact) for name, fact in facts.items()}).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = f"trueroll.{name}", value
    aside = path.with_suffix(".part")
    aside.write_bytes(model.SerializeToString())
    worst = max_disagreement(network, aside, parity_inputs)
    if worst > MAX_DISAGREEMENT:
        aside.unlink()
        raise RuntimeError(
            f"the exported network should agree with the trained one to {MAX_DISAGREEMENT}; it differs by {worst:.2g}"
        )
    aside.replace(path)


def max_disagreement(network: nn.Module, path: Path, parity_inputs: list[ByteArray]) -> float:
    """Largest difference of the outputs of a network and of an ONNX file for some inputs."""
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    name, worst = session.get_inputs()[0].name, 0.0
    for network_input in parity_inputs:
        with torch.no_grad():
            trained = network(torch.from_numpy(network_input)).numpy()
        exported = np.asarray(session.run(None, {name: network_input})[0])
        worst = max(worst, float(np.abs(trained - exported).max()))
    return worst


@contextlib.contextmanager
def _silence_exporter() -> Iterator[None]:
    """Suppress the exporter's messages about its steps and about packages that are not needed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logger.setLevel(level)


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
    network: BallNetwork,
    calibration: NetworkCalibration,
    figures: dict[str, float],
    recipe: dict[str, object],
    path: Path,
) -> None:
    """Write a ball network as an ONNX file with metadata.

    Args:
        network: The trained network.
        calibration: Its calibration.
        figures: Its figures on hold-out images, for the metadata.
        recipe: How it was trained, for the metadata.
        path: The file.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    sides = {1: COARSE_STRIDE * torch.export.Dim("rows", min=2), 2: COARSE_STRIDE * torch.export.Dim("columns", min=2)}
    contract = {
        "schema": SCHEMA,
        "channels": ",".join(CHANNELS),
        "looks": ",".join(APPEARANCES),
        "stride": str(STRIDE),
        "side_multiple": str(COARSE_STRIDE),
        "units": json.dumps({"radius_px": RADIUS_UNIT_PX, "streak_px": STREAK_UNIT_PX}),
        "input": "RGB bytes (1, H, W, 3), balls with radii of 4 to 12 px; scaled to [0, 1] inside",
    }
    facts: dict[str, object] = {"calibration": asdict(calibration), "held_out": figures, "recipe": recipe}
    shipped = ExportedBallNetwork(network, calibration).eval()
    write_onnx_network(shipped, sides, ("picture", "maps"), contract, facts, build_parity_inputs(), path)


def build_parity_inputs() -> list[NDArray[np.uint8]]:
    """Build random images (1, H, W, 3) of several sizes."""
    rng = np.random.default_rng(0)
    step = COARSE_STRIDE
    return [rng.integers(0, 256, (1, step * rows, step * columns, 3), dtype=np.uint8) for rows, columns in PARITY_SIZES]


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
    network: OffsetNetwork, factor: float, figures: dict[str, float], recipe: dict[str, object], path: Path
) -> None:
    """Write an offset regressor as an ONNX file with metadata.

    Args:
        network: The trained network.
        factor: Factor of its sigmas.
        figures: Its figures on hold-out samples, for the metadata.
        recipe: How it was trained, for the metadata.
        path: The file.

    Raises:
        RuntimeError: The exported network does not agree with the trained one.
    """
    kind, rng = network.kind, np.random.default_rng(0)
    parity_inputs = [
        rng.integers(0, 256, (count, kind.rows, kind.columns, 3), dtype=np.uint8) for count in PARITY_COUNTS
    ]
    contract = {
        "schema": kind.schema,
        "input": f"RGB bytes (B, {kind.rows}, {kind.columns}, 3), {kind.crop_content}; scaled to [0, 1] inside",
        "told": ",".join(kind.outputs),
    }
    facts: dict[str, object] = {"calibration": {"sigma_factor": factor}, "held_out": figures, "recipe": recipe}
    sides = {0: torch.export.Dim("pictures", min=1)}
    exported = ExportedOffsetNetwork(network, factor).eval()
    write_onnx_network(exported, sides, (INPUT_NAME, OUTPUT_NAME), contract, facts, parity_inputs, path)
