"""Trials of changed contact graphs: what they cost, refined as a whole or where they differ, and which were tried."""

from __future__ import annotations

import logging
from collections.abc import Hashable, Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from models.core.contact_graph import Contact, ContactGraph, ContactKind, JointSolution, Observations
from models.core.scene import CUSHIONS, Table
from models.estimation.joint_fit.contact_cascades import MIN_CONTACT_INTERVAL, MIN_CONTACT_SPEED
from models.estimation.joint_fit.fit_solution import assign_observations, end_state
from models.estimation.joint_fit.joint_refinement import refine_graph
from models.estimation.segmentation.contact_classification import INWARD_NORMALS

logger = logging.getLogger("trueroll.fit")

# Iterations of segments that are refined by themselves.
LOCAL_ITERATIONS = 12
# Iterations that show whether a graph deserves more of them.
TRIAL_ITERATIONS = 10


@dataclass(frozen=True, slots=True)
class StructureSearch:
    """What every step of a search uses, with the results of earlier trials by the situation they were evaluated in."""

    observations: Observations
    table: Table
    prices: tuple[float, float]
    """chi2 that contacts with a cause and without cost."""
    gains: dict[tuple[Hashable, ...], float] = field(default_factory=dict)
    """chi2 that contacts of a graph improve."""
    trials: dict[tuple[Hashable, ...], tuple[float, ContactGraph]] = field(default_factory=dict)
    """chi2 that proposed contacts gain, minus their prices, and the segments that they change, refined by themselves.
    """
    required: set[tuple[Hashable, ...]] = field(default_factory=set)
    """Contacts that the whole clip needs unchanged: the balls, and the time to a hundredth of a second."""

    def restart(self, observations: Observations) -> StructureSearch:
        """Return a search for other observations, without earlier trials."""
        return StructureSearch(observations, self.table, self.prices)

    @property
    def interval(self) -> float:
        """Frame interval, s."""
        return self.observations.frame_interval

    def cost(self, solution: JointSolution) -> float:
        """Return the chi2 of a solution plus the prices of its contacts."""
        doubtful = sum(is_doubtful(solution, c) for c in solution.graph.contacts)
        return solution.chi2 + doubtful * self.prices[1] + (len(solution.graph.contacts) - doubtful) * self.prices[0]

    def refine(
        self, graph: ContactGraph, solution: JointSolution, iterations: int = 30, local: Observations | None = None
    ) -> JointSolution:
        """Refine a graph from the coefficients of a solution, to some of the observations if `local` is given."""
        return refine_graph(graph, self.observations if local is None else local, self.table, iterations, solution)

    def refine_if_cheaper(self, graph: ContactGraph, solution: JointSolution) -> JointSolution | None:
        """Refine a graph if its total cost is lower than that of the solution after few iterations; else None."""
        trial = self.refine(graph, solution, TRIAL_ITERATIONS)
        return self.refine(trial.graph, trial) if self.cost(trial) < self.cost(solution) else None

    def select_observations(self, graph: ContactGraph, segments: Iterable[int]) -> Observations:
        """Select the observations of some segments of a graph."""
        owner = assign_observations(graph, self.observations)
        return self.observations.select_rows(np.isin(owner, list(segments)))

    def evaluate_extension(
        self, solution: JointSolution, extended: ContactGraph, region: frozenset[int],
        base_costs: dict[frozenset[int], float],
    ) -> tuple[float, ContactGraph] | None:  # fmt: skip
        """Evaluate the gain in total cost of more contacts on the segments of a solution that they change.

        Args:
            solution: A refined solution.
            extended: Its graph with more contacts; new segments come last.
            region: Segments that change.
            base_costs: Total cost of each region without the contacts; filled in.

        Returns:
            The gain, and the changed and new segments, refined by themselves; None without a sample there.
        """
        graph, local = solution.graph, self.select_observations(solution.graph, region)
        if not len(local.t):
            return None
        segments = sorted(region)
        if region not in base_costs:
            base_costs[region] = self.cost(self._refine_part(solution, graph, segments, local))
        segments += range(len(graph.segments), len(extended.segments))
        refined = self._refine_part(solution, extended, segments, local)
        return base_costs[region] - self.cost(refined), refined.graph

    def refine_differences(
        self, solution: JointSolution, one: ContactGraph, other: ContactGraph
    ) -> tuple[JointSolution, JointSolution] | None:
        """Refine the segments in which two graphs differ, by themselves.

        Args:
            solution: Solution with the coefficients.
            one: A graph.
            other: The same graph with changed contacts; it has the segments of the first one, then new ones.

        Returns:
            The refined parts of both graphs; None where no sample belongs to these segments.
        """
        differing = [k for k in range(len(one.segments)) if not _is_same_segment(one, other, k)]
        local = self.select_observations(one, differing)
        if not len(local.t):
            return None
        new = range(len(one.segments), len(other.segments))
        return (
            self._refine_part(solution, one, differing, local),
            self._refine_part(solution, other, [*differing, *new], local),
        )

    def _refine_part(
        self, solution: JointSolution, graph: ContactGraph, segments: list[int], local: Observations
    ) -> JointSolution:
        """Refine some segments of a graph and the contacts among them by themselves."""
        return self.refine(graph.select_segments(segments), solution, LOCAL_ITERATIONS, local)

    def log_pass(self, name: str, before: JointSolution, after: JointSolution) -> JointSolution:
        """Log the cost and the contacts before and after a pass, for `trueroll run --debug`; return the latter."""
        if logger.isEnabledFor(logging.DEBUG):
            costs = [self.cost(one) for one in (before, after)]
            counts = [len(one.graph.contacts) for one in (before, after)]
            change = "unchanged" if after is before else f"{costs[1]:.1f} with {counts[1]}"
            logger.debug("%-26s cost %.1f with %d contacts -> %s", name, costs[0], counts[0], change)
        return after


def is_doubtful(solution: JointSolution, contact: Contact) -> bool:
    """Return whether a contact has no cause, or is so slow that a bent path would do as well."""
    if contact.kind == "ball" and not contact.driven:
        one, two = (end_state(solution, k) for k in contact.before)
        separation = two[:2] - one[:2]
        closing = float((one[2:4] - two[2:4]) @ separation) / max(float(np.hypot(*separation)), 1e-9)
        return closing < MIN_CONTACT_SPEED
    if contact.kind == "cushion":
        inward = INWARD_NORMALS[CUSHIONS.index(contact.cushion)]
        return bool(-inward @ end_state(solution, contact.before[0])[2:4] < MIN_CONTACT_SPEED)
    return contact.kind in ("free", "jump") or contact.pushed


def copy_refined_states(graph: ContactGraph, subgraph: ContactGraph, segments: list[int]) -> ContactGraph:
    """Copy states and times of a refined subgraph, which has the segments `segments`; no change if they do not fit."""
    states, contacts = list(graph.segments), list(graph.contacts)
    for k, refined in zip(segments, subgraph.segments, strict=True):
        if states[k].static == refined.static:
            states[k] = replace(states[k], state=refined.state)
    for contact in subgraph.contacts:
        number = states[segments[contact.before[0]]].end
        if number is not None:
            contacts[number] = replace(contacts[number], t=contact.t)
    updated = ContactGraph(tuple(states), tuple(contacts))
    is_ordered = all(updated.end_time(k) > updated.start_time(k) + MIN_CONTACT_INTERVAL for k in range(len(states)))
    return updated if is_ordered else graph


def separate_balls(graph: ContactGraph, number: int) -> ContactGraph:
    """Replace a ball contact by separate velocity changes of each ball.

    Args:
        graph: The contact graph.
        number: The ball contact.

    Returns:
        The graph; the change of the first ball keeps the index, that of the other one is the last contact.
    """
    contact, segments, contacts = graph.contacts[number], list(graph.segments), list(graph.contacts)
    for slot, index in ((0, number), (1, len(contacts))):
        before, after = contact.before[slot], contact.after[slot]
        kind: ContactKind = "strike" if segments[before].static else "free"
        single = Contact(kind, contact.t, (before,), (after,), gain=contact.gain)
        segments[before], segments[after] = replace(segments[before], end=index), replace(segments[after], start=index)
        contacts[index : index + 1] = [single]
    return ContactGraph(tuple(segments), tuple(contacts)).mark_pushed_strikes()


def join_changes(graph: ContactGraph, first: int, second: int, t: float, keep: int) -> ContactGraph:
    """Join the velocity changes of two balls to one contact of both.

    Args:
        graph: The contact graph.
        first: Contact of the first ball.
        second: Contact of the second ball.
        t: s, time of the joined contact.
        keep: The one of both whose place the joined contact takes.

    Returns:
        The graph; its contact gains what both did.
    """
    one, two = graph.contacts[first], graph.contacts[second]
    joined = Contact("ball", t, (*one.before, *two.before), (*one.after, *two.after), gain=one.gain + two.gain)
    return graph.merge_contacts(keep, first + second - keep, joined)


def _is_same_segment(one: ContactGraph, other: ContactGraph, k: int) -> bool:
    """Return whether a segment is the same in two graphs."""
    a, b = one.segments[k], other.segments[k]
    is_same_motion = a.static == b.static and np.array_equal(a.state, b.state)
    return is_same_motion and _describe_ends(one, k) == _describe_ends(other, k)


def _describe_ends(graph: ContactGraph, k: int) -> tuple[object, ...]:
    """Return the kinds and times of the contacts at the ends of a segment."""
    ends = (graph.segments[k].start, graph.segments[k].end)
    return tuple(None if c is None else (graph.contacts[c].kind, graph.contacts[c].t) for c in ends)
