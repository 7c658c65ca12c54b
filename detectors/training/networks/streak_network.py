"""The network that measures one streak closer: from its straightened picture to where it is, with errors."""

from __future__ import annotations

from detectors.network.streak_crop import COLUMNS, ROWS
from detectors.training.networks.offset_network import MeasuringNetwork

WIDTHS = (16, 32, 64)
TOLD = ("ahead", "beside", "longer", "aside")
"""What is told of a streak beside the one that was shown, ball radii: see `Straight.told`."""


def streak_network() -> MeasuringNetwork:
    """One that knows nothing yet; pictures (B, 3, ROWS, COLUMNS) to (B, 8)."""
    return MeasuringNetwork(ROWS, COLUMNS, WIDTHS, TOLD)
