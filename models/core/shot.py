"""Explanation of a billiards recording as one value; events, trajectory, parameters and trust level are views of it.

`models.estimation.reconstruction.explain_shot` makes a shot, and `shot_views` in the same folder evaluates its views.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from models.core.answer import format_html
from models.core.contact_graph import JointSolution, Observations
from models.core.corrections import NO_CORRECTIONS, Corrections
from models.core.fit_result import MarkOutcome
from models.core.naming import Naming, build_naming
from models.core.scene import Scene
from models.core.tracks import Tracks
from models.core.trajectory import CaptureClock, Trajectory
from models.core.typing import BoolArray, FloatArray

# `fit_failed`: the equations of the fit have no solution, with the error; `no_ball`: no ball was detected;
# `incomplete_clip`: a part of the clip is missing, with what; `implausible_deceleration`: balls roll as on no table,
# with the deceleration, m/s^2.
NoteCode = Literal["fit_failed", "no_ball", "incomplete_clip", "implausible_deceleration"]


@dataclass(frozen=True, slots=True)
class Note:
    """A remark on a shot."""

    code: NoteCode
    detail: str = ""


@dataclass(frozen=True, slots=True)
class RivalContact:
    """A contact of two balls that may have happened instead."""

    ball: int
    other: int
    cost: float
    """chi2 beyond that of the best explanation, of the segments that differ; negative where the rival fits better."""


@dataclass(frozen=True, slots=True)
class ContactRivals:
    """What may have happened instead of one contact of the graph: weighted hypotheses, whose weights are costs."""

    rivals: tuple[RivalContact, ...]
    """The best first."""
    separation_cost: float
    """chi2 by which two separate velocity changes differ from a contact of two balls, at most 0; 0 for others."""


@dataclass(frozen=True, slots=True)
class ContactTestResult:
    """Result of the contact test at one moment."""

    probability: float
    """Of a contact of the bodies."""
    t: float
    """s: of the contact; of the nearest approach if that is more probable."""
    t_sigma: float
    gap: float
    """m: least distance of the surfaces on free paths, negative where they would overlap, whichever hypothesis is more
    probable.
    """
    gap_sigma: float
    chi2: float
    """Per degree of freedom, of the more probable hypothesis, against the stated errors of the samples."""
    correlation: float
    """Of errors of successive samples."""
    closing: float
    """m/s along the normal at contact; 0 if they did not touch."""


@dataclass(frozen=True, slots=True)
class ClosePass:
    """Two balls that pass each other so closely that they may have touched."""

    one: int
    other: int
    """Their indices in the tracks."""
    result: ContactTestResult


@dataclass(frozen=True, slots=True)
class BreakContact:
    """A contact of two balls in a break."""

    t: float
    t_sigma: float
    """s, capture time."""
    a: int
    b: int
    """The faster ball, and the other: their indices in the tracks."""
    xy: FloatArray
    """(2,) m, place of ball a."""
    speed: float
    """m/s of closing."""
    probability: float


@dataclass(frozen=True, slots=True)
class BreakExit:
    """A ball in a break, from its first contact to its last one."""

    ball: int
    """Its index in the tracks."""
    start: float
    end: float
    """s, capture times of its first and last contact."""
    state: FloatArray
    """(6,) place, velocity and slip after its last contact, m and m/s."""
    covariance: FloatArray
    """(6, 6) of the state."""
    arrival: FloatArray
    """(2,) m, place at its first contact, and `arrival_covariance` (2, 2) of that."""
    arrival_covariance: FloatArray


@dataclass(frozen=True, slots=True)
class SimulatedBreak:
    """The simulation that explains a break best, with the spread of the others that explain it."""

    balls: tuple[int, ...]
    """Indices in the tracks of the balls of `motion`; the first is the incoming one."""
    start: float
    """s, capture time at which `motion` begins."""
    hit: float
    """s, approximate time at which the incoming ball meets the others."""
    interval: float
    """s between two frames."""
    contacts: tuple[BreakContact, ...]
    exits: tuple[BreakExit, ...]
    motion: Trajectory
    """Motion of the balls; its times count from `start`."""


def select_outside_breaks(observations: Observations, breaks: tuple[SimulatedBreak, ...]) -> Observations:
    """Select the observations outside the first and last contact of each ball in a break.

    Args:
        observations: Observations at capture times.

    Returns:
        Those that the contact graph has to explain.
    """
    ball, t = observations.ball, observations.t
    is_outside = np.ones(len(t), np.bool_)
    for ball_exit in (leaving for one in breaks for leaving in one.exits):
        is_outside &= ~((ball == ball_exit.ball) & (t > ball_exit.start) & (t <= ball_exit.end))
    return observations.select_rows(is_outside)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Shot:
    """Explanation of the recording of N balls over T frames, with S segments and C contacts.

    Times are capture times, except those of `tracks`. Shots are equal only to themselves, so that a shot can be the key
    of its views.
    """

    scene: Scene
    """Table, camera and balls."""
    tracks: Tracks
    """The recording, at presentation times."""
    clock: CaptureClock
    """Presentation and capture times of the frames."""
    whitening: FloatArray
    """(T, N, 2, 2) takes the residual of a position, m, to standard deviations; NaN where a position was not used."""
    solution: JointSolution | None
    """Contact graph with states, contact times and coefficients, and their covariance; None where no physics could be
    fitted."""
    breaks: tuple[SimulatedBreak, ...] = ()
    """Break shots that a simulation explains."""
    hypotheses: tuple[ContactRivals, ...] = ()
    """(C,) what may have happened instead of each contact."""
    gaps: FloatArray = field(default_factory=lambda: np.empty((0, 2)))
    """(C, 2) m, least distance of the surfaces of two balls on free paths by the contact test that times their contact,
    and its sigma; NaN for other contacts, whose gap follows from the solution."""
    passes: tuple[ClosePass, ...] = ()
    """Passes that may have been contacts."""
    corrections: Corrections = NO_CORRECTIONS
    """What a person corrected."""
    outcomes: tuple[MarkOutcome, ...] = ()
    """What the motion says about the contacts that a person marked."""
    notes: tuple[Note, ...] = ()
    moving_speed: float = 0.02
    """m/s above which a ball counts as moving."""

    def __post_init__(self) -> None:
        frames, balls = self.tracks.xy.shape[:2]
        if self.whitening.shape != (frames, balls, 2, 2):
            raise ValueError(f"Shot.whitening must be {(frames, balls, 2, 2)}; got {self.whitening.shape}")
        contacts = 0 if self.solution is None else len(self.solution.graph.contacts)
        if len(self.hypotheses) != contacts or self.gaps.shape != (contacts, 2):
            raise ValueError(f"Shot.hypotheses and gaps must have one entry for each of {contacts} contacts")

    def __repr__(self) -> str:
        contacts = "no physics" if self.solution is None else f"{len(self.solution.graph.contacts)} contacts"
        return f"Shot({self.scene.table.name}, {contacts}, {self.tracks!r})"

    def _repr_html_(self) -> str:
        """Show the balls in a notebook."""
        return format_html([repr(self)]) + self.tracks._repr_html_()

    @property
    def naming(self) -> Naming:
        """What balls, rails and pockets are called."""
        return build_naming(self.scene.table, self.scene.camera, self.tracks.ids, self.tracks.looks)

    @property
    def capture_tracks(self) -> Tracks:
        """The recording at its capture times."""
        return replace(self.tracks, t=self.clock.capture_time)

    @property
    def is_used(self) -> BoolArray:
        """(T, N) whether a position was used in the fit."""
        return np.asarray(np.isfinite(self.whitening).all(axis=(2, 3)))

    @property
    def fitted_tracks(self) -> Tracks:
        """The positions that were used in the fit, at their capture times."""
        return replace(self.capture_tracks, xy=np.where(self.is_used[..., None], self.tracks.xy, np.nan))

    @property
    def observations(self) -> Observations:
        """The positions that were used in the fit, sorted by ball and time; those within breaks are left out."""
        ball, frame = np.nonzero(self.is_used.T)
        t = self.clock.capture_time[frame]
        rows = Observations(ball, t, self.tracks.xy[frame, ball], self.whitening[frame, ball])
        return select_outside_breaks(rows, self.breaks)
