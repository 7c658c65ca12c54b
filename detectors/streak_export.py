"""A trained streak network, checked on halls it never saw, to an ONNX file that says what it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from detectors.centres import SIGMA_LIMITS
from detectors.onnx_writer import as_json, write_onnx
from detectors.straightened import COLUMNS, ROWS
from detectors.streak_model import SCHEMA
from detectors.streak_network import TOLD, StreakNetwork
from detectors.streak_pictures import StreakPictures
from detectors.training import as_input
from detectors.training_check import MOST_PULL

Floats = NDArray[np.float64]

AT_ONCE = 256
CLEAR_SHARE = 0.5
"""Visible share of the balls that the figures are of."""


@dataclass(frozen=True, slots=True)
class StreakFigures:
    """On held-out drawn pictures, ball radii, one look."""

    streaks: int
    shown_along: float
    shown_across: float
    """Root mean square error of the centre that the ball network told."""
    along: float
    across: float
    """The same of this network."""
    along_of_best: float
    """Of the best 95 %."""
    pull_std: float


class ShippedStreaks(nn.Module):
    """A network with what comes before and after it: bytes in, honest errors out."""

    def __init__(self, network: StreakNetwork, sigma_factor: float) -> None:
        super().__init__()
        self.network = network.eval()
        self.wider = float(np.log(sigma_factor))

    def forward(self, shown: Tensor) -> Tensor:
        """(B, ROWS, COLUMNS, 3) RGB bytes to (B, 8)."""
        said = self.network(shown.permute(0, 3, 1, 2).to(torch.float32) / 255)
        width = said[:, len(TOLD) :].clamp(*SIGMA_LIMITS) + self.wider
        return torch.cat([said[:, : len(TOLD)], width], dim=1)


def sigma_factor(network: StreakNetwork, pictures: StreakPictures) -> float:
    """By how much the sigmas have to be larger for the pulls of the centres to be one; 1 without pictures."""
    pulls = _pulls(*said_of(network, pictures), pictures)
    return float(np.std(pulls)) if len(pulls) > 1 else 1.0


def figures_of(network: StreakNetwork, factor: float, pictures: StreakPictures) -> StreakFigures:
    """What the network did with pictures that it was never trained on."""
    clear = pictures.visible >= CLEAR_SHARE
    said, sigma = said_of(network, pictures)
    shown, left = pictures.told[clear, :2], (pictures.told - said)[clear, :2]
    best = np.abs(left[:, 0]) <= np.quantile(np.abs(left[:, 0]), 0.95) if len(left) else clear[clear]
    pulls = _pulls(said, factor * sigma, pictures)
    return StreakFigures(
        int(clear.sum()),
        *_rms(shown),
        *_rms(left),
        float(_rms(left[best])[0]),
        float(np.std(pulls)) if len(pulls) else np.nan,
    )


def said_of(network: StreakNetwork, pictures: StreakPictures) -> tuple[Floats, Floats]:
    """What the network says of each picture (K, 4), and its sigmas (K, 4)."""
    network.eval()
    with torch.no_grad():
        parts = [network(as_input(pictures.shown[k : k + AT_ONCE])).numpy() for k in range(0, len(pictures), AT_ONCE)]
    said = np.concatenate([np.empty((0, 2 * len(TOLD))), *parts])
    return said[:, : len(TOLD)], np.exp(np.clip(said[:, len(TOLD) :], *SIGMA_LIMITS))


def _pulls(said: Floats, sigma: Floats, pictures: StreakPictures) -> Floats:
    """Misses of the centres over their sigmas (n,), without what is another thing."""
    pulls = ((pictures.told - said) / sigma)[:, :2].ravel()
    return np.asarray(pulls[np.abs(pulls) < MOST_PULL], dtype=np.float64)


def _rms(misses: NDArray[np.floating]) -> tuple[float, float]:
    along, across = np.sqrt((misses**2).mean(axis=0)) if len(misses) else (np.nan, np.nan)
    return float(along), float(across)


def export_streaks(
    network: StreakNetwork, factor: float, figures: StreakFigures, recipe: dict[str, object], path: Path
) -> dict[str, float]:
    """Write an ONNX file with metadata and return the figures. RuntimeError if it does not agree with the network."""
    rounded = {k: round(float(v), 4) for k, v in asdict(figures).items() if v == v}
    facts = as_json(
        {"trueroll.held_out": rounded, "trueroll.calibration": {"sigma_factor": factor}, "trueroll.recipe": recipe}
    )
    rng = np.random.default_rng(0)
    tried = [rng.integers(0, 256, (count, ROWS, COLUMNS, 3), dtype=np.uint8) for count in (4, 1, 7)]
    shipped = ShippedStreaks(network, factor).eval()
    contract = {
        "trueroll.schema": SCHEMA,
        "trueroll.told": ",".join(TOLD),
        "trueroll.input": f"RGB bytes (B, {ROWS}, {COLUMNS}, 3), straightened streaks; scaled to [0, 1] inside",
    }
    write_onnx(shipped, {0: torch.export.Dim("streaks", min=1)}, ("shown", "told"), contract | facts, tried, path)
    return rounded
