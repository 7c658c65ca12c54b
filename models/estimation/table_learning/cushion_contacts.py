"""Cushion contacts of a shot with the states before and after them, chained where side spin continues.

Both states come from the joint fit, with their common covariance. The paths around a contact show velocity and slip;
no path shows side spin, which links the contacts of one ball.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import numpy as np

from models.core.contact_graph import SEGMENT_STATE_SIZE, SHARED_COUNT, JointSolution, layout_parameters
from models.core.scene import CUSHIONS, Table
from models.core.typing import FloatArray, IntArray
from models.estimation.joint_fit.fit_solution import build_graph_arrays, extract_parameters
from models.estimation.joint_fit.pseudo_observations import evaluate_priors
from models.estimation.segmentation.contact_classification import INWARD_NORMALS
from models.physics.billiards.cloth.closed_form_motion import differentiate_kinematics

# Prior standard deviation of the surface speed of side spin after a strike: share of the speed, and m/s; a cue that
# hits at R/2 from the centre gives 5/4.
STRUCK_SPIN, STRUCK_SPIN_AT_REST = 0.6, 0.1
# The same share for a ball that another one set in motion: throw, friction 0.06.
DRIVEN_SPIN = 0.15
# Pseudo-observations of a cushion contact that concern rubber, after two of continuity and one of the nose:
# restitution, friction, and two of spin.
_RUBBER_ROWS = slice(3, 7)
# Least share of the information about one of them that comes from the paths: what is smaller is rounding.
_LEAST_PATH_SHARE = 0.05
# Change of that surface speed in a contact of balls, over the speed: friction 0.06 acts on 5/2 of the impulse.
BALL_CONTACT_SPIN = 0.1


class SpinLink(NamedTuple):
    """What happens to side spin before a contact."""

    begins: bool
    """Whether a chain begins here, with the prior standard deviation `sigma`."""
    elapsed: float
    """s since the previous contact with a cushion, or since the chain began."""
    sigma: float
    """m/s: standard deviation of the surface speed of the side spin at the start, or of its change since then."""


@dataclass(frozen=True, slots=True)
class CushionContacts:
    """K contacts, chain by chain in the order of time; n points into the cushion, t = z x n."""

    shot: IntArray
    """(K,)"""
    ball: IntArray
    """(K,) index of the ball in its shot."""
    side: IntArray
    """(K,) index in `CUSHIONS`."""
    t: FloatArray
    """(K,) s"""
    before: FloatArray
    """(K, 4) m/s: velocity along n and t, slip along n and t."""
    after: FloatArray
    """(K, 4) the same after the contact."""
    covariance: FloatArray
    """(K, 8, 8) of both states."""
    begins: IntArray
    """(K,) 1 where a chain begins, `elapsed` (K,) s and `spin_sigma` (K,) m/s as in `SpinLink`."""
    elapsed: FloatArray
    spin_sigma: FloatArray

    @property
    def speed(self) -> FloatArray:
        """(K,) m/s before each contact."""
        return np.asarray(np.hypot(self.before[:, 0], self.before[:, 1]))

    def select_chains(self, keep: FloatArray | IntArray) -> CushionContacts:
        """Select the contacts of a mask (K,), which keeps or drops whole chains."""
        mask = np.asarray(keep, bool)
        return CushionContacts(*(getattr(self, one.name)[mask] for one in fields(self)))


@dataclass(frozen=True, slots=True)
class SpinHistory:
    """Side spin of one ball after its last cushion contact until the end of the observation."""

    ball: int
    contact: int
    """Row of its last cushion contact among those of its shot, -1 where there was none since its chain began."""
    link: SpinLink


def extract_cushion_contacts(
    solution: JointSolution, table: Table, shot: int = 0
) -> tuple[CushionContacts, tuple[SpinHistory, ...]]:
    """Extract the cushion contacts of one shot, without what the joint fit assumes about rubber.

    Args:
        solution: Joint fit with covariance.
        table: Dimensions of the table.
        shot: Number of the shot.

    Returns:
        Its contacts, and the history of each ball that moves in its last segment. `SpinHistory.link.elapsed` counts
        until the start of the last segment.
    """
    rows: list[tuple[object, ...]] = []
    histories = []
    graph = solution.graph
    for ball in sorted({segment.ball for segment in graph.segments}):
        link, last, numbers = SpinLink(True, 0.0, np.nan), -1, graph.segments_of_ball(ball)
        for place, k in enumerate(numbers):
            segment = graph.segments[k]
            if segment.static:
                link, last = SpinLink(True, 0.0, np.nan), -1
                continue
            link, last = _begin_segment(solution, k, link, last)
            if place + 1 == len(numbers):
                histories.append(SpinHistory(ball, last, link))
                break
            duration = graph.end_time(k) - graph.start_time(k)
            link = link._replace(elapsed=link.elapsed + duration)
            following = numbers[place + 1]
            if segment.end is None or graph.segments[following].static:
                continue
            contact = graph.contacts[segment.end]
            if contact.kind != "cushion":
                continue
            before, after, covariance = _states_around(solution, k, following, table)
            if before[0] <= 0 or after[0] >= 0 or not _is_covariance(covariance):  # it does not bounce, or is not known
                continue
            side = CUSHIONS.index(contact.cushion)
            rows.append((shot, ball, side, contact.t, before, after, covariance, int(link.begins), *link[1:]))
            link, last = SpinLink(False, 0.0, 0.0), len(rows) - 1
    return _stack_rows(rows), tuple(histories)


def join_contacts(parts: Iterable[CushionContacts]) -> CushionContacts:
    """Join the contacts of several shots."""
    shots = list(parts)
    return CushionContacts(*(np.concatenate([getattr(p, one.name) for p in shots]) for one in fields(CushionContacts)))


def evaluate_segment_state(
    solution: JointSolution, k: int, t: float, contact: int | None = None
) -> tuple[FloatArray, FloatArray]:
    """Evaluate a segment at a time, with derivatives by the parameters of the fit.

    Args:
        solution: Joint fit with covariance of P parameters.
        k: Index of the segment.
        t: s.
        contact: The contact whose time t is, which is a parameter too; None for a given time.

    Returns:
        Place (m), velocity and slip (m/s) (6,), and their derivatives (6, P).
    """
    layout, segment = layout_parameters(solution.graph), solution.graph.segments[k]
    first, jacobian = int(layout.segment[k]), np.zeros((6, layout.size))
    if segment.static:
        jacobian[[0, 1], [first, first + 1]] = 1.0
        return np.concatenate([segment.state[:2], np.zeros(4)]), jacobian
    tau = np.array([max(t - solution.graph.start_time(k), 0.0)])
    value, slope = differentiate_kinematics(segment.state[None], tau, solution.friction)
    jacobian[:, first : first + SEGMENT_STATE_SIZE] = slope[0, :, :SEGMENT_STATE_SIZE]
    jacobian[:, layout.shared : layout.shared + 2] = slope[0, :, SEGMENT_STATE_SIZE + 1 :]
    if segment.start is not None:
        jacobian[:, layout.contact + segment.start] -= slope[0, :, SEGMENT_STATE_SIZE]
    if contact is not None:
        jacobian[:, layout.contact + contact] += slope[0, :, SEGMENT_STATE_SIZE]
    return value[0], jacobian


def _begin_segment(solution: JointSolution, k: int, link: SpinLink, last: int) -> tuple[SpinLink, int]:
    """Return the spin link at the start of a moving segment, and the last cushion contact of its chain."""
    graph, segment = solution.graph, solution.graph.segments[k]
    speed = float(np.hypot(*segment.state[2:4]))
    kind = "" if segment.start is None else graph.contacts[segment.start].kind
    if kind == "cushion" and not np.isnan(link.sigma):
        return link, last
    if kind in ("ball", "free") and not np.isnan(link.sigma):  # it was on its way
        return link._replace(sigma=float(np.hypot(link.sigma, BALL_CONTACT_SPIN * speed))), last
    share = DRIVEN_SPIN if kind == "ball" else STRUCK_SPIN
    return SpinLink(True, 0.0, share * speed + STRUCK_SPIN_AT_REST), -1


def _states_around(
    solution: JointSolution, k: int, following: int, table: Table
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the states (4,) before and after the cushion contact that ends segment `k`, with covariance (8, 8).

    What the joint fit assumes about rubber at this contact is taken out: the contact model would count it again.
    """
    number = solution.graph.segments[k].end
    contact = solution.graph.contacts[number]  # type: ignore[index]
    n = -np.asarray(INWARD_NORMALS[CUSHIONS.index(contact.cushion)])
    turn = np.zeros((4, 6))
    turn[0, 2:4] = turn[2, 4:6] = n
    turn[1, 2:4] = turn[3, 4:6] = (-n[1], n[0])
    end, by_end = evaluate_segment_state(solution, k, contact.t, number)
    start, by_start = evaluate_segment_state(solution, following, contact.t, number)
    jacobian = np.vstack([turn @ by_end, turn @ by_start])
    residual, derivative = _differentiate_rubber(solution, number, table)  # type: ignore[arg-type]
    effect = solution.covariance @ derivative.T
    values, vectors = np.linalg.eigh(np.eye(len(residual)) - derivative @ effect)
    gain = jacobian @ effect @ (vectors / np.maximum(values, _LEAST_PATH_SHARE)) @ vectors.T
    moved = gain @ residual
    covariance = jacobian @ solution.covariance @ jacobian.T + gain @ (jacobian @ effect).T
    return turn @ end + moved[:4], turn @ start + moved[4:], covariance


def _differentiate_rubber(solution: JointSolution, contact: int, table: Table) -> tuple[FloatArray, FloatArray]:
    """Return the pseudo-observations (4,) of rubber at a cushion contact, and their derivatives (4, P), in sigmas."""
    local, chosen = solution.graph.extract_contact(contact)
    arrays, parameters = build_graph_arrays(local), extract_parameters(solution, local)
    rows, layout = evaluate_priors(arrays, parameters, parameters, table), layout_parameters(solution.graph)
    columns = np.concatenate(
        [*(layout.segment[k] + np.arange(SEGMENT_STATE_SIZE) for k in chosen), [layout.contact + contact],
         layout.shared + np.arange(SHARED_COUNT)]
    )  # fmt: skip
    derivative = np.zeros((_RUBBER_ROWS.stop - _RUBBER_ROWS.start, layout.size))
    for k, row in enumerate(range(_RUBBER_ROWS.start, _RUBBER_ROWS.stop)):
        entries = slice(rows.first[row], rows.first[row + 1])
        np.add.at(derivative[k], columns[rows.column[entries]], rows.derivative[entries])
    return rows.residual[_RUBBER_ROWS], derivative


def _is_covariance(matrix: FloatArray) -> bool:
    """Return whether a matrix is finite and, but for rounding, not negative."""
    return bool(np.isfinite(matrix).all() and np.linalg.eigvalsh(matrix)[0] > -1e-9)


def _stack_rows(rows: list[tuple[object, ...]]) -> CushionContacts:
    columns = list(zip(*rows, strict=True)) if rows else [()] * 10
    whole, shapes = (0, 1, 2, 7), {4: (4,), 5: (4,), 6: (8, 8)}
    arrays: list[Any] = [
        np.array(column, np.int64 if k in whole else np.float64).reshape(len(rows), *shapes.get(k, ()))
        for k, column in enumerate(columns)
    ]
    return CushionContacts(*arrays)
