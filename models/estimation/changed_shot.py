"""A shot played otherwise: paths with uncertainty, events with probabilities, and the probability that it scores.

An ensemble of the shot just after its strike is drawn from the posterior of everything that was observed. A stroke
changes in speed, direction, side spin and top spin, and scatters as the player does.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.core.contact_graph import JointSolution
from models.core.errors import NO_STROKE, TrackError
from models.core.fit_result import Fit, WholeShotSolution
from models.core.scene import Table
from models.core.tracks import Tracks
from models.core.typing import FloatArray
from models.estimation.forecast.ensemble_prediction import (
    EventKey,
    PredictedEvent,
    draw_members,
    list_contacts,
    summarize_events,
)
from models.estimation.forecast.solution_state import (
    build_state_estimate,
    collect_captured_observations,
    estimate_lack_of_fit,
    inflate_covariance,
)
from models.estimation.shot_numbers.measure_shots import list_shots, present_time, select_whole_shot
from models.estimation.shot_numbers.posterior_view import PosteriorView
from models.estimation.shot_numbers.shot_course import ShotCourse
from models.estimation.shot_numbers.strike_numbers import rewind_samples
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

# m/s: no stroke is slower.
MIN_SPEED = 1e-3


@dataclass(frozen=True, slots=True)
class StrokeChange:
    """How a stroke differs from the real one. Spins are shares: R omega over the speed of the ball."""

    speed_factor: float = 1.0
    speed: float | None = None
    """m/s; replaces the speed."""
    angle: float = 0.0
    """Degrees to the right of the player."""
    side_added: float = 0.0
    """Added to the side spin; > 0 to the right."""
    side: float | None = None
    """Replaces the side spin."""
    top_added: float = 0.0
    """Added to the top spin: 1 rolls, 0 stun, < 0 draw."""
    top: float | None = None
    """Replaces the top spin."""


@dataclass(frozen=True, slots=True)
class PlayerSpread:
    """How strokes of a player scatter: standard deviations."""

    speed: float = 0.0
    """Of the speed, as a share of it."""
    angle: float = 0.0
    """Of the direction, degrees."""

    def draw(self, rng: np.random.Generator, count: int) -> FloatArray:
        """Draw factors of the speed and turns (degrees) of strokes (count, 2)."""
        drawn = rng.standard_normal((count, 2)) * [self.speed, self.angle]
        return np.column_stack([np.maximum(1.0 + drawn[:, 0], 0.05), drawn[:, 1]])


def measure_stroke(state: FloatArray, radius: float) -> tuple[float, float, float]:
    """Measure a stroke by the state of the struck ball.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s) after the strike.
        radius: m, of the ball.

    Returns:
        Speed in m/s, side spin (> 0 to the right) and top spin (1 rolls) as shares: R omega over the speed.
    """
    speed = max(float(np.hypot(*state[2:4])), MIN_SPEED)
    along = state[2:4] / speed if np.any(state[2:4]) else np.array([1.0, 0.0])
    top = radius * float(state[4:6] @ np.array([-along[1], along[0]])) / speed
    return speed, -radius * float(state[6]) / speed, top


def change_stroke(state: FloatArray, radius: float, change: StrokeChange, factor: float, turn: float) -> FloatArray:
    """Change the state of a struck ball; a change of speed or direction keeps the shares of spin.

    Args:
        state: (7,) x, y (m), vx, vy (m/s), wx, wy, wz (rad/s) after the strike.
        radius: m, of the ball.
        change: How the stroke differs from the real one.
        factor: Further factor of the speed, of one stroke of the player.
        turn: Further turn of the direction, degrees to the right.

    Returns:
        (7,) state.
    """
    before, side, top = measure_stroke(state, radius)
    speed = before * change.speed_factor if change.speed is None else change.speed
    speed = max(speed * factor, MIN_SPEED)
    angle = np.radians(change.angle + turn)
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    along = state[2:4] / before if np.any(state[2:4]) else np.array([1.0, 0.0])
    rolling_axis = np.array([-along[1], along[0]])
    spin = state[4:6] / before
    wanted_top = top + change.top_added if change.top is None else change.top
    wanted_side = side + change.side_added if change.side is None else change.side
    changed = state.copy()
    changed[2:4] = speed * (rotation @ along)
    changed[4:6] = speed * (rotation @ (spin + (wanted_top - top) / radius * rolling_axis))
    changed[6] = -wanted_side * speed / radius
    return changed


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
        unsure = "no stroke of this clip is at least 50 % probable; choose a clip that begins before the stroke"
        raise TrackError(unsure if fit.moving.any() else NO_STROKE)
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


Game = Literal["pot", "carom", "three-cushion"]
GAMES: tuple[Game, ...] = ("pot", "carom", "three-cushion")
# Cushions that the cue ball must touch before it meets the second ball.
CUSHIONS_NEEDED = {"carom": 0, "three-cushion": 3}


@dataclass(frozen=True, slots=True)
class ShotGoal:
    """What a shot must do to score."""

    game: Game
    ball: str = ""
    """The only ball that counts when potted; empty: any ball but the cue ball."""
    pocket: str = ""
    """The only pocket that counts; empty: any."""


def group_by_ball(
    events: Iterable[tuple[float, EventKey]], ids: Sequence[str]
) -> tuple[tuple[tuple[float, EventKey], ...], ...]:
    """Group contacts by the balls that they concern.

    Args:
        events: Times (s) and events, in the order of time; only contacts of balls, cushions and pockets count.
        ids: (N,) names of the balls.

    Returns:
        (N,) contacts of each ball, which is named first in each of them.
    """
    contacts: dict[str, list[tuple[float, EventKey]]] = {name: [] for name in ids}
    for t, (kind, a, b) in events:
        if kind in ("ball", "cushion", "pocket") and a in contacts:
            contacts[a].append((t, (kind, a, b)))
        if kind == "ball" and b in contacts:
            contacts[b].append((t, (kind, b, a)))
    return tuple(tuple(own) for own in contacts.values())


def is_scored(
    contacts: Sequence[Sequence[tuple[float, EventKey]]], ids: Sequence[str], cue: int, goal: ShotGoal
) -> bool:
    """Decide whether a shot scores.

    Args:
        contacts: (N,) times (s) and events of each ball, in the order of time.
        ids: (N,) names of the balls.
        cue: Index of the struck ball.
        goal: What must happen. A potted cue ball never scores.

    Returns:
        Whether it does.
    """
    own = [event for _, event in contacts[cue]]
    if any(kind == "pocket" for kind, _, _ in own):
        return False
    if goal.game == "pot":
        return any(
            kind == "pocket" and goal.ball in ("", name) and goal.pocket in ("", place)
            for ball in contacts
            for _, (kind, name, place) in ball
        )
    touched: set[str] = set()
    cushions = 0
    for kind, _, other in own:
        if kind == "cushion":
            cushions += 1
        elif kind == "ball" and other not in touched:
            touched.add(other)
            if len(touched) == len(ids) - 1:
                return cushions >= CUSHIONS_NEEDED[goal.game]
    return False


# s that a shot is simulated: all balls rest by then.
LONGEST_SHOT = 15.0


@dataclass(frozen=True, slots=True)
class ChangedShot:
    """M plays of one shot of N balls at T times."""

    t: FloatArray
    """(T,) s after the strike."""
    members: FloatArray
    """(M, T, N, 2) m; NaN once a ball is potted."""
    events: tuple[PredictedEvent, ...]
    """Events that may happen, in the order of time, s after the strike."""
    scored: NDArray[np.bool_]
    """(M,) which plays score."""

    @property
    def probability(self) -> float:
        """Probability that the shot scores, with a Jeffreys prior, so that no finite ensemble is certain."""
        return float((self.scored.sum() + 0.5) / (len(self.scored) + 1.0))

    @property
    def probability_sigma(self) -> float:
        """Standard deviation of `probability` by the size of the ensemble."""
        p = self.probability
        return float(np.sqrt(p * (1 - p) / (len(self.scored) + 2.0)))


def play_changed_shot(
    ensemble: StruckEnsemble, change: StrokeChange, spread: PlayerSpread, goal: ShotGoal, t: FloatArray, seed: int
) -> ChangedShot:
    """Play every member of an ensemble with a changed stroke.

    The same seed gives the same strokes of the player, so that two changes compare.

    Args:
        ensemble: The shot at its strike.
        change: How the stroke differs from the real one.
        spread: Scatter of the player's strokes.
        goal: What must happen to score.
        t: (T,) s after the strike, ascending; paths at these times.
        seed: Random seed of the player's strokes.

    Returns:
        The plays.
    """
    strokes = spread.draw(np.random.default_rng([seed, 1]), len(ensemble.members))
    paths, order, scored = [], [], []
    for member, (factor, turn) in zip(ensemble.members, strokes, strict=True):
        state = member.balls.state.copy()
        radius = float(member.balls.radius[ensemble.cue])
        state[ensemble.cue] = change_stroke(state[ensemble.cue], radius, change, float(factor), float(turn))
        run = member.simulate_from(state, ensemble.table, LONGEST_SHOT)
        contacts = list_contacts(run)
        paths.append(run.states_at(t)[..., :2])
        order.append(contacts)
        scored.append(is_scored(contacts, ensemble.ids, ensemble.cue, goal))
    events = summarize_events(ensemble.ids, 0.0, order, {})
    return ChangedShot(t, np.stack(paths), events, np.array(scored, bool))
