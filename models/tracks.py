"""Balls through time: which detection is which ball."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

KINDS = ("cue", "solid", "stripe", "eight", "red", "yellow", "white", "green", "brown", "blue", "pink", "black", "ball")
"""What a ball can be called. `cue` is the pool or snooker cue ball; `white` and `yellow` the carom cue balls."""


@dataclass(frozen=True, slots=True)
class Tracks:
    """N balls at T distinct pictures (repeats left out); NaN where a ball was not seen.

    Positions in metres are those of the ball's centre, in the plane one radius above the cloth.
    """

    frame: NDArray[np.int64]
    """(T,) picture in presentation order, strictly increasing."""
    t: Floats
    """(T,) s, at mid-exposure as far as known: the presentation time."""
    ids: tuple[str, ...]
    """(N,) unique names, such as `cue`, `red`, `solid-2`."""
    kinds: tuple[str, ...]
    """(N,) one of `KINDS`."""
    xy: Floats
    """(T, N, 2) m."""
    px: Floats
    """(T, N, 2) px of the original picture."""
    sigma: Floats
    """(T, N) m, one standard deviation per axis, across the streak."""
    sigma_along: Floats
    """(T, N) m, along the streak; equals `sigma` for sharp balls."""
    streak: Floats
    """(T, N, 2) m: the way travelled during the exposure, sign unknown; (0, 0) for sharp balls."""
    radius_px: Floats
    """(T, N) px."""
    colour: Floats
    """(N, 3) CIE L*a*b*."""

    def __post_init__(self) -> None:
        frames, balls = len(self.frame), len(self.ids)
        if len(set(self.ids)) != balls or len(self.kinds) != balls:
            raise ValueError("Tracks needs one unique id and one kind per ball")
        for name, shape in (
            ("t", (frames,)), ("xy", (frames, balls, 2)), ("px", (frames, balls, 2)), ("streak", (frames, balls, 2)),
            ("sigma", (frames, balls)), ("sigma_along", (frames, balls)), ("radius_px", (frames, balls)),
            ("colour", (balls, 3)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"Tracks.{name} must be {shape}; got {getattr(self, name).shape}")
        if frames > 1 and (np.any(np.diff(self.frame) <= 0) or np.any(np.diff(self.t) <= 0)):
            raise ValueError("Tracks must go forward in frame and time")

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(T, N) where a ball was seen."""
        return np.isfinite(self.xy[..., 0])
