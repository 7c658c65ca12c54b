"""Solution of a joint fit: a contact graph with states, contact times and coefficients, with their covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.contact_graph import ContactGraph
from models.core.typing import BoolArray, FloatArray, IntArray

# Numbers at the start of a segment, see `models.physics.billiards.cloth.closed_form_motion`.
SEGMENT_STATE_SIZE = 8


@dataclass(frozen=True, slots=True)
class ClothFriction:
    """Coefficients of friction of the cloth; decelerations are mu g."""

    sliding: float
    rolling: float


@dataclass(frozen=True, slots=True)
class Observations:
    """Observed places, one row per observation, sorted by ball and time."""

    ball: IntArray
    t: FloatArray
    xy: FloatArray
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""

    @property
    def frame_interval(self) -> float:
        """Median time between two frames, s."""
        return float(np.median(np.diff(np.unique(self.t))))

    def select_rows(self, rows: BoolArray) -> Observations:
        """Return the observations of a mask (K,)."""
        return Observations(self.ball[rows], self.t[rows], self.xy[rows], self.whiten[rows])


@dataclass(frozen=True, slots=True)
class JointSolution:
    """A refined contact graph."""

    graph: ContactGraph
    friction: ClothFriction
    diameter_factor: float
    """Factor on two radii."""
    nose_offsets: FloatArray
    """(4,) m, distance of the contact line from one radius inside each nose; > 0 towards the table."""
    rubber: FloatArray
    """(3,) of all cushions: restitution of a slow ball, its change with speed in s/m, and grip: how far the nose stops
    the spin about the line of the cushion, 0 not at all, 1 until it does not slip.
    """
    chi2: float
    """Robust, with pseudo-observations."""
    covariance: FloatArray
    """(P, P) of the packed parameters, see `ParameterLayout`; empty until `joint_refinement.add_covariance` adds it."""


@dataclass(frozen=True, slots=True)
class ParameterLayout:
    """Columns of the packed parameters."""

    segment: IntArray
    """(S,) first column; a static segment has two parameters, a moving one eight."""
    contact: int
    """Column of the time of the first contact."""
    shared: int
    """First column of ln mu_sliding, ln mu_rolling, diameter, four noses, three of the rubber."""
    size: int


# Parameters that all segments and contacts share.
SHARED_COUNT = 10


def layout_parameters(graph: ContactGraph) -> ParameterLayout:
    """Lay out the packed parameters of a contact graph.

    Args:
        graph: The contact graph.

    Returns:
        Columns of its parameters.
    """
    sizes = np.array([2 if segment.static else SEGMENT_STATE_SIZE for segment in graph.segments], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    contact = int(starts[-1])
    return ParameterLayout(
        starts[:-1], contact, contact + len(graph.contacts), contact + len(graph.contacts) + SHARED_COUNT
    )
