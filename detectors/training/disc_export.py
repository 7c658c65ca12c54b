"""A trained disc network: its figures on halls it never saw, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detectors.network.disc_crop import SIDE
from detectors.network.disc_regressor import SCHEMA
from detectors.training.data.disc_samples import DiscPictures
from detectors.training.networks.offset_network import MeasuringNetwork
from detectors.training.offset_export import CLEAR_SHARE, export_measuring, pulls_of, rms, rounded, said_of


@dataclass(frozen=True, slots=True)
class DiscFigures:
    """On held-out drawn pictures, ball radii, one look."""

    discs: int
    right: float
    down: float
    """Root mean square error of the centre per axis."""
    of_best: float
    """The same, both axes together, of the best 95 %."""
    of_whole: float
    """Of balls that nothing hides."""
    pull_std: float


WHOLE_SHARE = 0.999
"""Visible share of a ball that nothing hides."""


def disc_figures(network: MeasuringNetwork, factor: float, pictures: DiscPictures) -> DiscFigures:
    """What the network did with pictures that it was never trained on."""
    clear, whole = pictures.visible >= CLEAR_SHARE, pictures.visible >= WHOLE_SHARE
    said, sigma = said_of(network, pictures.shown)
    left = pictures.told - said
    worst = np.abs(left[clear]).max(axis=1)
    best = left[clear][worst <= np.quantile(worst, 0.95)] if clear.any() else left[clear]
    pulls = pulls_of(said, factor * sigma, pictures.told)
    spread = float(np.std(pulls)) if len(pulls) else np.nan
    of_best, of_whole = (float(np.sqrt((part**2).mean())) if len(part) else np.nan for part in (best, left[whole]))
    return DiscFigures(int(clear.sum()), *rms(left[clear]), of_best, of_whole, spread)


def export_discs(
    network: MeasuringNetwork, factor: float, figures: DiscFigures, recipe: dict[str, object], path: Path
) -> dict[str, float]:
    """Write an ONNX file with metadata and return the figures. RuntimeError if it does not agree with the network."""
    contract = {
        "trueroll.schema": SCHEMA,
        "trueroll.input": f"RGB bytes (B, {SIDE}, {SIDE}, 3), a ball in the middle each; scaled to [0, 1] inside",
    }
    facts = {"trueroll.held_out": rounded(figures), "trueroll.recipe": recipe}
    export_measuring(network, factor, contract, facts, (SIDE, SIDE), path)
    return rounded(figures)
