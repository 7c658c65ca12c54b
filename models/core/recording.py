"""What was observed of any motion: times, bodies, coordinates with their sigma, known inputs and frame of reference."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class ReferenceFrame:
    """Frame of reference of D coordinates."""

    coordinates: tuple[str, ...]
    """(D,) their names."""
    unit: str
    """Unit of every coordinate: m or rad; empty where it is not known."""
    place: str
    """What they are measured in: `on the table`."""

    def __str__(self) -> str:
        unit = f" ({self.unit})" if self.unit else ""
        return f"{', '.join(self.coordinates)}{unit} {self.place}"


@dataclass(frozen=True, slots=True)
class Recording:
    """Observations of one shot, or of a part of it: T rows in time, N bodies, D coordinates."""

    shot: int
    """Index of the shot."""
    frame: IntArray
    """(T,) frame numbers, increasing."""
    t: FloatArray
    """(T,) s, increasing."""
    bodies: tuple[str, ...]
    """N names, the same in every part of a shot."""
    positions: FloatArray
    """(T, N, D) in the unit of the frame of reference; NaN where a body was not observed."""
    sigma: FloatArray
    """(T, N) standard deviation of each coordinate; NaN where it is not known."""
    reference: ReferenceFrame
    """Frame of reference of the positions."""
    is_sigma_stated: bool = True
    """Whether the standard deviations were stated with the recording; otherwise they are a usual value or NaN."""
    inputs: FloatArray | None = None
    """(T, N, I, 2) value and rate (per s) of the known inputs of each body, in the order of the scene; cubics between
    rows. None: all are 0."""

    def __post_init__(self) -> None:
        shape = (len(self.t), len(self.bodies), len(self.reference.coordinates))
        if self.positions.shape != shape:
            raise ValueError(f"Recording.positions must be {shape}; got {self.positions.shape}")
        if self.frame.shape != shape[:1] or self.sigma.shape != shape[:2]:
            raise ValueError("Recording needs one frame number per row, and one sigma per row and body")
        if self.inputs is not None and (self.inputs.shape[:2] != shape[:2] or self.inputs.shape[3:] != (2,)):
            raise ValueError("Recording.inputs need a value and a rate per row and body")
        if len(set(self.bodies)) != len(self.bodies):
            raise ValueError("Recording needs one unique name per body")
        if not (np.all(np.diff(self.t) > 0) and np.all(np.diff(self.frame) > 0)):
            raise ValueError("Recording must go forward in frame and time")
        if np.any(self.sigma <= 0):
            raise ValueError("Recording.sigma must be positive")

    @property
    def is_observed(self) -> BoolArray:
        """(T, N) whether a body was observed, in all its coordinates."""
        return np.asarray(np.isfinite(self.positions).all(axis=2))

    def require_samples(self, least: int) -> None:
        """Raise a ValueError where there is no body, or one was observed less than `least` times."""
        fewest = min(self.is_observed.sum(axis=0).tolist(), default=0)
        if fewest < least:
            raise ValueError(f"every body must be observed at least {least} times; one is observed {fewest} times")

    def select_rows(self, first: int, last: int, step: int = 1) -> Recording:
        """Select every `step`-th row from `first` up to, but excluding, `last`."""
        part = slice(first, last, step)
        return replace(
            self, frame=self.frame[part], t=self.t[part], positions=self.positions[part], sigma=self.sigma[part],
            inputs=None if self.inputs is None else self.inputs[part],
        )  # fmt: skip

    def select_body(self, body: int) -> Recording:
        """Select one body, with the inputs that act on it."""
        part = slice(body, body + 1)
        return replace(
            self, bodies=self.bodies[part], positions=self.positions[:, part], sigma=self.sigma[:, part],
            inputs=None if self.inputs is None else self.inputs[:, part],
        )  # fmt: skip


def record_points(t: FloatArray, positions: FloatArray, names: tuple[str, ...] = (), shot: int = 0) -> Recording:
    """Record points whose unit and errors are not known.

    Args:
        t: (T,) s, increasing.
        positions: (T, N, D) x, y and perhaps z; NaN where a point was not observed.
        names: Of the points; by default their numbers.
        shot: Index of the shot.

    Returns:
        The recording, with errors of NaN.
    """
    count, axes = positions.shape[1:]
    return Recording(
        shot, np.arange(len(t)), t, names or tuple(str(k) for k in range(count)), positions,
        np.full(positions.shape[:2], np.nan), ReferenceFrame(("x", "y", "z")[:axes], "", "of points"), False,
    )  # fmt: skip
