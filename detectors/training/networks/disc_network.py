"""The network that measures one ball at rest closer: from its picture to where its centre is, with errors."""

from __future__ import annotations

from detectors.network.disc_crop import SIDE
from detectors.training.networks.offset_network import MeasuringNetwork

WIDTHS = (24, 40, 64)
TOLD = ("right", "down")
"""What is told of a ball beside the place that was shown, ball radii: see `Upright.told`."""


def disc_network() -> MeasuringNetwork:
    """One that knows nothing yet; pictures (B, 3, SIDE, SIDE) to (B, 4)."""
    return MeasuringNetwork(SIDE, SIDE, WIDTHS, TOLD)
