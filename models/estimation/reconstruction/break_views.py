"""Events and trajectories of the balls in a simulated break."""

from __future__ import annotations

import numpy as np

from models.core.shot import BreakExit, SimulatedBreak
from models.core.trajectory import Trajectory
from models.estimation.reconstruction.trajectory_assembly import TrajectoryPiece, shift_polynomial
from models.estimation.shot_hypotheses.event_row import EventRow


def list_break_contacts(breaks: tuple[SimulatedBreak, ...], ids: tuple[str, ...]) -> list[EventRow]:
    """List the contacts in breaks as events."""
    return [
        EventRow(
            "ball",
            contact.t,
            contact.t_sigma,
            ids[contact.a],
            ids[contact.b],
            contact.xy,
            "",
            probability=contact.probability,
            speed=contact.speed,
        )
        for posterior in breaks
        for contact in posterior.contacts
    ]


def build_break_pieces(breaks: tuple[SimulatedBreak, ...]) -> list[TrajectoryPiece]:
    """Build the trajectories of balls in breaks from the best simulations."""
    pieces = []
    for posterior in breaks:
        for ball_exit in posterior.exits:
            number = posterior.balls.index(ball_exit.ball)
            pieces += _build_ball_pieces(posterior.motion, number, ball_exit, posterior.start)
    return pieces


def _build_ball_pieces(
    motion: Trajectory, number: int, ball_exit: BreakExit, break_start: float
) -> list[TrajectoryPiece]:
    """Build the trajectory of one ball of a break that starts at `break_start`, s: first to last contact."""
    pieces = []
    covariance = ball_exit.covariance[:4, :4]
    for k in np.flatnonzero(motion.ball == number):
        start, end = (
            max(float(motion.start[k]) + break_start, ball_exit.start),
            min(float(motion.end[k]) + break_start, ball_exit.end),
        )
        if end - start < 1e-9:
            continue
        offset = start - break_start - float(motion.start[k])
        position = shift_polynomial(motion.position[k], offset)
        spin = np.array([motion.spin[k, 0] + offset * motion.spin[k, 1], motion.spin[k, 1]])
        pieces.append(TrajectoryPiece(ball_exit.ball, start, end, position, spin, motion.phase[k], covariance))
    return pieces
