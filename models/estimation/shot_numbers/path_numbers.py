"""How far each ball goes, and how many cushions it touches."""

from __future__ import annotations

import numpy as np

from models.core.events import Events
from models.core.joint_solution import layout_parameters
from models.core.shot_numbers import ShotNumber
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.physics.billiards.cloth.closed_form_motion import duration_until_rest

_NODES = 24
"""Gauss-Legendre nodes of a segment: exact to micrometres on a path of two smooth parts."""


def measure_length(view: PosteriorView, segments: tuple[int, ...], until: float, ball: str) -> ShotNumber:
    """Measure the length of the path of a ball.

    Args:
        view: Joint fit with its covariance.
        segments: Its moving segments, in the order of time.
        until: s, end of the shot or of the observation of the ball.
        ball: Id of the ball.

    Returns:
        The length, m.
    """
    nodes, weights = np.polynomial.legendre.leggauss(_NODES)
    length, gradient = 0.0, np.zeros(len(view.covariance))
    graph, first_contact = view.solution.graph, layout_parameters(view.solution.graph).contact
    for k in segments:
        begin = graph.start_time(k)
        rest = begin + float(duration_until_rest(graph.segments[k].state[None], view.solution.friction)[0])
        end = min(view.end_time(k), until, rest)
        if end <= begin:
            continue
        for node, weight in zip(nodes, weights, strict=True):
            state = view.state_at(k, begin + (end - begin) * (node + 1) / 2)
            speed = max(float(np.hypot(*state.value[2:4])), 1e-9)
            share = weight * (end - begin) / 2
            length += share * speed
            gradient += share * (state.value[2:4] / speed) @ state.jacobian[2:4]
        for side, contact in ((-1.0, graph.segments[k].start), (1.0, graph.segments[k].end)):
            if contact is not None and (side < 0 or end == view.end_time(k)):
                state = view.state_at_start(k) if side < 0 else view.state_at_end(k)
                gradient[first_contact + contact] += side * float(np.hypot(*state.value[2:4]))
    return ShotNumber("length", float(length), view.sigma_of(gradient), "m", True, ball)


def count_cushions(events: Events, ball: str, begin: float, end: float) -> ShotNumber:
    """Count the cushions that a ball touches, each weighted by its probability.

    Args:
        events: Events of the clip.
        ball: Id of the ball.
        begin: s, presentation time of the strike.
        end: s, presentation time of the next strike.

    Returns:
        The expected number.
    """
    p = np.array(
        [
            events.probability[k]
            for k in range(len(events))
            if events.kind[k] == "cushion" and events.a[k] == ball and begin <= events.t[k] < end
        ]
    )
    return ShotNumber("cushions", float(p.sum()), float(np.sqrt((p * (1 - p)).sum())), "", True, ball)
