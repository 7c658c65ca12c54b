"""Solution of the joint fit: a contact graph with states, contact times and coefficients, and its observations."""

from __future__ import annotations

import numpy as np

from models.core.contact_graph import ContactGraph, JointSolution, Observations
from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
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


def end_state(solution: JointSolution, k: int) -> FloatArray:
    """Return the state of a segment where it ends.

    Args:
        k: Index of the segment.

    Returns:
        (6,) position, velocity and slip, m and m/s.
    """
    segment = solution.graph.segments[k]
    if segment.static:
        return np.concatenate([segment.state[:2], np.zeros(4)])
    tau = np.array([min(solution.graph.end_time(k) - solution.graph.start_time(k), LONGEST_MOTION)])
    state: FloatArray = evaluate_kinematics(segment.state[None], tau, solution.friction)[0]
    return state
