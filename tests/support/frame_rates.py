"""Tracks of a clip whose frame rate was converted: capture times differ from presentation times."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.tracks import Tracks

PER_FRAME = ("frame", "t", "xy", "px", "sigma", "sigma_along", "streak", "radius_px")


def convert_rate(tracks: Tracks) -> Tracks:
    """Convert 30 to 25 fps by leaving out every sixth frame."""
    rows = np.flatnonzero(np.arange(len(tracks.t)) % 6 != 4)
    reduced = replace(tracks, **{name: getattr(tracks, name)[rows] for name in PER_FRAME})
    return replace(reduced, frame=np.arange(len(rows)), t=np.arange(len(rows)) / 25)
