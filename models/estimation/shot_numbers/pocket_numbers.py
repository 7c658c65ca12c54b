"""Where and how fast a ball passes the mouth of a pocket."""

from __future__ import annotations

from functools import partial

import numpy as np

from models.core.scene import POCKETS, Table
from models.core.shot_numbers import ShotNumber
from models.core.typing import FloatArray
from models.estimation.shot_numbers.posterior_view import LinearState, PosteriorView
from models.physics.billiards.cloth.closed_form_motion import evaluate_kinematics
from models.physics.billiards.cushion_geometry import MouthLine, find_mouth_line

MAX_MISS_RADII = 6.0
"""Ball radii: a ball that passes farther from the middle of a mouth, three balls, was not sent there."""
_SAMPLES = 400
"""Times at which a segment is searched for the moment at which it passes a mouth: 1 cm of a fast ball."""
_LONGEST_SEARCH = 12.0
"""s of a segment that is searched: balls roll no longer."""


def measure_pocket(view: PosteriorView, segment: int, ball: str, table: Table, pocket: str | None) -> list[ShotNumber]:
    """Measure offset and speed of a ball where it passes the mouth of a pocket.

    A path that ends at a cushion beside the mouth is continued straight.

    Args:
        view: Joint fit with its covariance.
        segment: Index of the segment that leads to the pocket.
        ball: Id of the ball.
        table: Table with pockets.
        pocket: Name of the pocket; None: the one that the path comes nearest to.

    Returns:
        Offset from the centre line of the mouth (mm, > 0 to the right of the player) and speed (m/s); nothing if the
        path leads to no pocket.
    """
    names = POCKETS if pocket is None else (pocket,)
    passages = []
    for name in names:
        mouth = find_mouth_line(table, name)
        state = _find_passage(view, segment, mouth)
        if state is None:
            continue
        passages.append((name, *view.evaluate(partial(_measure_at_mouth, mouth=mouth), state)))
    if not passages:
        return []
    name, (offset, speed), (offset_sigma, speed_sigma) = min(passages, key=lambda one: abs(float(one[1][0])))
    if pocket is None and abs(offset) > MAX_MISS_RADII * table.ball_radius:
        return []
    return [
        ShotNumber("pocket_offset", 1e3 * float(offset), 1e3 * float(offset_sigma), "mm", True, ball, name),
        ShotNumber("pocket_speed", float(speed), float(speed_sigma), "m/s", True, ball, name),
    ]


def _find_passage(view: PosteriorView, segment: int, mouth: MouthLine) -> LinearState | None:
    """Find the state of a segment where it passes the line of a mouth, or at its end; None if it goes elsewhere."""
    graph = view.solution.graph
    begin = graph.start_time(segment)
    last = min(view.end_time(segment), begin + _LONGEST_SEARCH) - begin
    tau = np.linspace(0.0, last, _SAMPLES)
    path = evaluate_kinematics(
        np.repeat(graph.segments[segment].state[None], _SAMPLES, axis=0), tau, view.solution.friction
    )
    depth = (path[:, :2] - mouth.middle) @ mouth.outward
    crossing = np.flatnonzero((depth[:-1] < 0) & (depth[1:] >= 0))
    if len(crossing):
        return view.state_at(segment, begin + float(tau[crossing[0]]))
    end = view.state_at(segment, begin + float(tau[-1]))
    heading = float(end.value[2:4] @ mouth.outward)
    is_coming = heading > 0.1 * float(np.hypot(*end.value[2:4])) and depth[-1] < 0 and np.hypot(*end.value[2:4]) > 0
    return end if is_coming else None


def _measure_at_mouth(state: FloatArray, mouth: MouthLine) -> FloatArray:
    """Return where the straight continuation of a state passes a mouth, m right of its middle, and the speed."""
    place, velocity = state[:2] - mouth.middle, state[2:4]
    ahead = -float(place @ mouth.outward) / float(velocity @ mouth.outward)
    right = np.array([-mouth.outward[1], mouth.outward[0]])
    return np.array([(place + ahead * velocity) @ right, np.hypot(*velocity)])
