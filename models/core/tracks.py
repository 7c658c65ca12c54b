"""Tracks: positions of identified balls over time."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.core.answer import format_html
from models.core.ball_look import BallLook, describe_unseen_balls
from models.core.recording import Recording, ReferenceFrame
from models.core.typing import FloatArray

# See `models.core.scene.Table` for the axes.
TABLE_PLANE = ReferenceFrame(("x", "y"), "m", "on the table")
# Ball classes. `cue` is the cue ball of pool and snooker; `white` and `yellow` are the cue balls of carom.
KINDS = ("cue", "solid", "stripe", "eight", "red", "yellow", "white", "green", "brown", "blue", "pink", "black", "ball")


@dataclass(frozen=True, slots=True, repr=False)
class Tracks:
    """Tracks of N balls over T frames, without duplicate frames; NaN where a ball was not observed.

    Positions are those of the centre of the ball, in the plane one ball radius above the cloth (see `Table` for the
    coordinates).
    """

    frame: NDArray[np.int64]
    """(T,) index of the frame in presentation order, strictly increasing."""
    t: FloatArray
    """(T,) s, presentation time, taken as the middle of the exposure; strictly increasing."""
    ids: tuple[str, ...]
    """(N,) unique ids, e.g. `cue`, `red`, `solid-2`."""
    kinds: tuple[str, ...]
    """(N,) ball class, one of `KINDS`."""
    xy: FloatArray
    """(T, N, 2) m, position on the table."""
    px: FloatArray
    """(T, N, 2) px, position in the original frame."""
    sigma: FloatArray
    """(T, N) m, standard deviation of the position across the streak."""
    sigma_along: FloatArray
    """(T, N) m, standard deviation of the position along the streak; equals `sigma` for sharp balls."""
    streak: FloatArray
    """(T, N, 2) m, displacement during the exposure, with unknown sign; (0, 0) for sharp balls."""
    radius_px: FloatArray
    """(T, N) px, radius of the ball in the image."""
    colour: FloatArray
    """(N, 3) CIE L*a*b*, mean colour of the ball."""
    image_jacobian: FloatArray | None = None
    """(T, N, 2, 2) Jacobian of table position by pixel, divided by its root mean square per axis. In an oblique view,
    errors that are isotropic in the image are anisotropic on the table. `sigma` and `sigma_along` are errors in px
    times that root mean square in m/px. None: errors are isotropic on the table."""
    looks: tuple[BallLook, ...] = ()
    """(N,) how the balls look, and what a person calls them; by id and class where nothing else is given."""

    def __post_init__(self) -> None:
        frames, balls = len(self.frame), len(self.ids)
        if len(set(self.ids)) != balls or len(self.kinds) != balls:
            raise ValueError("Tracks needs one unique id and one kind per ball")
        if not self.looks:
            object.__setattr__(self, "looks", describe_unseen_balls(self.ids, self.kinds))
        if len(self.looks) != balls:
            raise ValueError(f"Tracks needs one look per ball; got {len(self.looks)} for {balls}")
        for name, shape in (
            ("t", (frames,)), ("xy", (frames, balls, 2)), ("px", (frames, balls, 2)), ("streak", (frames, balls, 2)),
            ("sigma", (frames, balls)), ("sigma_along", (frames, balls)), ("radius_px", (frames, balls)),
            ("colour", (balls, 3)),
        ):  # fmt: skip
            if getattr(self, name).shape != shape:
                raise ValueError(f"Tracks.{name} must be {shape}; got {getattr(self, name).shape}")
        if self.image_jacobian is not None and self.image_jacobian.shape != (frames, balls, 2, 2):
            raise ValueError(f"Tracks.image_jacobian must be {(frames, balls, 2, 2)}; got {self.image_jacobian.shape}")
        if frames > 1 and (np.any(np.diff(self.frame) <= 0) or np.any(np.diff(self.t) <= 0)):
            raise ValueError("Tracks must go forward in frame and time")

    def __repr__(self) -> str:
        span = f", {self.t[0]:.2f} to {self.t[-1]:.2f} s" if len(self.t) else ""
        return f"Tracks({len(self.frame)} frames{span}: {', '.join(look.name for look in self.looks)})"

    def _repr_html_(self) -> str:
        """Show the balls in a notebook."""
        shares = (f"{share:.0%}" for share in self.is_observed.mean(axis=0))
        rows = zip((look.name for look in self.looks), self.ids, self.kinds, shares, strict=True)
        return format_html([repr(self)], [("ball", "id", "class", "frames that show it"), *rows])

    def truncate_after(self, t: float) -> Tracks:
        """Return the tracks up to time t (s): earlier frames, and the balls observed in them."""
        rows = self.t <= t + 1e-9
        balls = np.flatnonzero(self.is_observed[rows].any(axis=0))
        part = np.ix_(rows, balls)
        return replace(
            self, frame=self.frame[rows], t=self.t[rows], ids=tuple(self.ids[k] for k in balls),
            kinds=tuple(self.kinds[k] for k in balls), xy=self.xy[part], px=self.px[part], sigma=self.sigma[part],
            sigma_along=self.sigma_along[part], streak=self.streak[part], radius_px=self.radius_px[part],
            colour=self.colour[balls],
            image_jacobian=None if self.image_jacobian is None else self.image_jacobian[part],
            looks=tuple(self.looks[k] for k in balls),
        )  # fmt: skip

    def frame_at(self, t: FloatArray) -> FloatArray:
        """Return fractional frame numbers (E,) at times t (E,) s, also a little outside the clip."""
        if len(self.t) < 2:
            return np.zeros_like(t)
        row = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 2)
        share = (t - self.t[row]) / (self.t[row + 1] - self.t[row])
        return np.asarray(self.frame[row] + share * (self.frame[row + 1] - self.frame[row]), np.float64)

    @property
    def is_observed(self) -> NDArray[np.bool_]:
        """(T, N) whether a ball was observed in a frame."""
        return np.isfinite(self.xy[..., 0])

    def map_to_image(self, vectors: FloatArray) -> FloatArray:
        """Map vectors (T, N, 2) on the table to the orientation of the image, where errors are isotropic.

        The scale is kept: the result is in m.
        """
        if self.image_jacobian is None:
            return vectors
        return np.asarray(
            np.linalg.solve(_replace_unknown(self.image_jacobian), vectors[..., None])[..., 0], dtype=np.float64
        )

    @property
    def whitening(self) -> FloatArray:
        """Whitening matrices (T, N, 2, 2): residuals in m to standard deviations, along the streak and across it."""
        streak = self.map_to_image(self.streak)
        length = np.linalg.norm(streak, axis=-1, keepdims=True)
        along = np.where(length > 0, streak / np.maximum(length, 1e-12), np.array([1.0, 0.0]))
        across = np.stack([-along[..., 1], along[..., 0]], axis=-1)
        white = np.stack([along / self.sigma_along[..., None], across / self.sigma[..., None]], axis=-2)
        return (
            white
            if self.image_jacobian is None
            else np.asarray(white @ np.linalg.inv(_replace_unknown(self.image_jacobian)))
        )

    @property
    def sigma_xy(self) -> FloatArray:
        """Standard deviations (T, N, 2) of x and y, m; NaN where a ball was not observed."""
        spread = np.linalg.inv(_replace_unknown(self.whitening))
        sigma: FloatArray = np.sqrt((spread**2).sum(axis=-1))
        return np.where(self.is_observed[..., None], sigma, np.nan)

    def record_positions(self, shot: int = 0) -> Recording:
        """Return the positions on the table as a recording, without frames and balls that have none.

        Its sigmas are the root mean square of those of x and y.

        Args:
            shot: Index of the shot.
        """
        rows, balls = (np.flatnonzero(self.is_observed.any(axis=axis)) for axis in (1, 0))
        part = np.ix_(rows, balls)
        sigma: FloatArray = np.sqrt((self.sigma_xy**2).mean(axis=-1))
        bodies = tuple(self.ids[k] for k in balls)
        return Recording(shot, self.frame[rows], self.t[rows], bodies, self.xy[part], sigma[part], TABLE_PLANE)


def _replace_unknown(matrices: FloatArray) -> FloatArray:
    """Replace matrices (..., 2, 2) that are not finite by the identity."""
    is_finite = np.isfinite(matrices).all(axis=(-2, -1), keepdims=True)
    return np.where(is_finite, matrices, np.eye(2))
