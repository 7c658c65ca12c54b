"""A scene without contacts for the diagnosis: bodies that move on their own under a force that a scene names.

Every body is followed by Runge-Kutta steps from its own start; derivatives by start and parameters come from complex
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
from models.estimation.multiple_shooting.shooting_windows import Flow, Glance, Window
from models.physics.effect import Effect, EffectKind, Prior

Numbers = NDArray[np.float64] | NDArray[np.complex128]
Force = Callable[[Numbers, Numbers, Numbers, Numbers], None]
"""(place (D,), velocity (D,), parameters (P,), acceleration (D,) to be filled); compiled, for real and complex."""
March = Callable[[Numbers, Numbers, FloatArray, float], Numbers]

LONGEST = 1 / 200
"""s of one step: the fourth-order error of a pendulum of 1 Hz is then below 1e-8 in a second."""
_STEP = 1e-30
_FIRST = 12
"""rows from which a first guess of place and velocity is taken."""


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


def brake_probe(unit: str, phase: str) -> SceneEffect:
    """A brake of any law: minus the direction of motion times a cubic in speed, which no library needs to name.

    What it explains beside the effects that are named is a law that the library lacks.
    """
    powers = tuple(
        Prior(f"c{n}", f"{unit}^{1 - n} s^{n - 2}", 0.0, sigma, False, (-100.0, 100.0))
        for n, sigma in enumerate((1.0, 0.5, 0.2, 0.05))
    )
    return SceneEffect(BRAKE, powers, (0.0,) * len(powers), (phase,), "a cubic in speed", (), "probe")


BRAKE = "brake_over_speed"
_CREEP = 0.01
"""m/s or rad/s below which the probe fades out."""


def compiled_here(function: Callable[..., Any]) -> Any:
    """Decorator of a function that holds values of the one around it: every process compiles it anew."""
    return numba.njit(error_model="numpy", nogil=True)(function)


@cache
def marcher(force: Force, probed: bool = False) -> March:
    """States (T, 2D, n) from n starts (2D, n) with n sets of parameters (P, n), at t (T,), in steps of at most so
    many seconds; the last four parameters are those of a `brake_probe` where there is one."""

    @compiled_here
    def march(start, parameters, t, longest):  # type: ignore[no-untyped-def]
        size, count = start.shape
        half = size // 2
        states = np.empty((len(t), size, count), start.dtype)
        now, at, rate, sum_of_rates = np.empty((4, size), start.dtype)
        for i in range(count):
            p = parameters[:, i].copy()
            probe = p[-4:]
            braked = probed and (probe != 0).any()
            now[:] = start[:, i]
            states[0, :, i] = now
            for k in range(1, len(t)):
                steps = int(np.ceil((t[k] - t[k - 1]) / longest - 1e-9))
                h = (t[k] - t[k - 1]) / steps
                for _ in range(steps):
                    sum_of_rates[:] = 0.0
                    for stage in range(4):
                        part = 0.0 if stage == 0 else (h if stage == 3 else 0.5 * h)
                        for d in range(size):
                            at[d] = now[d] + part * rate[d] if stage else now[d]
                        for d in range(half):
                            rate[d] = at[half + d]
                        force(at[:half], at[half:], p, rate[half:])
                        if braked:
                            square = 0 * p[0] + _CREEP**2
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

    found: March = march
    return found


@dataclass(frozen=True)
class SmoothScene:
    """A scene of bodies that do not touch."""

    name: str
    unit: str
    phase: str
    effects: tuple[Effect, ...]
    assumed: tuple[str, ...]
    march: March
    not_tested: tuple[str, ...] = ()
    gauges: tuple[str, ...] = ("frame_rate", "time_offset")
    alternatives: tuple[Alternatives, ...] = ()

    def stretches(self, recording: Recording) -> tuple[Recording, ...]:
        return (recording,) if recording.seen.any(axis=0).all() else ()

    def model(
        self, pieces: tuple[Recording, ...], forms: tuple[str, ...], wanted: BoolArray | None = None
    ) -> SmoothModel:
        everything = np.ones(sum(len(effect.parameters) for effect in self.effects), bool)
        return SmoothModel(self, pieces, everything if wanted is None else wanted)

    def covariates(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> Covariates:
        rows, bodies = np.nonzero(piece.seen)
        states = self._states(piece, start, shared)
        half = states.shape[1] // 2
        place, velocity = states[rows, :half, bodies], states[rows, half:, bodies]
        return Covariates((self.phase,) * len(rows), place, velocity, np.full(len(rows), np.nan), None)

    def predict(self, piece: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]) -> FloatArray:
        states = self._states(piece, start, shared)
        return np.asarray(np.moveaxis(states[:, : states.shape[1] // 2], 1, 2))

    def _states(self, piece: Recording, start: FloatArray, shared: FloatArray) -> FloatArray:
        """(T, 2D, N)"""
        bodies = len(piece.bodies)
        starts = np.ascontiguousarray(start.reshape(bodies, -1).T)
        parameters = np.repeat(np.asarray(shared, np.float64)[:, None], bodies, axis=1)
        return np.asarray(self.march(starts, parameters, piece.t, LONGEST), np.float64)


@dataclass(frozen=True)
class SmoothModel:
    """A smooth scene as the fit by shooting asks for it; the state of a window is place and velocity of every body."""

    scene: SmoothScene
    pieces: tuple[Recording, ...]
    wanted: BoolArray
    windows: tuple[Window, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(_window(piece) for piece in self.pieces))

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        return tuple(prior for effect in self.scene.effects for prior in effect.parameters)

    def flow(self, window: int, start: FloatArray, shared: FloatArray) -> Flow:
        piece = self.pieces[window]
        bodies, asked = len(piece.bodies), np.flatnonzero(self.wanted)
        size = len(start) // bodies
        columns = size + len(asked)
        # bodies do not touch: each hangs on its own start and on what all share
        starts = np.repeat(start.reshape(bodies, size).T[:, :, None], columns, axis=2).astype(np.complex128)
        parameters = np.repeat(shared[:, None, None], bodies, axis=1).repeat(columns, axis=2).astype(np.complex128)
        starts[np.arange(size), :, np.arange(size)] += 1j * _STEP
        parameters[asked, :, size + np.arange(len(asked))] += 1j * _STEP
        flat = self.scene.march(starts.reshape(size, -1), parameters.reshape(len(shared), -1), piece.t, LONGEST)
        states = np.asarray(flat, np.complex128).reshape(len(piece.t), size, bodies, columns)
        return self._flow(piece, states[:, : size // 2], size, asked, len(shared))

    def glance(self, window: int, start: FloatArray, shared: FloatArray) -> Glance:
        piece = self.pieces[window]
        with np.errstate(over="ignore", invalid="ignore"):  # a trial that flies off is rejected
            places = self.scene.predict(piece, start, shared, ())
            rows, who = np.nonzero(piece.seen)
            misfit = (places[rows, who] - piece.places[rows, who]) / piece.sigma[rows, who][:, None]
        return Glance(misfit, np.zeros(0))

    def _flow(
        self, piece: Recording, places: NDArray[np.complex128], size: int, asked: NDArray[np.int64], shared: int
    ) -> Flow:
        """From places (T, D, N, columns) with derivatives in their imaginary parts."""
        rows, who = np.nonzero(piece.seen)
        sigma = piece.sigma[rows, who]
        seen = places[rows, :, who]  # (K, D, columns)
        with np.errstate(over="ignore"):  # a trial that flies off has infinite slopes, and is rejected
            slopes = seen.imag / _STEP / sigma[:, None, None]
        coordinates, bodies = places.shape[1], len(piece.bodies)
        by_start = np.zeros((len(rows), coordinates, bodies, size))
        by_start[np.arange(len(rows)), :, who] = slopes[:, :, :size]
        by_shared = np.zeros((len(rows), coordinates, shared))
        by_shared[:, :, asked] = slopes[:, :, size:]
        misfit = (seen[:, :, 0].real - piece.places[rows, who]) / sigma[:, None]
        nothing = np.zeros(0)
        return Flow(
            misfit, by_start.reshape(len(rows), coordinates, -1), by_shared,
            nothing, nothing.reshape(0, bodies * size), nothing.reshape(0, shared),
        )  # fmt: skip


def _window(piece: Recording) -> Window:
    rows, who = np.nonzero(piece.seen)
    start = np.concatenate([_guess(piece, body) for body in range(len(piece.bodies))])
    return Window(piece.shot, piece.t[rows], who.astype(np.int64), start, np.full(len(start), np.inf))


def _guess(piece: Recording, body: int) -> FloatArray:
    """(2D,) place and velocity at the first row, from a line through the first rows seen, a parabola where many are."""
    own = np.flatnonzero(piece.seen[:, body])[:_FIRST]
    degree = min(2 if len(own) >= 8 else 1, len(own) - 1)
    line = np.polynomial.polynomial.polyfit(piece.t[own] - piece.t[0], piece.places[own, body], degree)
    return np.concatenate([line[0], line[1] if degree else np.zeros_like(line[0])])
