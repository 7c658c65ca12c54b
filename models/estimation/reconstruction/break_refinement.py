"""Break shots in a contact graph: a simulation replaces each ball's motion until its last contact in the break."""

from __future__ import annotations

import numpy as np

from models.core.contact_graph import Contact, ContactGraph
from models.core.joint_solution import JointSolution, Observations
from models.core.scene import Table
from models.core.shot import SimulatedBreak, select_outside_breaks
from models.estimation.break_shot.break_posterior import summarize_break
from models.estimation.break_shot.break_search import search_break
from models.estimation.joint_fit.contact_cascades import find_segment_at
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.structure_search.rack_detection import find_break_shots, rest_start_time

MAX_CHI2 = 20.0
"""Per degree of freedom, robust: a simulation with a larger misfit explains nothing."""
CERTAIN_GAIN = 1e6
"""chi2: gain of contacts from a simulation, which the structure search does not question."""
TIME_EPSILON = 1e-9
"""s: a moment later."""
VARIANCE_FACTOR = 2.0
"""Factor on the variances of the simulation, since it already used the samples after the break."""
_SEED = 1987
"""Of the random racks: the same clip gives the same simulation."""


def reconstruct_breaks(
    solution: JointSolution, observations: Observations, table: Table
) -> tuple[JointSolution, Observations, tuple[SimulatedBreak, ...]]:
    """Replace break shots by simulations where these explain the samples.

    Returns the solution, the observations that the rest of the graph has to explain, and the break shots.
    """
    generator = np.random.default_rng(_SEED)
    breaks = []
    for break_shot in find_break_shots(solution, observations, table):
        ensemble = search_break(break_shot, generator)
        if ensemble is None or ensemble.chi2_per_dof > MAX_CHI2:
            continue
        posterior = summarize_break(ensemble)
        if posterior.contacts:
            breaks.append(posterior)
    if not breaks:
        return solution, observations, ()
    graph = solution.graph
    for posterior in breaks:
        graph = _insert_break(graph, posterior)
    remaining = _add_arrival_observations(select_outside_breaks(observations, tuple(breaks)), tuple(breaks))
    return refine_graph(graph, remaining, table, initial=solution), remaining, tuple(breaks)


def _insert_break(graph: ContactGraph, posterior: SimulatedBreak) -> ContactGraph:
    """Let balls leave a break as simulated."""
    end = max(ball_exit.end for ball_exit in posterior.exits) + posterior.interval
    starts = {ball_exit.ball: _last_reliable_time(graph, posterior, ball_exit.ball) for ball_exit in posterior.exits}
    while removed := [
        k for k, c in enumerate(graph.contacts)
        if c.kind != "break" and (c.t <= posterior.hit or c.kind != "cushion")
        and any(starts[ball] < c.t <= end for ball in starts.keys() & graph.balls_at(c))
    ]:  # fmt: skip
        graph = graph.remove_contact(removed[-1])
    for ball_exit in posterior.exits:
        k = find_segment_at(graph, ball_exit.ball, ball_exit.end)
        whiten = np.linalg.inv(np.linalg.cholesky(VARIANCE_FACTOR * ball_exit.covariance))
        contact = Contact(
            "break",
            ball_exit.end,
            (k,),
            (),
            gain=CERTAIN_GAIN,
            break_start=ball_exit.start,
            exit_state=ball_exit.state,
            exit_whitening=whiten,
        )
        graph = graph.insert_contact(contact, (np.concatenate([ball_exit.state, np.zeros(2)]),))
    return graph.mark_pushed_strikes()


def _add_arrival_observations(observations: Observations, breaks: tuple[SimulatedBreak, ...]) -> Observations:
    """Add the place of each ball at its first contact in a break as an observation."""
    exits = [one for posterior in breaks for one in posterior.exits]
    ball = np.concatenate([observations.ball, np.array([one.ball for one in exits], dtype=np.int64)])
    t = np.concatenate([observations.t, [one.start - TIME_EPSILON for one in exits]])
    xy = np.concatenate([observations.xy, [one.arrival for one in exits]])
    whitening = [np.linalg.inv(np.linalg.cholesky(VARIANCE_FACTOR * one.arrival_covariance)) for one in exits]
    order = np.lexsort((t, ball))
    return Observations(ball[order], t[order], xy[order], np.concatenate([observations.whiten, whitening])[order])


def _last_reliable_time(graph: ContactGraph, one: SimulatedBreak, ball: int) -> float:
    """Return the time, s, until which the graph of a ball holds: as it comes in, or starts to rest."""
    if ball == one.balls[0]:
        return graph.start_time(find_segment_at(graph, ball, one.start + TIME_EPSILON))
    return rest_start_time(graph, ball, one.hit)
