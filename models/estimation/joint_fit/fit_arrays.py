"""Contact graph and parameters as arrays, for compiled code."""

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
    layout_parameters,
)
from models.core.scene import CUSHIONS
from models.core.typing import BoolArray, FloatArray, IntArray
from models.numerics.jit import compile_kernel

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
