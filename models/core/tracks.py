"""Balls through time: which detection is which ball."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.typing import FloatArray

KINDS = ("cue", "solid", "stripe", "eight", "red", "yellow", "white", "green", "brown", "blue", "pink", "black", "ball")
"""What a ball can be called. `cue` is the pool or snooker cue ball; `white` and `yellow` the carom cue balls."""


@dataclass(frozen=True, slots=True)
class Tracks:
    """N balls at T distinct pictures (repeats left out); NaN where a ball was not seen.

    Positions in metres are those of the ball's centre, in the plane one radius above the cloth.
    """

    frame: NDArray[np.int64]
    """(T,) picture in presentation order, strictly increasing."""
    t: FloatArray
    """(T,) s, at mid-exposure as far as known: the presentation time."""
    ids: tuple[str, ...]
    """(N,) unique names, such as `cue`, `red`, `solid-2`."""
    kinds: tuple[str, ...]
    """(N,) one of `KINDS`."""
    xy: FloatArray
    """(T, N, 2) m."""
    px: FloatArray
    """(T, N, 2) px of the original picture."""
    sigma: FloatArray
    """(T, N) m, one standard deviation per axis, across the streak."""
    sigma_along: FloatArray
    """(T, N) m, along the streak; equals `sigma` for sharp balls."""
    streak: FloatArray
    """(T, N, 2) m: the way travelled during the exposure, sign unknown; (0, 0) for sharp balls."""
    radius_px: FloatArray
    """(T, N) px."""
    colour: FloatArray
    """(N, 3) CIE L*a*b*."""
    lay: FloatArray | None = None
    """(T, N, 2, 2) how the picture lies on the table: d(m)/d(px) over its root mean square per axis, so that a circle
    of errors in an oblique picture is an ellipse on the table. `sigma` and `sigma_along` are pixels times that root
    mean square. None: no direction is special."""

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
        if self.lay is not None and self.lay.shape != (frames, balls, 2, 2):
            raise ValueError(f"Tracks.lay must be {(frames, balls, 2, 2)}; got {self.lay.shape}")
        if frames > 1 and (np.any(np.diff(self.frame) <= 0) or np.any(np.diff(self.t) <= 0)):
            raise ValueError("Tracks must go forward in frame and time")

    def until(self, t: float) -> Tracks:
        """What was seen up to t (s): earlier pictures, and the balls that are in them."""
        rows = self.t <= t + 1e-9
        balls = np.flatnonzero(self.observed[rows].any(axis=0))
        part = np.ix_(rows, balls)
        return replace(
            self, frame=self.frame[rows], t=self.t[rows], ids=tuple(self.ids[k] for k in balls),
            kinds=tuple(self.kinds[k] for k in balls), xy=self.xy[part], px=self.px[part], sigma=self.sigma[part],
            sigma_along=self.sigma_along[part], streak=self.streak[part], radius_px=self.radius_px[part],
            colour=self.colour[balls], lay=None if self.lay is None else self.lay[part],
        )  # fmt: skip

    @property
    def observed(self) -> NDArray[np.bool_]:
        """(T, N) where a ball was seen."""
        return np.isfinite(self.xy[..., 0])

    def as_seen(self, vectors: FloatArray) -> FloatArray:
        """Vectors (T, N, 2) on the table, m, as the picture shows them: there errors are alike in all directions."""
        if self.lay is None:
            return vectors
        return np.asarray(np.linalg.solve(_known(self.lay), vectors[..., None])[..., 0], dtype=np.float64)

    @property
    def whitening(self) -> FloatArray:
        """(T, N, 2, 2): takes residuals in m to standard deviations, along the streak in the picture and across it."""
        streak = self.as_seen(self.streak)
        length = np.linalg.norm(streak, axis=-1, keepdims=True)
        along = np.where(length > 0, streak / np.maximum(length, 1e-12), np.array([1.0, 0.0]))
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        white = np.stack([along / self.sigma_along[..., None], across / self.sigma[..., None]], axis=-2)
        return white if self.lay is None else np.asarray(white @ np.linalg.inv(_known(self.lay)))

    @property
    def sigma_xy(self) -> FloatArray:
        """(T, N, 2) m, one standard deviation of x and of y."""
        spread = np.linalg.inv(_known(self.whitening))
        sigma: FloatArray = np.sqrt((spread**2).sum(axis=-1))
        return np.where(self.observed[..., None], sigma, np.nan)


def _known(matrices: FloatArray) -> FloatArray:
    """Square matrices (..., 2, 2), the identity where one is not known."""
    known = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    return np.where(known, matrices, np.eye(2))
