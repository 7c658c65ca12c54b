"""Solution of the joint fit: its observations, the paths of its segments, and both as arrays for compiled code."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from models.core.contact_graph import (
    SHARED_COUNT,
    ClothFriction,
    ContactGraph,
    ContactKind,
    JointSolution,
    Observations,
    layout_parameters,
)
from models.core.scene import CUSHIONS
from models.core.tracks import Tracks
from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.jit import compile_kernel
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics

# s: every ball rests by then.
LONGEST_MOTION = 100.0


def collect_observations(tracks: Tracks) -> Observations:
    """Collect the observations of all balls.

    Args:
        tracks: Tracks of N balls over T frames.

    Returns:
        K observations, sorted by ball and time.
    """
    frame, ball = np.nonzero(tracks.is_observed)
    order = np.lexsort((frame, ball))
    frame, ball = frame[order], ball[order]
    return Observations(ball.astype(np.int64), tracks.t[frame], tracks.xy[frame, ball], tracks.whitening[frame, ball])


def assign_observations(graph: ContactGraph, observations: Observations) -> IntArray:
    """Assign each observation to a segment by time.

    Args:
        graph: The contact graph.
        observations: K observations.

    Returns:
        (K,) index of the segment.
    """
    starts = np.array([graph.start_time(k) for k in range(len(graph.segments))], np.float64)
    owner: IntArray = assign_sorted_observations(
        np.array([segment.ball for segment in graph.segments], np.int64), starts, observations.ball, observations.t
    )
    return owner


@compile_kernel
def assign_sorted_observations(segment_ball, begin, ball, t):  # type: ignore[no-untyped-def]
    """Assign observations (K,), sorted by ball and time, to segments with balls (S,) and start times (S,) s."""
    owner = np.zeros(len(t), np.int64)
    own = np.empty(len(begin), np.int64)
    row = 0
    while row < len(t):
        count = 0
        for k in range(len(begin)):  # insertion sort of the segments of this ball
            if segment_ball[k] == ball[row]:
                slot = count
                while slot > 0 and begin[own[slot - 1]] > begin[k]:
                    own[slot] = own[slot - 1]
                    slot -= 1
                own[slot] = k
                count += 1
        current, position = ball[row], 0
        while row < len(t) and ball[row] == current:
            while position + 1 < count and begin[own[position + 1]] <= t[row] + 1e-12:
                position += 1
            owner[row] = own[position]
            row += 1
    return owner


def evaluate_residuals(solution: JointSolution, observations: Observations) -> FloatArray:
    """Evaluate the residuals of a solution.

    Args:
        observations: K observations.

    Returns:
        (K, 2) m, measured minus fitted.
    """
    graph = solution.graph
    owner = assign_observations(graph, observations)
    starts = np.array([graph.start_time(k) for k in range(len(graph.segments))])
    states = np.array([segment.state for segment in graph.segments])[owner]
    fitted = evaluate_kinematics(states, observations.t - starts[owner], solution.friction)[:, :2]
    static = np.array([segment.static for segment in graph.segments])[owner]
    return observations.xy - np.where(static[:, None], states[:, :2], fitted)


def evaluate_path(graph: ContactGraph, friction: ClothFriction, k: int, t: FloatArray) -> FloatArray:
    """Evaluate the path of a segment.

    Args:
        graph: The contact graph.
        friction: Friction of the cloth.
        k: Index of the segment.
        t: (M,) s; before its start, the ball is where it starts.

    Returns:
        (M, 6) position, velocity and slip, m and m/s.
    """
    return _evaluate_motion(graph, friction, k, np.maximum(t - graph.start_time(k), 0.0))


def end_state(solution: JointSolution, k: int) -> FloatArray:
    """Return the state (6,) of a segment where it ends: position, velocity and slip, m and m/s."""
    duration = min(solution.graph.end_time(k) - solution.graph.start_time(k), LONGEST_MOTION)
    state: FloatArray = _evaluate_motion(solution.graph, solution.friction, k, np.array([duration]))[0]
    return state


def _evaluate_motion(graph: ContactGraph, friction: ClothFriction, k: int, tau: FloatArray) -> FloatArray:
    """Return position, velocity and slip (M, 6) of a segment at times tau (M,) s since its start."""
    segment = graph.segments[k]
    if segment.static:
        return np.repeat(np.concatenate([segment.state[:2], np.zeros(4)])[None], len(tau), axis=0)
    return evaluate_kinematics(np.repeat(segment.state[None], len(tau), axis=0), tau, friction)


# Kinds of contacts, in the order of `ContactKind`.
STRIKE, BALL, CUSHION, FREE, JUMP, BREAK = range(6)
# First columns of the shared parameters.
SLIDING_COLUMN, ROLLING_COLUMN, DIAMETER_COLUMN, NOSE_COLUMN, RUBBER_COLUMN = 0, 1, 2, 3, 7
NONE = -1
# m by which paths may jump at contacts while the structure is searched: so it gets past wrong contacts.
SEARCH_CONTINUITY = 2e-4


class GraphArrays(NamedTuple):
    """Connections of S segments and C contacts, and the columns of their P parameters."""

    ball: IntArray
    """(S,)"""
    static: BoolArray
    """(S,)"""
    start: IntArray
    """(S,) contact that begins a segment, and `end` (S,) that ends it; NONE if there is none."""
    end: IntArray
    t0: FloatArray
    """(S,) s: start of a segment without a contact there."""
    kind: IntArray
    """(C,)"""
    before: IntArray
    """(C, 2) segments that end at a contact, and `after` (C, 2) that begin; NONE for a missing second ball."""
    after: IntArray
    side: IntArray
    """(C,) cushion index; NONE for other contacts."""
    driven: BoolArray
    """(C,)"""
    pushed: BoolArray
    """(C,)"""
    leaves: FloatArray
    """(C, 6) states in which balls leave breaks; `whiten` (C, 6, 6) takes deviations to standard deviations."""
    whiten: FloatArray
    continuity_sigma: float
    """m by which paths may jump at contacts."""
    column: IntArray
    """(S,) first parameter of a segment."""
    first_contact: int
    first_shared: int
    size: int


class FitParameters(NamedTuple):
    """Parameters of the joint fit."""

    state: FloatArray
    """(S, 8) at the starts of segments."""
    t: FloatArray
    """(C,) s, times of contacts."""
    shared: FloatArray
    """(10,) friction of sliding and rolling, diameter, four noses, three of the rubber."""


def build_graph_arrays(graph: ContactGraph, continuity_sigma: float = SEARCH_CONTINUITY) -> GraphArrays:
    """Build the arrays that a refinement of a contact graph keeps fixed.

    Args:
        graph: The contact graph, of S segments and C contacts.
        continuity_sigma: m by which paths may jump at contacts.

    Returns:
        The arrays.
    """
    segments, contacts, layout = graph.segments, graph.contacts, layout_parameters(graph)
    kinds = get_args(ContactKind)
    return GraphArrays(
        np.array([segment.ball for segment in segments], np.int64),
        np.array([segment.static for segment in segments], np.bool_),
        _index_array([segment.start for segment in segments]),
        _index_array([segment.end for segment in segments]),
        np.array([segment.t0 for segment in segments], np.float64),
        np.array([kinds.index(c.kind) for c in contacts], np.int64),
        _pair_array([c.before for c in contacts]),
        _pair_array([c.after for c in contacts]),
        np.array([CUSHIONS.index(c.cushion) if c.kind == "cushion" else NONE for c in contacts], np.int64),
        np.array([c.driven for c in contacts], np.bool_),
        np.array([c.pushed for c in contacts], np.bool_),
        np.array([c.exit_state for c in contacts]).reshape(-1, 6),
        np.array([c.exit_whitening for c in contacts]).reshape(-1, 6, 6),
        continuity_sigma,
        layout.segment.astype(np.int64),
        layout.contact,
        layout.shared,
        layout.size,
    )


def extract_parameters(solution: JointSolution, graph: ContactGraph) -> FitParameters:
    """Extract the initial parameters: states and times of `graph`, shared ones of the solution."""
    friction = solution.friction
    cloth = np.array([friction.sliding, friction.rolling, solution.diameter_factor])
    states = [segment.state for segment in graph.segments]
    return FitParameters(
        np.array(states, np.float64).reshape(-1, 8), np.array([c.t for c in graph.contacts], np.float64),
        np.concatenate([cloth, solution.nose_offsets, solution.rubber]),
    )  # fmt: skip


def apply_parameters(solution: JointSolution, graph: ContactGraph, parameters: FitParameters) -> JointSolution:
    """Make a solution of `graph` with other parameters; its chi2 and covariance are those of the old one."""
    segments = tuple(
        replace(segment, state=state) for segment, state in zip(graph.segments, parameters.state, strict=True)
    )
    contacts = tuple(replace(c, t=t) for c, t in zip(graph.contacts, parameters.t.tolist(), strict=True))
    shared = parameters.shared
    return replace(
        solution,
        graph=ContactGraph(segments, contacts),
        friction=ClothFriction(float(shared[SLIDING_COLUMN]), float(shared[ROLLING_COLUMN])),
        diameter_factor=float(shared[DIAMETER_COLUMN]),
        nose_offsets=shared[NOSE_COLUMN:RUBBER_COLUMN].copy(),
        rubber=shared[RUBBER_COLUMN:SHARED_COUNT].copy(),
    )


@compile_kernel
def start_times(arrays, t):  # type: ignore[no-untyped-def]
    """Return the start times (S,) s of segments if contacts happen at t (C,)."""
    times = arrays.t0.copy()
    for k in range(len(times)):
        if arrays.start[k] != NONE:
            times[k] = t[arrays.start[k]]
    return times


@compile_kernel
def end_times(arrays, t):  # type: ignore[no-untyped-def]
    """Return the end times (S,) s of segments; infinite where they run to the end of the track."""
    times = np.full(len(arrays.t0), np.inf)
    for k in range(len(times)):
        if arrays.end[k] != NONE:
            times[k] = t[arrays.end[k]]
    return times


def _index_array(indices: list[int | None]) -> IntArray:
    return np.array([NONE if index is None else index for index in indices], np.int64)


def _pair_array(groups: list[tuple[int, ...]]) -> IntArray:
    """Return segment indices (C, 2) of one or two balls."""
    return np.array([(*group, NONE)[:2] for group in groups], np.int64).reshape(-1, 2)
