"""Segments of a recording between strikes, and the multiple-shooting window of a segment."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.multiple_shooting.shooting_windows import Window
from models.physics.billiards.simulation.parametrised_shot import pack_start

# m/s: prior standard deviation of a velocity.
VELOCITY_SIGMA = 5.0
# Prior standard deviation of a slip: this share of the speed, plus `SPIN_SIGMA_AT_REST`.
SLIP_SIGMA = 0.7
# Prior standard deviation of R wz: this share of the speed, plus `SPIN_SIGMA_AT_REST`; a cue hit at R/2 from the centre
# gives 5/4.
SIDE_SPIN_SIGMA = 0.6
# m/s
SPIN_SIGMA_AT_REST = 0.1
# m/s by which slip and side spin at the start of a segment may differ from the end of the previous one.
HANDOVER_SIGMA = 0.02
# Expected slip as a share of the velocity.
EXPECTED_SLIP = 0.3
# Initial guesses of slip and R wz over the speed. Without slip or spin, the derivative by them vanishes and a search
# makes no progress.
SPIN_GUESSES = ((0.3, 0.4), (0.3, -0.4), (0.9, 0.4), (-0.3, -0.4))


@dataclass(frozen=True, slots=True)
class ShotSegment:
    """Observations of all N balls from `begin` on, at T times."""

    shot: int
    """Index of the shot."""
    begin: float
    """s, at most t[0]."""
    t: FloatArray
    """(T,) s."""
    xy: FloatArray
    """(T, N, 2) m; NaN where a ball was not observed."""
    whitening: FloatArray
    """(T, N, 2, 2): converts residuals in m into standard deviations."""
    start: FloatArray
    """(N, 7) initial guess of the state of every ball, as in `parametrised_shot`."""
    moving: BoolArray
    """(N,) whether a ball moves at `begin`."""
    continues_previous: bool = False
    """Whether slip and side spin continue from the previous segment."""
    image_row: FloatArray | None = None
    """(T, N) image row of a ball relative to the image centre, in image heights; None without an image."""
    dropped_frame_delay: FloatArray | None = None
    """(T,) s by which one dropped frame would shift each time; None where none is suspected."""

    windows: dict[bool, Window] = field(default_factory=dict, init=False, repr=False, compare=False)
    """Windows that were built of it, by `guess_spins`: every hypothesis is fitted to the same."""
    observation_indices: tuple[IntArray, IntArray] = field(init=False, repr=False)
    """(K,) row and (K,) ball of each observation."""
    observations: FloatArray = field(init=False, repr=False)
    """(K, 2) m, observed positions."""
    observation_whitening: FloatArray = field(init=False, repr=False)
    """(K, 2, 2) `whitening` of each observation."""

    def __post_init__(self) -> None:
        rows, balls = np.nonzero(np.isfinite(self.xy[..., 0]))
        object.__setattr__(self, "observation_indices", (rows.astype(np.int64), balls.astype(np.int64)))
        object.__setattr__(self, "observations", self.xy[rows, balls])
        object.__setattr__(self, "observation_whitening", self.whitening[rows, balls])

    def truncate(self, t: float) -> ShotSegment:
        """Keep the observations up to a time."""
        before = self.t <= t
        row, late = (None if shift is None else shift[before] for shift in (self.image_row, self.dropped_frame_delay))
        return replace(
            self,
            t=self.t[before],
            xy=self.xy[before],
            whitening=self.whitening[before],
            image_row=row,
            dropped_frame_delay=late,
        )


def build_window(segment: ShotSegment, guess_spins: bool) -> Window:
    """Build the multiple-shooting window of a segment: observations, initial guess and prior.

    Args:
        segment: Segment with its initial states.
        guess_spins: Whether slips and spins are unknown, so that several initial guesses are tried.

    Returns:
        The window.
    """
    if guess_spins not in segment.windows:
        segment.windows[guess_spins] = _build_new_window(segment, guess_spins)
    return segment.windows[guess_spins]


def _build_new_window(segment: ShotSegment, guess_spins: bool) -> Window:
    """Build what `build_window` returns."""
    rows, balls = segment.observation_indices
    start = pack_start(segment.start, segment.moving)
    speed = np.hypot(segment.start[:, 2], segment.start[:, 3])
    sigma = np.full(segment.start.shape, np.inf)
    sigma[~np.isfinite(segment.xy[..., 0]).any(axis=0), :2] = 1.0  # never observed: it stays away
    sigma[:, 2:4] = VELOCITY_SIGMA
    sigma[:, 4:6] = (SLIP_SIGMA * speed + SPIN_SIGMA_AT_REST)[:, None]
    sigma[:, 6] = SIDE_SPIN_SIGMA * speed + SPIN_SIGMA_AT_REST
    link = np.full(segment.start.shape, np.inf)
    link[:, 4:] = HANDOVER_SIGMA
    tied = pack_start(link, segment.moving) if segment.continues_previous else None
    first = pack_start(_replace_spins(segment.start, EXPECTED_SLIP, 0.0), segment.moving) if guess_spins else start
    others = tuple(
        pack_start(_replace_spins(segment.start, *guess), segment.moving) for guess in SPIN_GUESSES if guess_spins
    )
    state_sigma = pack_start(sigma, segment.moving)
    return Window(
        segment.shot, segment.t[rows], balls, first, state_sigma, tied, () if segment.continues_previous else others
    )


def _replace_spins(start: FloatArray, slip: float, side: float) -> FloatArray:
    """Set slips to a share of the velocities and side spins to a share of the speeds, in states (N, 7)."""
    states = start.copy()
    states[:, 4:6] = slip * start[:, 2:4]
    states[:, 6] = side * np.hypot(start[:, 2], start[:, 3])
    return states
