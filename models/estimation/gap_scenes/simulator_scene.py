"""A mechanism whose simulator comes from outside, for the diagnosis: joints are its bodies, of one coordinate each.

Derivatives by start and parameters are differences of two simulations, over a small part of the typical motion and a
tenth of the usual strength of an effect: a joint that sticks, or an input that is limited, has no useful derivative at
a point.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise, product, zip_longest
from typing import ClassVar

import numpy as np

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.contact_free_scene import compare_positions, estimate_first_states
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates, neutral_values
from models.estimation.gap_scenes.mechanism_inputs import EffectValues, InputHistory
from models.estimation.gap_scenes.outside_simulator import (
    Motions,
    OutsideSimulator,
    Stretch,
    group_joints,
    simulate_motions,
)
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, SimulatedWindow, Window
from models.physics.effect import Effect, Prior
from models.physics.mechanisms.mechanism_catalogue import MECHANISM_EFFECTS
from models.physics.mechanisms.mechanism_effect import USUAL_SHARE, Scale

# Rows from which the first state is estimated.
_GUESS_ROWS = 12
# Parts of typical positions and speeds, and of the usual strength of an effect, over which differences are taken.
_STATE_PART, _STRENGTH_PART = 1e-4, 0.1
# Least number of rows of a window, and of observations of a joint in it.
_MIN_WINDOW_ROWS, _MIN_OBSERVATIONS = 40, 2
# Relative standard deviation of a coefficient that a file of a simulator states.
_STATED_SIGMA = 0.3
# Least typical position and speed of a joint, rad or m, per s: of one that hardly moves.
_LEAST_POSITION, _LEAST_SPEED = 1e-3, 1e-3
# Standard deviation of the unobserved position and speed of a joint, in typical ones of those that are observed: a
# light link at the end moves several times as fast as the one that carries it.
_HIDDEN_RATIO = 4.0
# Share of the speed of the fastest joint from which another one moves.
_MOVING_SHARE = 0.1
# Ratio of an error to the typical motion from which a simulation has diverged: no force acts as strongly.
_DIVERGED_RATIO = 1e6
# s before and after a change of direction that belong to it.
_REVERSAL_S = 0.1


@dataclass(frozen=True, slots=True)
class StrengthParameters:
    """Where the parameters of a strength of an effect are among all P."""

    effect: str
    columns: IntArray
    """(n,) parameter of each joint, input or body of the recordings; -1 where it has none."""
    neutral: float
    """Value of those that have none."""

    def spread(self, shared: FloatArray) -> FloatArray:
        """Spread the values (P,) of all parameters over the joints, inputs or bodies (n,) of the strength."""
        return np.asarray(np.where(self.columns < 0, self.neutral, shared[self.columns]))


@dataclass(frozen=True)
class SimulatorScene:
    """A mechanism with a simulator from outside."""

    simulator: OutsideSimulator
    effects: tuple[Effect, ...]
    simulator_effects: tuple[str, ...]
    histories: Mapping[int, InputHistory]
    """Inputs by shot."""
    scales: tuple[Scale, ...]
    """Typical sizes of the joints."""
    observed: IntArray
    """(B,) joint of each body of the recordings."""
    not_tested: tuple[str, ...] = ()
    name: str = "mechanism"
    gauges: tuple[str, ...] = ("time_offset",)
    alternatives: tuple[Alternatives, ...] = ()
    # A simulator from outside is slow, and where something large is missing, robust fits creep.
    least_gain: float = 3e-3
    has_stated_values: bool = True

    @cached_property
    def hidden(self) -> tuple[int, ...]:
        """Joints without a sensor, but for coordinates of free bodies."""
        joints = self.simulator.joints
        return tuple(k for k in range(len(joints)) if k not in self.observed and not joints[k].body)

    @property
    def is_smooth(self) -> bool:
        """Whether a fit needs no measures against wrong minima: windows are short; a hidden joint leaves several."""
        return not self.hidden

    @cached_property
    def members(self) -> Mapping[str, IntArray]:
        """By site: which parameters of a strength each joint (N,), input (I,) or body of the recordings (B,) has.

        -1 where it has none.
        """
        joints = self.simulator.joints
        groups, is_line = group_joints(joints)[1], np.array([not joint.body for joint in joints])
        return {
            "joint": groups,
            "line": np.where(is_line, np.cumsum(is_line) - 1, -1),
            "actuator": np.arange(len(self.simulator.inputs)),
            "sensor": np.arange(len(self.observed)),
            "sensor_body": np.unique(groups[self.observed], return_inverse=True)[1],
            "mechanism": np.zeros(1, np.int64),
        }

    @cached_property
    def strengths(self) -> tuple[StrengthParameters, ...]:
        """All strengths of all effects, in the order of the catalogue."""
        strengths, first = [], 0
        for effect in self.effects:
            own = MECHANISM_EFFECTS[effect.name]
            names = [own.split_parameter(one.name) for one in effect.parameters]
            for one in own.list_strengths(effect.name in self.simulator.own_effects):
                members = self.members[own.site]
                rows = [first + k for k, (name, _) in enumerate(names) if name == one.name]
                if len(rows) <= members.max():  # some actuators have nothing of the kind
                    at = [names[row - first][1] for row in rows]
                    members = np.array([at.index(name) if name in at else -1 for name in self.simulator.inputs])
                columns = np.where(members < 0, -1, np.array([*rows, -1])[members])
                neutral = one.neutral(Scale("")) if own.site == "actuator" else 0.0
                strengths.append(StrengthParameters(effect.name, columns, neutral))
            first += len(names)
        return tuple(strengths)

    @cached_property
    def trees(self) -> IntArray:
        """(N,) trees of the joints."""
        return np.array([joint.tree for joint in self.simulator.joints])

    @cached_property
    def parameter_trees(self) -> IntArray:
        """(P,) tree whose motion alone a parameter changes; -1 for several."""
        trees = np.full(len(self.neutral), -1)
        driven = np.array([drive.joint for drive in self.simulator.drives], np.int64)
        by_site = {
            **dict.fromkeys(("joint", "line"), self.trees),
            **dict.fromkeys(("sensor", "sensor_body"), self.trees[self.observed]),
            "actuator": np.where(driven < 0, -1, self.trees[driven]),
        }
        for one in self.strengths:
            own = by_site.get(MECHANISM_EFFECTS[one.effect].site, np.zeros(0))
            for column in np.unique(one.columns[one.columns >= 0]) if len(own) == len(one.columns) else ():
                changed = np.unique(own[one.columns == column])
                trees[column] = changed[0] if len(changed) == 1 else -1
        return trees

    @cached_property
    def owners(self) -> tuple[str, ...]:
        """(P,) effect of each parameter."""
        return tuple(effect.name for effect in self.effects for _ in effect.parameters)

    @cached_property
    def neutral(self) -> FloatArray:
        """(P,) neutral values of all parameters."""
        return neutral_values(self)

    @cached_property
    def priors(self) -> tuple[Prior, ...]:
        """(P,) priors of all parameters."""
        return tuple(prior for effect in self.effects for prior in effect.parameters)

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        """Split a recording into parts of half a typical period, in which every joint is observed.

        A simulator that lacks something stays near the recording for so long, whatever moves.
        """
        if len(recording.t) < 2:
            return ()
        fastest = max(scale.speed for scale in self.scales)
        # noise of a joint that rests has no period
        half = np.pi * min(one.position / one.speed for one in self.scales if one.speed > _MOVING_SHARE * fastest)
        interval = float(np.median(np.diff(recording.t)))
        rows = int(np.clip(half / interval, _MIN_WINDOW_ROWS, len(recording.t)))
        borders = np.linspace(0, len(recording.t), max(len(recording.t) // rows, 1) + 1).astype(int)
        # an actuator has power all the time of a window, or never
        unpowered = np.isnan(self.histories[recording.shot].values)
        switched = np.flatnonzero((unpowered[1:] != unpowered[:-1]).any(axis=1)) + 1
        borders = np.unique(
            np.concatenate([borders, np.searchsorted(recording.t, self.histories[recording.shot].t[switched])])
        )
        parts = (recording.select_rows(first, end) for first, end in pairwise(borders.tolist()))
        return tuple(part for part in parts if (part.is_observed.sum(axis=0) >= _MIN_OBSERVATIONS).all())

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> SimulatorModel:
        """Build a model with one window per segment."""
        return SimulatorModel(
            self, segments, np.ones(len(self.neutral), bool) if jacobian_mask is None else jacobian_mask
        )

    def observation_covariates(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> Covariates:
        """Compute the covariates of the observations of a segment, from a simulation."""
        rows, bodies = np.nonzero(segment.is_observed)
        states = self.simulate_states(segment, start, shared)
        joints = self.observed[bodies]
        velocity = states[:, len(self.scales) :]
        is_reversal = find_reversals(velocity, segment.t)[rows, joints]
        phases = tuple("reversal" if one else "motion" for one in is_reversal)
        since = np.full(len(rows), np.nan)
        return Covariates(phases, states[rows, joints][:, None], velocity[rows, joints][:, None], since, None)

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        """Predict the positions (T, B, 1) of every observed joint at every row of a segment."""
        return self.observe(self.simulate_states(segment, start, shared), shared)

    def simulate_states(self, segment: Recording, start: FloatArray, shared: FloatArray) -> FloatArray:
        """Simulate the states (T, 2N) of all joints."""
        return np.asarray(self.simulate([self.plan_stretch(segment, start[None], [shared])])[0].at(segment.t)[0])

    def plan_stretch(self, segment: Recording, starts: FloatArray, shared: list[FloatArray]) -> Stretch:
        """Plan the simulation of a segment from starts (C, 2N) with parameters (P,) each."""
        span, history = (float(segment.t[0]), float(segment.t[-1])), self.histories[segment.shot]
        return Stretch(segment.shot, span, history, starts, [self._select_values(one) for one in shared])

    def simulate(self, stretches: list[Stretch]) -> list[Motions]:
        """Simulate stretches side by side."""
        return simulate_motions(self.simulator, stretches, self.scales)

    def plan_differences(
        self, segment: Recording, start: FloatArray, shared: FloatArray, needed: IntArray
    ) -> Differences:
        """Plan the differences of a segment by its start (2N,) and by needed parameters."""
        priors = self.priors
        typical = np.array([one.position for one in self.scales] + [one.speed for one in self.scales])
        steps = np.array([_STRENGTH_PART * priors[k].sigma for k in needed])
        high = np.array([priors[k].bounds[1] for k in needed])
        steps = np.where(shared[needed] + steps > high, -steps, steps)
        changes = np.concatenate([_STATE_PART * typical, steps])
        trees = np.concatenate([self.trees, self.trees, self.parameter_trees[needed]])
        runs = _share_runs(trees)
        starts, values = np.tile(start, (1 + len(runs), 1)), np.tile(shared, (1 + len(runs), 1))
        for k, columns in enumerate(runs, 1):
            for one in columns:
                if one < len(start):
                    starts[k, one] += changes[one]
                else:
                    values[k, needed[one - len(start)]] += changes[one]
        return Differences(self.plan_stretch(segment, starts, list(values)), values, changes, trees, runs)

    def linearize_positions(
        self, segment: Recording, motions: Motions, differences: Differences
    ) -> tuple[FloatArray, FloatArray]:
        """Return positions (T, B, 1) and their derivatives (T, B, 1, 2N + Q) by start and Q needed parameters."""
        changes, trees = differences.changes, differences.trees
        states = motions.at(segment.t)
        places = [self.observe(one, value) for one, value in zip(states, differences.values, strict=True)]
        derivatives = np.zeros((*places[0].shape, len(changes)))
        for k, columns in enumerate(differences.runs, 1):
            # a run beside this one that fails says nothing of the derivative
            moved = np.nan_to_num(places[k] - places[0], posinf=0.0, neginf=0.0)
            for one in columns:
                own = (self.trees[self.observed] == trees[one]) | (trees[one] < 0)
                derivatives[..., one] = moved * own[:, None] / changes[one]
        return places[0], derivatives

    def _select_values(self, shared: FloatArray) -> EffectValues:
        """Select the values of the effects that act: those that differ from neutral ones, and the simulator's own."""
        changed = {*self.simulator_effects, *(self.owners[k] for k in np.flatnonzero(shared != self.neutral))}
        values: dict[str, tuple[FloatArray, ...]] = {}
        for one in self.strengths:
            if one.effect in changed:
                values[one.effect] = (*values.get(one.effect, ()), one.spread(shared))
        return values

    def observe(self, states: FloatArray, shared: FloatArray) -> FloatArray:
        """Return what sensors measure (T, B, 1) of states (T, 2N)."""
        places = states[:, self.observed]
        sensor = {
            one.effect: one.spread(shared)
            for one in self.strengths
            if MECHANISM_EFFECTS[one.effect].kind == "observation"
        }
        places = places * sensor.get("sensor_scale", 1.0) + sensor.get("sensor_offset", 0.0)
        return np.asarray(places[:, :, None])


def leave_out_failures(
    scene: SimulatorScene, recordings: tuple[Recording, ...]
) -> tuple[tuple[Recording, ...], int, int]:
    """Leave out the windows that a simulator, as it is, cannot simulate from where they begin.

    Args:
        scene: Scene of the simulator.
        recordings: One recording per shot.

    Returns:
        The recordings with nothing observed in these windows, without those that have no other; the number of these
        windows, and that of all.
    """
    working, failed, total = [], 0, 0
    bound = _DIVERGED_RATIO * max(scale.position for scale in scene.scales)
    for one in recordings:
        model = scene.build_model(scene.split_recording(one), (), np.zeros(len(scene.neutral), bool))
        numbers, starts = range(len(model.windows)), [window.start for window in model.windows]
        ahead = model.simulate_ahead(numbers, starts, [scene.neutral] * len(starts), False)
        sizes = [
            np.abs(ahead.simulate(k, start, scene.neutral).residual[:, 0]) * segment.sigma[segment.is_observed]
            for k, start, segment in zip(numbers, starts, model.segments, strict=True)
        ]
        fails = [not (one < bound).all() for one in sizes]  # also where it is not a number
        failed, total = failed + sum(fails), total + len(fails)
        times = [segment.t for segment, is_lost in zip(model.segments, fails, strict=True) if is_lost]
        if not all(fails):
            is_lost = np.isin(one.t, np.concatenate([*times, []]))
            working.append(replace(one, positions=np.where(is_lost[:, None, None], np.nan, one.positions)))
    return tuple(working), failed, total


def find_reversals(velocity: FloatArray, t: FloatArray) -> BoolArray:
    """Return whether joints with velocities (T, N) at times t (T,) s turn back, or do so soon or just did, (T, N)."""
    turns = (np.sign(velocity[1:]) * np.sign(velocity[:-1]) < 0).astype(np.float64)
    near = max(round(_REVERSAL_S / float(np.median(np.diff(t)))), 1)
    near = min(near, (len(turns) - 1) // 2)
    counts = np.apply_along_axis(np.convolve, 0, np.vstack([turns, turns[-1:]]), np.ones(2 * near + 1), "same")
    return np.asarray(counts > 0)


def _share_runs(trees: IntArray) -> list[list[int]]:
    """Share runs between changes (C,) of different trees, for what one does to its joints the others do not change.

    Returns:
        Numbers of the changes of each run; a change of several trees (-1) has one to itself.
    """
    alone = [[column] for column in np.flatnonzero(trees < 0).tolist()]
    of_trees = [np.flatnonzero(trees == tree).tolist() for tree in np.unique(trees[trees >= 0])]
    return [[one for one in columns if one is not None] for columns in zip_longest(*of_trees)] + alone


@dataclass(frozen=True, slots=True)
class Differences:
    """Runs that derivatives of a segment by start and needed parameters are differences of; the first changes nothing.

    A run makes one or several of D changes.
    """

    stretch: Stretch
    values: FloatArray
    """(C, P) parameters of the runs."""
    changes: FloatArray
    """(D,) of the start, then of the needed parameters."""
    trees: IntArray
    """(D,) tree whose motion alone each of them changes; -1 for several."""
    runs: list[list[int]]
    """Numbers of the changes of every run but the first."""


@dataclass(frozen=True)
class SimulatorModel:
    """Multiple-shooting model of a mechanism; the state of a window is position and velocity of every joint."""

    scene: SimulatorScene
    segments: tuple[Recording, ...]
    jacobian_mask: BoolArray
    ahead: Mapping[int, Motions | tuple[Motions, Differences]] = field(default_factory=dict)
    """By window: motions that were simulated before they are asked for."""
    simulates_together: ClassVar[bool] = True

    @cached_property
    def windows(self) -> tuple[Window, ...]:
        """One window per segment."""
        return tuple(self._build_window(segment) for segment in self.segments)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the parameters of all effects."""
        return self.scene.priors

    def simulate_ahead(
        self, windows: Sequence[int], starts: Sequence[FloatArray], shared: Sequence[FloatArray], has_jacobians: bool
    ) -> SimulatorModel:
        """Return the model for these windows, starts and parameters alone, with their motions, simulated together.

        Where derivatives cost nothing beside a simulation, they come with it: most are needed in the next step.
        """
        cases = [(self.segments[k], start, values) for k, start, values in zip(windows, starts, shared, strict=True)]
        if has_jacobians or self.scene.simulator.is_free_beside_others:
            needed = np.flatnonzero(self.jacobian_mask)
            plans = [self.scene.plan_differences(*case, needed) for case in cases]
            motions = self.scene.simulate([one.stretch for one in plans])
            return replace(self, ahead=dict(zip(windows, zip(motions, plans, strict=True), strict=True)))
        stretches = [self.scene.plan_stretch(segment, start[None], [values]) for segment, start, values in cases]
        return replace(self, ahead=dict(zip(windows, self.scene.simulate(stretches), strict=True)))

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Simulate a window with differences, which give the Jacobians."""
        simulation = self.ahead.get(window)
        if not isinstance(simulation, tuple):
            return self.simulate_ahead([window], [start], [shared], True).linearize(window, start, shared)
        segment, needed = self.segments[window], np.flatnonzero(self.jacobian_mask)
        places, derivatives = self.scene.linearize_positions(segment, *simulation)
        rows, who = np.nonzero(segment.is_observed)
        derivatives = derivatives[rows, who] / segment.sigma[rows, who][:, None, None]
        by_shared = np.zeros((len(rows), 1, len(shared)))
        by_shared[:, :, needed] = derivatives[..., len(start) :]
        nothing = np.zeros(0)
        return LinearizedWindow(
            compare_positions(segment, places), derivatives[..., : len(start)],
            by_shared, nothing, nothing.reshape(0, len(start)), nothing.reshape(0, len(shared)),
        )  # fmt: skip

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow | LinearizedWindow:
        """Simulate a window, without Jacobians unless they cost nothing."""
        simulation = self.ahead.get(window)
        if isinstance(simulation, tuple):
            return self.linearize(window, start, shared)
        if simulation is None:
            return self.simulate_ahead([window], [start], [shared], False).simulate(window, start, shared)
        segment = self.segments[window]
        places = self.scene.observe(simulation.at(segment.t)[0], shared)
        return SimulatedWindow(compare_positions(segment, places), np.zeros(0))

    def without_shared_jacobian(self) -> SimulatorModel:
        """Return the model for steps of the start states alone."""
        return replace(self, jacobian_mask=np.zeros_like(self.jacobian_mask))

    def _build_window(self, segment: Recording) -> Window:
        """Build the window of a segment; joints that are not observed move about the rest of the simulator.

        They may begin on either side of it, and move either way: from one guess, some windows would end in a wrong
        minimum, and effects that imitate its misfit would be named beside the truth.
        """
        rows, who = np.nonzero(segment.is_observed)
        count, observed = len(self.scene.scales), self.scene.observed
        start = self.scene.simulator.rest.copy()
        typical = [scale.position for scale in self.scene.scales], [scale.speed for scale in self.scene.scales]
        sigma = _HIDDEN_RATIO * np.concatenate(typical)
        guess = estimate_first_states(segment, _GUESS_ROWS).reshape(-1, 2)
        start[observed], start[count + observed] = guess.T
        sigma[observed] = sigma[count + observed] = np.inf
        sides = tuple(
            start
            + (np.eye(2 * count)[k] * side + np.eye(2 * count)[count + k] * way) * np.nan_to_num(sigma, posinf=0.0)
            for k in self.scene.hidden
            for side, way in product((-1.0, 1.0), repeat=2)
        )
        return Window(segment.shot, segment.t[rows], who.astype(np.int64), start, sigma, alternative_starts=sides)


def build_simulator_scene(
    simulator: OutsideSimulator, recordings: tuple[Recording, ...], histories: Mapping[int, InputHistory]
) -> SimulatorScene:
    """Build the scene of a simulator and of recordings of its joints.

    Args:
        simulator: That of the mechanism, from outside.
        recordings: One recording per shot; each body is named after a joint.
        histories: Inputs by shot.

    Returns:
        The scene. Effects that the simulator has itself, and states other than neutral, are fitted first.
    """
    joints = [joint.name for joint in simulator.joints]
    observed = np.array([joints.index(name) for name in recordings[0].bodies], np.int64)
    scales = _measure_joint_scales(simulator, recordings, observed)
    input_scales = _measure_input_scales(simulator, histories, scales)
    scales = _add_drives(simulator, scales, input_scales)
    names, groups = group_joints(simulator.joints)
    # the fastest coordinate stands for a free body
    bodies = [
        max((scales[k] for k in np.flatnonzero(groups == g)), key=lambda one: one.speed) for g in range(len(names))
    ]
    scales = tuple(bodies[g] for g in groups)
    by_site = {
        "joint": dict(zip(names, bodies, strict=True)),
        "line": {joint.name: scale for joint, scale in zip(simulator.joints, scales, strict=True) if not joint.body},
        "sensor": {joints[k]: scales[k] for k in observed},
        "sensor_body": {names[g]: bodies[g] for g in np.unique(groups[observed])},
        "actuator": input_scales,
        "mechanism": {"": Scale("", inertia=simulator.last_mass)},
    }
    has_small_inputs = _has_small_inputs(simulator, histories, input_scales)
    effects, present, absent = [], [], []
    for name, one in sorted(MECHANISM_EFFECTS.items(), key=lambda entry: (entry[1].kind == "probe", entry[0])):
        is_hidden = one.needs_small_inputs and not has_small_inputs
        if not by_site[one.site] or is_hidden or (one.needs_simulator and name not in simulator.own_effects):
            absent.append(name)
        else:
            effect = one.for_mechanism(by_site[one.site], name in simulator.own_effects)
            stated = simulator.own_effects.get(name, effect.neutral)
            if one.site == "joint" and name in simulator.own_effects:  # stated for every joint
                firsts = np.unique(groups, return_index=True)[1]
                stated = tuple(np.reshape(stated, (-1, len(joints)))[:, firsts].ravel().tolist())
            effect, stated = _leave_out_unknown(effect, stated)
            if tuple(stated) != effect.neutral:
                present.append(name)
                effect = _take_stated(effect, stated)
            effects.append(effect)
    return SimulatorScene(simulator, tuple(effects), tuple(present), histories, scales, observed, tuple(absent))


def _leave_out_unknown(effect: Effect, stated: tuple[float, ...]) -> tuple[Effect, tuple[float, ...]]:
    """Leave out the parameters, and stated values, that a simulator states as NaN since it has nothing of the kind."""
    rows = [k for k, value in enumerate(stated) if not np.isnan(value)]
    own = tuple(effect.parameters[k] for k in rows), tuple(effect.neutral[k] for k in rows)
    return replace(effect, parameters=own[0], neutral=own[1]), tuple(stated[k] for k in rows)


def _take_stated(effect: Effect, stated: tuple[float, ...]) -> Effect:
    """Return an effect whose usual strength is what a file of a simulator states."""
    parameters = tuple(
        replace(one, value=value, sigma=max(one.sigma, _STATED_SIGMA * abs(value)),
                bounds=(min(one.bounds[0], value), max(one.bounds[1], value)))
        for one, value in zip(effect.parameters, stated, strict=True)
    )  # fmt: skip
    return replace(effect, parameters=parameters)


def _measure_joint_scales(
    simulator: OutsideSimulator, recordings: tuple[Recording, ...], observed: IntArray
) -> tuple[Scale, ...]:
    """Measure the typical motion of every joint; of one that is not observed, the mean of the others of its unit."""
    position, speed, reach = (np.full(len(simulator.joints), np.nan) for _ in range(3))
    middle = simulator.rest[: len(position)].copy()
    for body, joint in enumerate(observed):
        squares, spreads, ends = [], [], []
        for one in recordings:
            rows = np.flatnonzero(one.is_observed[:, body])
            places, t = one.positions[rows, body, 0], one.t[rows]
            step = max(len(rows) // _SPEED_STEPS, 1)
            if len(rows) > 1:
                squares.append(np.square(np.diff(places[::step]) / np.diff(t[::step])))
                spreads.append(np.square(places - places.mean()))
                ends += [places.min(), places.max()]
        if not squares:
            continue
        position[joint] = max(float(np.sqrt(np.concatenate(spreads).mean())), _LEAST_POSITION)
        speed[joint] = max(float(np.sqrt(np.concatenate(squares).mean())), _LEAST_SPEED)
        middle[joint], reach[joint] = (max(ends) + min(ends)) / 2, max((max(ends) - min(ends)) / 2, _LEAST_POSITION)
    scales = []
    for k, joint in enumerate(simulator.joints):
        alike = [other.unit == joint.unit for other in simulator.joints]
        own = [
            float(one[k] if np.isfinite(one[k]) else np.nanmean(one[alike]) if np.isfinite(one[alike]).any() else 1.0)
            for one in (position, speed, reach)
        ]
        scales.append(
            Scale(
                joint.unit, own[0], own[1], 1.0, joint.inertia, simulator.takes_forces, middle=float(middle[k]),
                reach=own[2],
            )
        )  # fmt: skip
    return tuple(scales)


def _add_drives(
    simulator: OutsideSimulator, scales: tuple[Scale, ...], input_scales: Mapping[str, Scale]
) -> tuple[Scale, ...]:
    """Add the typical forces of the actuators to the scales of their joints."""
    forces = np.zeros(len(scales))
    for name, drive in zip(simulator.inputs, simulator.drives, strict=False):
        if drive.joint >= 0 and name in input_scales:
            forces[drive.joint] += min(abs(drive.gain) * input_scales[name].position, drive.limit)
    return tuple(replace(scale, drive=float(force)) for scale, force in zip(scales, forces, strict=True))


# Steps of a recording from which typical speeds are measured: noise from sample to sample is no speed.
_SPEED_STEPS = 60


def _measure_input_scales(
    simulator: OutsideSimulator, histories: Mapping[int, InputHistory], joint_scales: tuple[Scale, ...]
) -> dict[str, Scale]:
    """Measure standard deviation and largest value of every input, and the speed of its joint.

    Nothing where all of them are always 0.
    """
    scales, acts = {}, False
    for k, name in enumerate(simulator.inputs):
        joint = simulator.servo_joints[k]
        column = np.concatenate([one.values[:, k] for one in histories.values()])
        column = column[np.isfinite(column)]
        most = float(np.abs(column).max(initial=0.0))
        acts |= most > 0
        spread = float(column.std()) if len(column) else 0.0
        unit = simulator.joints[joint].unit if joint >= 0 else "1"
        largest = most or 1.0
        position = spread if spread > _LEAST_SPREAD * most else largest
        driven = simulator.drives[k].joint if simulator.drives else -1
        joint_scale = joint_scales[driven] if driven >= 0 else Scale("")
        scales[name] = Scale(unit, position, joint_scale.speed, largest, joint_unit=joint_scale.unit)
    return scales if acts else {}


def _has_small_inputs(
    simulator: OutsideSimulator, histories: Mapping[int, InputHistory], input_scales: Mapping[str, Scale]
) -> bool:
    """Return whether a servo acts, or an input comes nearer to 0 than the usual width of a band about it."""
    return any(
        servo >= 0
        or any(
            (np.abs(one.values[:, k]) < USUAL_SHARE * input_scales[name].position).any() for one in histories.values()
        )
        for k, (name, servo) in enumerate(zip(simulator.inputs, simulator.servo_joints, strict=True))
        if name in input_scales
    )


# Share of the largest value of an input from which it changes.
_LEAST_SPREAD = 1e-6
