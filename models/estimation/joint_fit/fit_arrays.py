"""A story as arrays, for compiled code: what a refinement leaves as it is, and the numbers that it seeks."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple, get_args

import numpy as np

from models.core.scene import CUSHIONS
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import SHARED, Solution, layout
from models.estimation.segmentation.contact_graph import ContactKind, Story
from models.numerics.jit import compiled
from models.physics.billiards.cloth.closed_form_motion import Friction

STRIKE, BALL, CUSHION, FREE, JUMP, BURST = range(6)
"""Kinds of contacts, in the order of `ContactKind`."""
SLIDING, ROLLING, DIAMETER, NOSE, RUBBER = 0, 1, 2, 3, 7
"""Where the numbers that all spans share begin."""
NONE = -1


class Skeleton(NamedTuple):
    """Of S spans and C contacts: which joins which, and where their P numbers stand among those sought."""

    ball: IntArray
    """(S,)"""
    static: BoolArray
    """(S,)"""
    start: IntArray
    """(S,) contact that begins a span, and `end` (S,) that ends it; NONE where there is none."""
    end: IntArray
    t0: FloatArray
    """(S,) s: where a span without a start begins."""
    kind: IntArray
    """(C,)"""
    before: IntArray
    """(C, 2) spans that end at a contact, and `after` (C, 2) that begin; NONE for a second ball that is not there."""
    after: IntArray
    side: IntArray
    """(C,) which cushion; NONE for other contacts."""
    driven: BoolArray
    """(C,)"""
    pushed: BoolArray
    """(C,)"""
    leaves: FloatArray
    """(C, 6) states in which balls leave bursts; `whiten` (C, 6, 6) takes what is off to standard deviations."""
    whiten: FloatArray
    column: IntArray
    """(S,) first number of a span."""
    first_contact: int
    first_shared: int
    size: int


class Numbers(NamedTuple):
    """What is sought."""

    state: FloatArray
    """(S, 8) at the starts of spans."""
    t: FloatArray
    """(C,) s of contacts."""
    shared: FloatArray
    """(10,) friction of sliding and rolling, diameter, four noses, three of the rubber."""


def skeleton_of(story: Story) -> Skeleton:
    """What a refinement of this story leaves as it is."""
    spans, contacts, plan = story.spans, story.contacts, layout(story)
    kinds = get_args(ContactKind)
    return Skeleton(
        np.array([span.ball for span in spans], np.int64), np.array([span.static for span in spans], np.bool_),
        _numbered([span.start for span in spans]), _numbered([span.end for span in spans]),
        np.array([span.t0 for span in spans], np.float64), np.array([kinds.index(c.kind) for c in contacts], np.int64),
        _paired([c.before for c in contacts]), _paired([c.after for c in contacts]),
        np.array([CUSHIONS.index(c.cushion) if c.kind == "cushion" else NONE for c in contacts], np.int64),
        np.array([c.driven for c in contacts], np.bool_), np.array([c.pushed for c in contacts], np.bool_),
        np.array([c.leaves for c in contacts]).reshape(-1, 6), np.array([c.whiten for c in contacts]).reshape(-1, 6, 6),
        plan.span.astype(np.int64), plan.contact, plan.globals, plan.size,
    )  # fmt: skip


def numbers_of(solution: Solution, story: Story) -> Numbers:
    """Where a refinement of `story` begins: its own states and times, what spans share as in the solution."""
    friction = solution.friction
    cloth = np.array([friction.sliding, friction.rolling, solution.diameter])
    states = [span.state for span in story.spans]
    return Numbers(
        np.array(states, np.float64).reshape(-1, 8), np.array([c.t for c in story.contacts], np.float64),
        np.concatenate([cloth, solution.nose, solution.rubber]),
    )  # fmt: skip


def solution_with(solution: Solution, story: Story, numbers: Numbers) -> Solution:
    """A solution of `story` with other numbers; its chi2 and covariance are those of the old one."""
    spans = tuple(replace(span, state=state) for span, state in zip(story.spans, numbers.state, strict=True))
    contacts = tuple(replace(c, t=t) for c, t in zip(story.contacts, numbers.t.tolist(), strict=True))
    shared = numbers.shared
    return replace(
        solution, story=Story(spans, contacts), friction=Friction(float(shared[SLIDING]), float(shared[ROLLING])),
        diameter=float(shared[DIAMETER]), nose=shared[NOSE:RUBBER].copy(), rubber=shared[RUBBER:SHARED].copy(),
    )  # fmt: skip


@compiled
def begins(bones, t):  # type: ignore[no-untyped-def]
    """When spans begin (S,) s if contacts happen at t (C,)."""
    at = bones.t0.copy()
    for k in range(len(at)):
        if bones.start[k] != NONE:
            at[k] = t[bones.start[k]]
    return at


@compiled
def finishes(bones, t):  # type: ignore[no-untyped-def]
    """When spans end (S,) s; infinite where they run to the end of the track."""
    at = np.full(len(bones.t0), np.inf)
    for k in range(len(at)):
        if bones.end[k] != NONE:
            at[k] = t[bones.end[k]]
    return at


def _numbered(numbers: list[int | None]) -> IntArray:
    return np.array([NONE if number is None else number for number in numbers], np.int64)


def _paired(spans: list[tuple[int, ...]]) -> IntArray:
    """Span numbers (C, 2) of one or two balls."""
    return np.array([(*some, NONE)[:2] for some in spans], np.int64).reshape(-1, 2)
