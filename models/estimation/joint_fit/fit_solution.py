"""A story with numbers: states, contact times and coefficients that were fitted, and the samples they answer for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from models.core.tracks import Tracks
from models.core.typing import FloatArray, IntArray
from models.estimation.segmentation.contact_graph import Story
from models.numerics.jit import compiled
from models.physics.billiards.cloth.closed_form_motion import STATE, Friction, kinematics

FOREVER = 100.0
"""s: every ball rests by then."""


@dataclass(frozen=True, slots=True)
class Data:
    """What was seen, one row per observation, sorted by ball and time."""

    ball: IntArray
    t: FloatArray
    xy: FloatArray
    whiten: FloatArray
    """(K, 2, 2): takes a residual in m to standard deviations."""


@dataclass(frozen=True, slots=True)
class Solution:
    """A refined story."""

    story: Story
    friction: Friction
    diameter: float
    """factor on two radii."""
    nose: FloatArray
    """(4,) m, where centres turn, beyond one radius from each nose; > 0 towards the table."""
    rubber: FloatArray
    """(3,) of all cushions: restitution of a slow ball, its change with speed in s/m, and grip: how far the nose stops
    the spin about the line of the cushion, 0 not at all, 1 until it does not slip."""
    chi2: float
    """robust, with pseudo-observations."""
    covariance: FloatArray
    """(P, P) of the packed parameters, see `Layout`; empty until `refinement.with_covariance` gives it."""


@dataclass(frozen=True, slots=True)
class Layout:
    """Where each number stands in the packed vector."""

    span: IntArray
    """(S,) first column; a static span has two numbers, a moving one eight."""
    contact: int
    """column of the time of the first contact."""
    globals: int
    """ln mu_sliding, ln mu_rolling, diameter, four noses, three of the rubber."""
    size: int


SHARED = 10
"""Numbers that all spans and contacts share."""


def gather(tracks: Tracks) -> Data:
    """Observations of all balls."""
    frame, ball = np.nonzero(tracks.observed)
    order = np.lexsort((frame, ball))
    frame, ball = frame[order], ball[order]
    return Data(ball.astype(np.int64), tracks.t[frame], tracks.xy[frame, ball], tracks.whitening[frame, ball])


def layout(story: Story) -> Layout:
    """Columns of the packed parameters of a story."""
    sizes = np.array([2 if span.static else STATE for span in story.spans], dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(sizes)])
    contact = int(starts[-1])
    return Layout(starts[:-1], contact, contact + len(story.contacts), contact + len(story.contacts) + SHARED)


def owners(story: Story, data: Data) -> IntArray:
    """Which span each observation belongs to, by time (K,)."""
    begins = np.array([story.begin(k) for k in range(len(story.spans))], np.float64)
    owner: IntArray = owners_among(np.array([span.ball for span in story.spans], np.int64), begins, data.ball, data.t)
    return owner


@compiled
def owners_among(span_ball, begin, ball, t):  # type: ignore[no-untyped-def]
    """The same of the balls (S,) and beginnings (S,) s of spans; observations (K,) are sorted by ball and time."""
    owner = np.zeros(len(t), np.int64)
    mine = np.empty(len(begin), np.int64)
    row = 0
    while row < len(t):
        count = 0
        for k in range(len(begin)):  # the spans of this ball, put in order as they come
            if span_ball[k] == ball[row]:
                place = count
                while place > 0 and begin[mine[place - 1]] > begin[k]:
                    mine[place] = mine[place - 1]
                    place -= 1
                mine[place] = k
                count += 1
        this, now = ball[row], 0
        while row < len(t) and ball[row] == this:
            while now + 1 < count and begin[mine[now + 1]] <= t[row] + 1e-12:
                now += 1
            owner[row] = mine[now]
            row += 1
    return owner


def residuals(solution: Solution, data: Data) -> FloatArray:
    """Measured minus fitted (K, 2) in m."""
    story = solution.story
    owner = owners(story, data)
    begins = np.array([story.begin(k) for k in range(len(story.spans))])
    states = np.array([span.state for span in story.spans])[owner]
    fitted = kinematics(states, data.t - begins[owner], solution.friction)[:, :2]
    static = np.array([span.static for span in story.spans])[owner]
    return data.xy - np.where(static[:, None], states[:, :2], fitted)


def end_state(solution: Solution, k: int) -> FloatArray:
    """Position, velocity, slip (6,) of a span where it ends."""
    span = solution.story.spans[k]
    if span.static:
        return np.concatenate([span.state[:2], np.zeros(4)])
    tau = np.array([min(solution.story.finish(k) - solution.story.begin(k), FOREVER)])
    state: FloatArray = kinematics(span.state[None], tau, solution.friction)[0]
    return state
