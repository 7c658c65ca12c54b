"""Ensemble of a shot just after its strike, drawn from the posterior of everything that was observed."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.errors import TrackError
from models.core.fit_result import Fit, WholeShotSolution
from models.core.joint_solution import JointSolution
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import draw_members
from models.estimation.forecast.solution_state import (
    build_state_estimate,
    collect_captured_observations,
    estimate_lack_of_fit,
    inflate_covariance,
)
from models.estimation.shot_numbers.measure_shots import list_shots, present_time, select_whole_shot
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.estimation.shot_numbers.struck_samples import rewind_samples
from models.estimation.table_learning.learned_table import LearnedTable
from models.physics.billiards.ball_cushion.rebound_correction import NO_CORRECTION
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.parametrised_shot import (
    NOSE_OFFSETS,
    RADIUS_FACTOR,
    RADIUS_RATIO,
    convert_to_states,
)
from models.physics.billiards.simulation.simulate_shot import DISTURBED, BallSet, Physics, SimulatedShot, simulate


@dataclass(frozen=True, slots=True)
class StruckMember:
    """One member: everything that a simulation needs."""

    balls: BallSet
    """Balls at the strike."""
    physics: Physics
    offsets: FloatArray
    """(4,) m, of the noses."""
    correction: FloatArray
    """Weights of the correction of the cushion law; empty for none."""
    disturbances: FloatArray
    """(D, 5) deviations of cushion contacts from their law."""

    def simulate_from(self, state: FloatArray, table: Table, seconds: float) -> SimulatedShot:
        """Simulate the shot from states (N, 7) of the balls, for some seconds."""
        balls = replace(self.balls, state=state)
        return simulate(balls, table, self.physics, seconds, self.offsets, self.disturbances, self.correction)


@dataclass(frozen=True, slots=True)
class StruckEnsemble:
    """Members of one shot of N balls at its strike."""

    t: float
    """s, presentation time of the strike."""
    ids: tuple[str, ...]
    cue: int
    """Index of the struck ball."""
    table: Table
    members: tuple[StruckMember, ...]
    is_whole_shot: bool
    """Whether contact models that explain the whole shot give the members, so that side spin is determined."""


def draw_struck_ensemble(
    fit: Fit, solution: JointSolution, tracks: Tracks, table: Table, shot: int, draws: int, seed: int,
    learned: LearnedTable | None = None,
) -> StruckEnsemble:  # fmt: skip
    """Draw an ensemble of one shot at its strike.

    Without a learned table, the contact models that explain the whole shot are used, if there are any.

    Args:
        fit: Fit of the clip.
        solution: Joint fit behind it, with covariance.
        tracks: Tracks of T frames and N balls.
        table: Dimensions of the table.
        shot: Number of the shot in the clip, from 0.
        draws: Number of members.
        seed: Random seed.
        learned: What other shots taught about the table.

    Returns:
        The ensemble.

    Raises:
        TrackError: The clip has no such shot, or none.
    """
    courses = list_shots(fit, solution, tracks)
    if not courses:
        raise TrackError("no ball moves in this clip, so no shot can be played otherwise; choose a clip with a strike")
    if shot >= len(courses):
        raise TrackError(f"the clip has {len(courses)} shots; shot {shot} is not among them")
    course, rng = courses[shot], np.random.default_rng(seed)
    cue, begin = tracks.ids[course.cue], present_time(course.begin, fit.trajectory.clock)
    whole = select_whole_shot(fit.whole_shot, cue, begin) if course.is_struck and learned is None else None
    if whole is not None:
        return _draw_from_whole_shot(whole, solution, tracks, table, course, begin, draws, rng)
    observations = collect_captured_observations(tracks, fit.trajectory.clock, table)
    inflation = estimate_lack_of_fit(solution, observations)
    state = build_state_estimate(
        solution, tracks.ids, course.begin, table, set(), fit.trust, inflation, learned, is_last=False
    )
    members = []
    for inputs, law, disturbances in draw_members(state, rng, draws):
        balls, physics, offsets, correction = state.convert_inputs(inputs, law)
        members.append(StruckMember(balls, physics, offsets, correction, disturbances))
    return StruckEnsemble(begin, state.ids, state.ids.index(cue), table, tuple(members), False)


def _draw_from_whole_shot(
    whole: WholeShotSolution, solution: JointSolution, tracks: Tracks, table: Table, course: ShotCourse, begin: float,
    draws: int, rng: np.random.Generator,
) -> StruckEnsemble:  # fmt: skip
    """Draw members from the posterior samples of a whole shot; balls that never moved join at their mean places."""
    graph = solution.graph
    view = PosteriorView(solution, inflate_covariance(solution, 1.0), table.ball_radius)
    sigma = view.strike_sigma(course.segments[course.cue][0])
    samples = rewind_samples(whole, tracks.ids[course.cue], begin, sigma, table.ball_radius)
    resting = [
        ball
        for ball, name in enumerate(tracks.ids)
        if name not in whole.ids and (rows := graph.segments_of_ball(ball)) and graph.segments[rows[0]].static
    ]
    places = np.array([graph.segments[graph.segments_of_ball(ball)[0]].state[:2] for ball in resting]).reshape(-1, 2)
    ids = (*whole.ids, *(tracks.ids[ball] for ball in resting))
    members = []
    for number in rng.integers(len(samples), size=draws):
        sample = samples[number]
        values = sample.values
        radius = table.ball_radius * float(values[RADIUS_FACTOR])
        state = np.zeros((len(ids), 7))
        state[: len(whole.ids)] = convert_to_states(sample.states, radius)[0]
        state[len(whole.ids) :, :2] = places
        sizes = radius * np.where(np.arange(len(ids)) > 0, float(values[RADIUS_RATIO]), 1.0)
        physics = Physics(values[: len(PARAMETER_NAMES)].copy(), (), whole.cushion_model, sample.ball_model)
        members.append(
            StruckMember(
                BallSet(ids, state, sizes, np.full(len(ids), table.ball_mass)), physics,
                values[NOSE_OFFSETS : NOSE_OFFSETS + 4].copy(), NO_CORRECTION, np.zeros((0, len(DISTURBED))),
            )
        )  # fmt: skip
    return StruckEnsemble(begin, ids, ids.index(tracks.ids[course.cue]), table, tuple(members), True)
