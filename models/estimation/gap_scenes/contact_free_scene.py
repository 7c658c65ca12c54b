"""A scene of bodies that do not touch each other, for the diagnosis: each moves under a given acceleration.

Known inputs may act, and walls may reflect the bodies, see `models.estimation.gap_scenes.motion_integrator`.
Derivatives by start and parameters come from complex steps of the same computation, exact to rounding.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates
from models.estimation.gap_scenes.motion_integrator import MAX_STEP, Integrator, RealOrComplexArray
from models.estimation.multiple_shooting.shooting_problem import LEAST_GAIN
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, SimulatedWindow, Window
from models.physics.effect import Effect, Prior

BRAKE_PROBE = "brake_over_speed"
_COMPLEX_STEP = 1e-30
# Rows from which an initial guess of position and velocity is estimated.
_GUESS_ROWS = 12
# The same for a further guess where a wall may be met within the first rows.
_SHORT_GUESS_ROWS = 4
# s for which an observation counts as affected by a contact with a wall.
_CONTACT_DURATION = 0.25


def build_brake_probe(unit: str, phase: str) -> Effect:
    """Build a probe for an unnamed brake: minus the direction of motion times a cubic in speed.

    If it explains more than the named effects, the library lacks a law of resistance.
    """
    powers = tuple(
        Prior(f"c{n}", f"{unit}^{1 - n} s^{n - 2}", 0.0, sigma, False, (-100.0, 100.0))
        for n, sigma in enumerate((1.0, 0.5, 0.2, 0.05))
    )
    return Effect(BRAKE_PROBE, powers, (0.0,) * len(powers), (phase,), "a cubic in speed", (), "probe")


@dataclass(frozen=True)
class ContactFreeScene:
    """A scene of bodies that do not touch each other."""

    name: str
    phase: str
    effects: tuple[Effect, ...]
    simulator_effects: tuple[str, ...]
    integrate: Integrator
    not_tested: tuple[str, ...] = ()
    gauges: tuple[str, ...] = ("frame_rate", "time_offset")
    alternatives: tuple[Alternatives, ...] = ()
    input_count: int = 0
    """Number of known inputs that the acceleration takes."""
    walls: tuple[tuple[float, float], ...] = ()
    """Lower and upper limit of each coordinate; empty where there are no walls."""
    is_smooth: bool = False
    """Whether a path is a smooth function of its start and of the parameters: no wall, no standstill, no chaos."""
    least_gain: float = LEAST_GAIN
    has_stated_values: bool = False

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        """Return the whole recording, or nothing where a body was never observed."""
        return (recording,) if recording.is_observed.any(axis=0).all() else ()

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> ContactFreeModel:
        """Build a model with one window per segment."""
        everything = np.ones(sum(len(effect.parameters) for effect in self.effects), bool)
        return ContactFreeModel(self, segments, everything if jacobian_mask is None else jacobian_mask)

    def observation_covariates(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> Covariates:
        """Compute the covariates of the observations of a segment, from a simulation."""
        rows, bodies = np.nonzero(segment.is_observed)
        states, contacts = self._simulate_states(segment, start, shared)
        half = states.shape[1] // 2
        moving = self.observe(segment, states[:, :half] + 1j * _COMPLEX_STEP * states[:, half:])[rows, :, bodies]
        place, velocity = moving.real, moving.imag / _COMPLEX_STEP
        since = segment.t[rows] - contacts[rows, bodies]
        phases = tuple("wall_contact" if one < _CONTACT_DURATION else self.phase for one in since)
        return Covariates(phases, place, velocity, since, None)

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        """Predict the positions (T, N, D) of every body at every row of a segment."""
        states, _ = self._simulate_states(segment, start, shared)
        return np.asarray(np.moveaxis(self.observe(segment, states[:, : states.shape[1] // 2]), 1, 2))

    def observe(self, segment: Recording, places: RealOrComplexArray) -> RealOrComplexArray:
        """Return what is observed (T, D, N, ...) of places (T, D, N, ...): here, the places themselves."""
        return places

    def guess_starts(self, segment: Recording, count: int) -> tuple[FloatArray, FloatArray]:
        """Guess the states (2D N,) at the first row by `count` observed rows, and the errors of a prior about them."""
        start = estimate_first_states(segment, count)
        return start, np.full(len(start), np.inf)

    def integrate_segment(
        self, segment: Recording, starts: RealOrComplexArray, parameters: RealOrComplexArray
    ) -> tuple[RealOrComplexArray, FloatArray]:
        """Integrate the bodies of a segment, each from the same number of starts.

        Args:
            segment: Segment of a recording with N bodies.
            starts: (2D, n) states, body by body.
            parameters: (P, n) parameters.

        Returns:
            (T, 2D, n) states, and (T, n) s, the time of the last contact with a wall, NaN where there was none.
        """
        bodies = len(segment.bodies)
        inputs = np.zeros((bodies, 0, self.input_count, 2))
        if segment.inputs is not None:
            inputs = np.ascontiguousarray(np.moveaxis(segment.inputs, 1, 0))
        walls = np.array(self.walls).reshape(-1, 2)
        return self.integrate(starts, parameters, segment.t, MAX_STEP, walls, inputs)

    def _simulate_states(
        self, segment: Recording, start: FloatArray, shared: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Simulate the states (T, 2D, N) of all bodies, and the times (T, N) of their last contacts."""
        bodies = len(segment.bodies)
        starts = np.ascontiguousarray(start.reshape(bodies, -1).T)
        parameters = np.repeat(np.asarray(shared, np.float64)[:, None], bodies, axis=1)
        states, contacts = self.integrate_segment(segment, starts, parameters)
        return np.asarray(states, np.float64), contacts


@dataclass(frozen=True)
class ContactFreeModel:
    """Multiple-shooting model of a contact-free scene; the state of a window is position and velocity of every body."""

    scene: ContactFreeScene
    segments: tuple[Recording, ...]
    jacobian_mask: BoolArray
    windows: tuple[Window, ...] = field(init=False)
    """One window per segment."""

    def __post_init__(self) -> None:
        windows = tuple(_build_window(segment, self.scene) for segment in self.segments)
        object.__setattr__(self, "windows", windows)

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        """Priors of the parameters of all effects."""
        return tuple(prior for effect in self.scene.effects for prior in effect.parameters)

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        """Simulate a window with complex steps, which give the Jacobians."""
        segment = self.segments[window]
        bodies, needed = len(segment.bodies), np.flatnonzero(self.jacobian_mask)
        size = len(start) // bodies
        columns = size + len(needed)
        # bodies do not touch: each depends on its own start and on the shared parameters only
        starts = np.repeat(start.reshape(bodies, size).T[:, :, None], columns, axis=2).astype(np.complex128)
        parameters = np.repeat(shared[:, None, None], bodies, axis=1).repeat(columns, axis=2).astype(np.complex128)
        starts[np.arange(size), :, np.arange(size)] += 1j * _COMPLEX_STEP
        parameters[needed, :, size + np.arange(len(needed))] += 1j * _COMPLEX_STEP
        flat, _ = self.scene.integrate_segment(segment, starts.reshape(size, -1), parameters.reshape(len(shared), -1))
        states = np.asarray(flat, np.complex128).reshape(len(segment.t), size, bodies, columns)
        places = np.asarray(self.scene.observe(segment, states[:, : size // 2]), np.complex128)
        return self._build_linearization(segment, places, size, needed, len(shared))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow:
        """Simulate a window without Jacobians."""
        segment = self.segments[window]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging trial is rejected
            residual = compare_positions(segment, self.scene.predict_positions(segment, start, shared, ()))
        return SimulatedWindow(residual, np.zeros(0))

    def _build_linearization(
        self, segment: Recording, places: NDArray[np.complex128], size: int, needed: NDArray[np.int64], shared: int
    ) -> LinearizedWindow:
        """Collect residuals and Jacobians from positions (T, D, N, columns) with imaginary parts as derivatives."""
        rows, who = np.nonzero(segment.is_observed)
        sigma = segment.sigma[rows, who]
        predicted = places[rows, :, who]  # (K, D, columns)
        with np.errstate(over="ignore"):  # a diverging trial has infinite derivatives, and is rejected
            slopes = predicted.imag / _COMPLEX_STEP / sigma[:, None, None]
        coordinates, bodies = places.shape[1], len(segment.bodies)
        by_start = np.zeros((len(rows), coordinates, bodies, size))
        by_start[np.arange(len(rows)), :, who] = slopes[:, :, :size]
        by_shared = np.zeros((len(rows), coordinates, shared))
        by_shared[:, :, needed] = slopes[:, :, size:]
        residual = (predicted[:, :, 0].real - segment.positions[rows, who]) / sigma[:, None]
        nothing = np.zeros(0)
        return LinearizedWindow(
            residual, by_start.reshape(len(rows), coordinates, -1), by_shared,
            nothing, nothing.reshape(0, bodies * size), nothing.reshape(0, shared),
        )  # fmt: skip


def compare_positions(segment: Recording, places: FloatArray) -> FloatArray:
    """Compare positions (T, N, D) with the observations of a segment: (K, D), in standard deviations."""
    rows, who = np.nonzero(segment.is_observed)
    return np.asarray((places[rows, who] - segment.positions[rows, who]) / segment.sigma[rows, who][:, None])


def _build_window(segment: Recording, scene: ContactFreeScene) -> Window:
    """Build the window of a segment; a wall that is met within the first rows spoils the usual guess."""
    rows, who = np.nonzero(segment.is_observed)
    start, sigma = scene.guess_starts(segment, _GUESS_ROWS)
    others = (scene.guess_starts(segment, _SHORT_GUESS_ROWS)[0],) if scene.walls else ()
    window = Window(segment.shot, segment.t[rows], who.astype(np.int64), start, sigma)
    return replace(window, alternative_starts=others)


def estimate_first_states(segment: Recording, count: int) -> FloatArray:
    """Estimate the positions and velocities of all bodies at the first row of a segment.

    Args:
        segment: Segment of a recording.
        count: Number of observed rows that are used.

    Returns:
        (2D N,) body by body, its position before its velocity.
    """
    return np.concatenate([_estimate_initial_state(segment, body, count) for body in range(len(segment.bodies))])


def _estimate_initial_state(segment: Recording, body: int, count: int) -> FloatArray:
    """Estimate position and velocity (2D,) at the first row, by a line or parabola through the first observed rows."""
    own = np.flatnonzero(segment.is_observed[:, body])[:count]
    degree = min(2 if len(own) >= 8 else 1, len(own) - 1)
    line = np.polynomial.polynomial.polyfit(segment.t[own] - segment.t[0], segment.positions[own, body], degree)
    return np.concatenate([line[0], line[1] if degree else np.zeros_like(line[0])])
