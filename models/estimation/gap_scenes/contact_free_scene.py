"""A scene without contacts for the diagnosis: bodies that move independently under a given acceleration.

Every body is integrated by Runge-Kutta steps from its own start; derivatives by start and parameters come from complex
steps of the same computation (Squire, Trapp 1998, doi:10.1137/S003614459631241X), exact to rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numba
import numpy as np
from numpy.typing import NDArray

from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates, Recording
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, SimulatedWindow, Window
from models.physics.effect import Effect, EffectKind, Prior

RealOrComplexArray = NDArray[np.float64] | NDArray[np.complex128]
AccelerationFunction = Callable[[RealOrComplexArray, RealOrComplexArray, RealOrComplexArray, RealOrComplexArray], None]
"""Fills the acceleration (D,) from position (D,), velocity (D,) and parameters (P,); compiled, for real and complex."""
Integrator = Callable[[RealOrComplexArray, RealOrComplexArray, FloatArray, float], RealOrComplexArray]

MAX_STEP = 1 / 200
"""s of one step: the fourth-order error of a pendulum of 1 Hz is then below 1e-8 in a second."""
MAX_STEPS_PER_ROW = 400
"""Steps between two rows, at most: rows that are further apart than 2 s resolve no motion, and the times of a recording
in another unit must not make a simulation endless."""
_COMPLEX_STEP = 1e-30
_GUESS_ROWS = 12
"""Rows from which an initial guess of position and velocity is estimated."""


@dataclass(frozen=True, slots=True)
class SceneEffect:
    """An effect of a scene without contacts."""

    name: str
    parameters: tuple[Prior, ...]
    neutral: tuple[float, ...]
    phases: tuple[str, ...]
    reference: str
    partners: tuple[str, ...] = ()
    kind: EffectKind = "physics"


def build_brake_probe(unit: str, phase: str) -> SceneEffect:
    """Build a probe for an unnamed brake: minus the direction of motion times a cubic in speed.

    If it explains more than the named effects, the library lacks a law of resistance.
    """
    powers = tuple(
        Prior(f"c{n}", f"{unit}^{1 - n} s^{n - 2}", 0.0, sigma, False, (-100.0, 100.0))
        for n, sigma in enumerate((1.0, 0.5, 0.2, 0.05))
    )
    return SceneEffect(BRAKE_PROBE, powers, (0.0,) * len(powers), (phase,), "a cubic in speed", (), "probe")


BRAKE_PROBE = "brake_over_speed"
_BRAKE_FADE_SPEED = 0.01
"""m/s or rad/s below which the probe vanishes."""


def compile_closure(function: Callable[..., Any]) -> Any:
    """Compile a function that uses values of its enclosing function; every process compiles it again."""
    return numba.njit(error_model="numpy", nogil=True)(function)


@cache
def build_integrator(acceleration: AccelerationFunction, has_brake_probe: bool = False) -> Integrator:
    """Build a compiled integrator of an acceleration.

    Args:
        acceleration: Acceleration of one body.
        has_brake_probe: Whether the last four parameters are those of `build_brake_probe`.

    Returns:
        Function of n starts (2D, n), n sets of parameters (P, n), times (T,) s and a step limit (s), to states (T, 2D,
        n).
    """

    @compile_closure
    def march(start, parameters, t, longest):  # type: ignore[no-untyped-def]
        size, count = start.shape
        half = size // 2
        states = np.empty((len(t), size, count), start.dtype)
        now, at, rate, sum_of_rates = np.empty((4, size), start.dtype)
        for i in range(count):
            p = parameters[:, i].copy()
            probe = p[-4:]
            braked = has_brake_probe and (probe != 0).any()
            now[:] = start[:, i]
            states[0, :, i] = now
            for k in range(1, len(t)):
                steps = int(min(np.ceil((t[k] - t[k - 1]) / longest - 1e-9), MAX_STEPS_PER_ROW))
                h = (t[k] - t[k - 1]) / steps
                for _ in range(steps):
                    sum_of_rates[:] = 0.0
                    for stage in range(4):
                        part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                        for d in range(size):
                            at[d] = now[d] + part * rate[d] if stage else now[d]
                        for d in range(half):
                            rate[d] = at[half + d]
                        acceleration(at[:half], at[half:], p, rate[half:])
                        if braked:
                            square = 0 * p[0] + _BRAKE_FADE_SPEED**2
                            for d in range(half, size):
                                square += at[d] * at[d]
                            speed = np.sqrt(square)
                            brake = probe[0] / speed + probe[1] + probe[2] * speed + probe[3] * speed * speed
                            for d in range(half, size):
                                rate[d] -= brake * at[d]
                        weight = 2.0 if stage == 1 or stage == 2 else 1.0
                        for d in range(size):
                            sum_of_rates[d] += weight * rate[d]
                    for d in range(size):
                        now[d] += h / 6 * sum_of_rates[d]
                states[k, :, i] = now
        return states

    integrator: Integrator = march
    return integrator


@dataclass(frozen=True)
class ContactFreeScene:
    """A scene of bodies that do not touch each other."""

    name: str
    unit: str
    phase: str
    effects: tuple[Effect, ...]
    simulator_effects: tuple[str, ...]
    integrate: Integrator
    not_tested: tuple[str, ...] = ()
    gauges: tuple[str, ...] = ("frame_rate", "time_offset")
    alternatives: tuple[Alternatives, ...] = ()

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
        states = self._simulate_states(segment, start, shared)
        half = states.shape[1] // 2
        place, velocity = states[rows, :half, bodies], states[rows, half:, bodies]
        return Covariates((self.phase,) * len(rows), place, velocity, np.full(len(rows), np.nan), None)

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        """Predict the positions (T, N, D) of every body at every row of a segment."""
        states = self._simulate_states(segment, start, shared)
        return np.asarray(np.moveaxis(states[:, : states.shape[1] // 2], 1, 2))

    def _simulate_states(self, segment: Recording, start: FloatArray, shared: FloatArray) -> FloatArray:
        """Simulate the states (T, 2D, N) of all bodies."""
        bodies = len(segment.bodies)
        starts = np.ascontiguousarray(start.reshape(bodies, -1).T)
        parameters = np.repeat(np.asarray(shared, np.float64)[:, None], bodies, axis=1)
        return np.asarray(self.integrate(starts, parameters, segment.t, MAX_STEP), np.float64)


@dataclass(frozen=True)
class ContactFreeModel:
    """Multiple-shooting model of a contact-free scene; the state of a window is position and velocity of every body."""

    scene: ContactFreeScene
    segments: tuple[Recording, ...]
    jacobian_mask: BoolArray
    windows: tuple[Window, ...] = field(init=False)
    """One window per segment."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(_build_window(segment) for segment in self.segments))

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
        flat = self.scene.integrate(starts.reshape(size, -1), parameters.reshape(len(shared), -1), segment.t, MAX_STEP)
        states = np.asarray(flat, np.complex128).reshape(len(segment.t), size, bodies, columns)
        return self._build_linearization(segment, states[:, : size // 2], size, needed, len(shared))

    def simulate(self, window: int, start: FloatArray, shared: FloatArray) -> SimulatedWindow:
        """Simulate a window without Jacobians."""
        segment = self.segments[window]
        with np.errstate(over="ignore", invalid="ignore"):  # a diverging trial is rejected
            places = self.scene.predict_positions(segment, start, shared, ())
            rows, who = np.nonzero(segment.is_observed)
            residual = (places[rows, who] - segment.positions[rows, who]) / segment.sigma[rows, who][:, None]
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


def _build_window(segment: Recording) -> Window:
    rows, who = np.nonzero(segment.is_observed)
    start = np.concatenate([_estimate_initial_state(segment, body) for body in range(len(segment.bodies))])
    return Window(segment.shot, segment.t[rows], who.astype(np.int64), start, np.full(len(start), np.inf))


def _estimate_initial_state(segment: Recording, body: int) -> FloatArray:
    """Estimate position and velocity (2D,) at the first row, by a line or parabola through the first observed rows."""
    own = np.flatnonzero(segment.is_observed[:, body])[:_GUESS_ROWS]
    degree = min(2 if len(own) >= 8 else 1, len(own) - 1)
    line = np.polynomial.polynomial.polyfit(segment.t[own] - segment.t[0], segment.positions[own, body], degree)
    return np.concatenate([line[0], line[1] if degree else np.zeros_like(line[0])])
