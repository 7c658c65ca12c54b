"""A trained streak network: its figures on halls it never saw, and its file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from detectors.network.streak_crop import COLUMNS, ROWS
from detectors.network.streak_regressor import SCHEMA
from detectors.training.data.streak_samples import StreakPictures
from detectors.training.networks.offset_network import MeasuringNetwork
from detectors.training.offset_export import CENTRE, CLEAR_SHARE, export_measuring, pulls_of, rms, rounded, said_of


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


def streak_figures(network: MeasuringNetwork, factor: float, pictures: StreakPictures) -> StreakFigures:
    """What the network did with pictures that it was never trained on."""
    clear = pictures.visible >= CLEAR_SHARE
    said, sigma = said_of(network, pictures.shown)
    shown, left = pictures.told[clear, :CENTRE], (pictures.told - said)[clear, :CENTRE]
    best = np.abs(left[:, 0]) <= np.quantile(np.abs(left[:, 0]), 0.95) if len(left) else clear[clear]
    pulls = pulls_of(said, factor * sigma, pictures.told)
    spread = float(np.std(pulls)) if len(pulls) else np.nan
    return StreakFigures(int(clear.sum()), *rms(shown), *rms(left), rms(left[best])[0], spread)


def export_streaks(
    network: MeasuringNetwork, factor: float, figures: StreakFigures, recipe: dict[str, object], path: Path
) -> dict[str, float]:
    """Write an ONNX file with metadata and return the figures. RuntimeError if it does not agree with the network."""
    contract = {
        "trueroll.schema": SCHEMA,
        "trueroll.input": f"RGB bytes (B, {ROWS}, {COLUMNS}, 3), straightened streaks; scaled to [0, 1] inside",
    }
    facts = {"trueroll.held_out": rounded(figures), "trueroll.recipe": recipe}
    export_measuring(network, factor, contract, facts, (ROWS, COLUMNS), path)
    return rounded(figures)
