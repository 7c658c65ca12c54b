"""A trained network to an ONNX file that says what it is, and the proof that both compute the same."""

from __future__ import annotations

import contextlib
import io
import json
import logging
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.centres import CHANNELS, COARSE_STRIDE, LOOKS, RADIUS_UNIT_PX, STREAK_UNIT_PX, STRIDE
from detectors.network import BallNetwork
from detectors.onnx_model import SCHEMA
from video.inference import onnxruntime

OPSET = 18
PARITY = 2e-3
"""Largest difference that the exported network may show from the trained one: float32 in another order."""


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
    example = torch.zeros((1, 24 * COARSE_STRIDE, 32 * COARSE_STRIDE, 3), dtype=torch.uint8)
    with _quiet():
        program = torch.onnx.export(
            shipped, (example,), dynamo=True, opset_version=OPSET, dynamic_shapes=(sides,),
            input_names=["picture"], output_names=["maps"],
        )  # fmt: skip
    if program is None:
        raise RuntimeError("torch could not export the network to ONNX")
    model = program.model_proto
    for name, value in (_contract() | {key: json.dumps(value) for key, value in facts.items()}).items():
        entry = model.metadata_props.add()
        entry.key, entry.value = name, value
    aside = path.with_suffix(".part")
    aside.write_bytes(model.SerializeToString())
    worst = disagreement(shipped, aside)
    if worst > PARITY:
        aside.unlink()
        raise RuntimeError(
            f"the exported network should agree with the trained one to {PARITY}; it differs by {worst:.2g}"
        )
    aside.replace(path)


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


def disagreement(shipped: ShippedNetwork, path: Path) -> float:
    """Largest difference of both networks' maps over pictures of several sizes."""
    rng = np.random.default_rng(0)
    session = onnxruntime.InferenceSession(path.read_bytes(), providers=["CPUExecutionProvider"])
    worst = 0.0
    for rows, columns in ((4, 5), (20, 12), (45, 80)):
        picture: NDArray[np.uint8] = rng.integers(0, 256, (1, 8 * rows, 8 * columns, 3), dtype=np.uint8)
        with torch.no_grad():
            mine = shipped(torch.from_numpy(picture)).numpy()
        theirs = np.asarray(session.run(None, {"picture": picture})[0])
        worst = max(worst, float(np.abs(mine - theirs).max()))
    return worst


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """The exporter talks about its steps and about packages that are not needed."""
    logger = logging.getLogger("torch.onnx")
    level = logger.level
    logger.setLevel(logging.ERROR)
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")
        try:
            yield
        finally:
            logger.setLevel(level)
