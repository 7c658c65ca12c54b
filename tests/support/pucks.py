"""Pucks that glide over a floor and are filmed: the plain scene on which the diagnosis is tried.

The scene integrates by one Runge-Kutta step per picture, the truth by DOP853 at 1e-10 with forces the scene has not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from support.reference_frames import PLANE

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import Alternatives, Covariates
from models.estimation.multiple_shooting.shooting_problem import LEAST_GAIN
from models.estimation.multiple_shooting.shooting_windows import LinearizedWindow, Window
from models.physics.effect import EffectKind, Prior

Force = Callable[[FloatArray, FloatArray], FloatArray]
"""Place (2,) and velocity (2,) to an acceleration (2,)."""

GRAVITY = 9.81
HALF = 1.5
"""m, half the length of the floor: unit of the lens."""
STEP = 1e-30
SLOW = 0.02
"""m/s at which friction fades, so that it has a slope at rest."""


@dataclass(frozen=True)
class Effect:
    name: str
    parameters: tuple[Prior, ...]
    neutral: tuple[float, ...]
    kind: EffectKind = "physics"
    phases: tuple[str, ...] = ("slide",)
    partners: tuple[str, ...] = ()
    reference: str = "made up"


def one(name: str, unit: str, sigma: float, low: float, high: float) -> Prior:
    return Prior(name, unit, 0.0, sigma, False, (low, high))


FRICTION = Effect("friction", (Prior("mu", "1", 0.03, 0.4, True, (0.001, 0.3)),), (0.0,))
SLOPE = Effect("slope", (one("slope_x", "mm/m", 4.0, -40, 40), one("slope_y", "mm/m", 4.0, -40, 40)), (0.0, 0.0))
AIR_DRAG = Effect("air_drag", (one("k", "1/m", 0.1, 0.0, 2.0),), (0.0,))
VISCOUS_DRAG = Effect("viscous_drag", (one("k", "1/s", 0.2, 0.0, 5.0),), (0.0,))
SIDEWAYS = Effect("sideways", (one("c", "1/s", 0.2, -3.0, 3.0),), (0.0,))
SCALE = Effect("scale", (Prior("seen", "1", 1.0, 0.02, False, (0.8, 1.2)),), (1.0,), "observation", ("image_region",))
LENS = Effect("lens_distortion", (one("k1", "1", 0.02, -0.2, 0.2),), (0.0,), "observation", ("image_region",))
CATALOGUE = (FRICTION, SLOPE, AIR_DRAG, VISCOUS_DRAG, SIDEWAYS, LENS)


FORCES = ("friction.mu", "slope.slope_x", "slope.slope_y", "air_drag.k", "viscous_drag.k", "sideways.c")


@njit(cache=True)
def acceleration(vx, vy, p):
    """Of real or complex velocities, with parameters in the order of FORCES."""
    speed = np.sqrt(vx * vx + vy * vy + SLOW**2)
    brake = p[0] * GRAVITY / speed + p[3] * speed + p[4]
    return GRAVITY * p[1] * 1e-3 - brake * vx - p[5] * vy, GRAVITY * p[2] * 1e-3 - brake * vy + p[5] * vx


def shown(x: FloatArray, y: FloatArray, p: dict) -> tuple:
    """Where a place is seen."""
    factor = p.get("scale.seen", 1.0) * (
        1 + (p.get("lens_distortion.k1", 0.0) + p.get("lens_twin.k1", 0.0)) * (x * x + y * y) / HALF**2
    )
    return x * factor, y * factor


@njit(cache=True)
def march(start, p, t):
    """States (T, 4, n) from n starts (4, n) with n sets of parameters (6, n), by Runge-Kutta steps."""
    states = np.empty((len(t), *start.shape), start.dtype)
    for i in range(start.shape[1]):
        x, y, vx, vy = start[0, i], start[1, i], start[2, i], start[3, i]
        q = p[:, i]
        for k in range(len(t)):
            if k > 0:
                h = t[k] - t[k - 1]
                ax, ay = acceleration(vx, vy, q)
                bx, by = acceleration(vx + h / 2 * ax, vy + h / 2 * ay, q)
                cx, cy = acceleration(vx + h / 2 * bx, vy + h / 2 * by, q)
                dx, dy = acceleration(vx + h * cx, vy + h * cy, q)
                x = x + h * (vx + h / 6 * (ax + bx + cx))
                y = y + h * (vy + h / 6 * (ay + by + cy))
                vx, vy = vx + h / 6 * (ax + 2 * bx + 2 * cx + dx), vy + h / 6 * (ay + 2 * by + 2 * cy + dy)
            states[k, 0, i], states[k, 1, i], states[k, 2, i], states[k, 3, i] = x, y, vx, vy
    return states


def path(start: NDArray, p: dict, t: FloatArray) -> NDArray:
    """States (T, 4, ...) from start (4, ...)."""
    flat = start.reshape(4, -1)
    each = [np.broadcast_to(np.asarray(p.get(name, 0.0), start.dtype), start.shape[1:]).reshape(-1) for name in FORCES]
    return march(flat, np.stack(each), t).reshape(len(t), *start.shape)


@dataclass(frozen=True)
class Pucks:
    """The scene, with a catalogue and what the simulator has of it."""

    effects: tuple[Effect, ...] = CATALOGUE
    simulator_effects: tuple[str, ...] = ("friction",)
    name: str = "pucks"
    alternatives: tuple[Alternatives, ...] = ()
    gauges: tuple[str, ...] = ("frame_rate",)
    is_smooth: bool = False
    least_gain: float = LEAST_GAIN
    has_stated_values: bool = False
    not_tested: tuple[str, ...] = ()

    @property
    def names(self) -> list[str]:
        return [f"{effect.name}.{prior.name}" for effect in self.effects for prior in effect.parameters]

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        return (recording,)

    def build_model(
        self, segments: tuple[Recording, ...], forms: tuple[str, ...], jacobian_mask: BoolArray | None = None
    ) -> Gliding:
        return Gliding(self, segments, np.ones(len(self.names), bool) if jacobian_mask is None else jacobian_mask)

    def observation_covariates(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> Covariates:
        rows, bodies = np.nonzero(segment.is_observed)
        states = path(start.reshape(-1, 4).T, dict(zip(self.names, shared, strict=True)), segment.t)
        place, velocity = states[rows, :2, bodies], states[rows, 2:, bodies]
        return Covariates(("slide",) * len(rows), place, velocity, np.full(len(rows), np.nan), place * 300)

    def predict_positions(
        self, segment: Recording, start: FloatArray, shared: FloatArray, forms: tuple[str, ...]
    ) -> FloatArray:
        p = dict(zip(self.names, shared, strict=True))
        states = path(start.reshape(-1, 4).T, p, segment.t)
        return np.stack(shown(states[:, 0], states[:, 1], p), axis=-1)


@dataclass(frozen=True)
class Gliding:
    scene: Pucks
    segments: tuple[Recording, ...]
    wanted: BoolArray
    windows: tuple[Window, ...] = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "windows", tuple(window_of(segment) for segment in self.segments))

    @property
    def unknowns(self) -> tuple[Prior, ...]:
        return tuple(prior for effect in self.scene.effects for prior in effect.parameters)

    def linearize(self, window: int, start: FloatArray, shared: FloatArray) -> LinearizedWindow:
        segment, bodies, names = self.segments[window], len(start) // 4, self.scene.names
        asked = np.flatnonzero(self.wanted)
        # the bodies do not touch: one column per number that a body's path hangs on
        state = np.repeat(start.reshape(bodies, 4).T[:, :, None], 4 + len(asked), axis=2).astype(np.complex128)
        for k in range(4):
            state[k, :, k] += 1j * STEP
        p = {name: np.full(4 + len(asked), value, np.complex128) for name, value in zip(names, shared, strict=True)}
        for k, number in enumerate(asked):
            p[names[number]][4 + k] += 1j * STEP
        states = path(state, p, segment.t)
        seen = np.stack(shown(states[:, 0], states[:, 1], p), axis=2)  # (T, N, 2, inputs)
        rows, who = np.nonzero(segment.is_observed)
        sigma = segment.sigma[rows, who][:, None]
        slopes = seen[rows, who].imag / STEP / sigma[:, :, None]
        by_start = np.zeros((len(rows), 2, len(start)))
        for body in range(bodies):
            by_start[who == body, :, 4 * body : 4 * body + 4] = slopes[who == body, :, :4]
        by_shared = np.zeros((len(rows), 2, len(shared)))
        by_shared[:, :, asked] = slopes[:, :, 4:]
        misfit = (seen[rows, who, :, 0].real - segment.positions[rows, who]) / sigma
        nothing = np.zeros(0)
        return LinearizedWindow(misfit, by_start, by_shared, nothing, nothing.reshape(0, len(start)),
                    nothing.reshape(0, len(shared)))  # fmt: skip


def window_of(segment: Recording) -> Window:
    rows, who = np.nonzero(segment.is_observed)
    starts = []
    for body in range(len(segment.bodies)):
        own = np.flatnonzero(segment.is_observed[:, body])[:10]
        line = np.polynomial.polynomial.polyfit(segment.t[own] - segment.t[0], segment.positions[own, body], 1)
        starts.append(np.concatenate([line[0], line[1]]))
    start = np.concatenate(starts)
    return Window(segment.shot, segment.t[rows], who, start, np.full(len(start), np.inf))


@dataclass(frozen=True)
class Filming:
    """How shots are made and seen."""

    shots: int = 12
    bodies: int = 1
    fps: float = 60.0
    seconds: float = 1.5
    sigma: float = 0.001
    """m of each coordinate."""
    correlation: float = 0.0
    outliers: float = 0.0
    missing: float = 0.0
    speeds: tuple[float, float] = (0.6, 3.0)
    one_way: bool = False


def film(rng: np.random.Generator, truth: dict, filming: Filming = Filming(), extra: Force | None = None):
    """Recordings of pucks under the effects of `truth`, and perhaps a force that no catalogue holds."""
    return tuple(_shot(rng, shot, truth, filming, extra) for shot in range(filming.shots))


def _shot(rng: np.random.Generator, shot: int, truth: dict, filming: Filming, extra: Force | None) -> Recording:
    forces = np.array([truth.get(name, 0.0) for name in FORCES])
    t = np.arange(round(filming.seconds * filming.fps)) / filming.fps
    places = np.empty((len(t), filming.bodies, 2))
    for body in range(filming.bodies):
        angle = 0.0 if filming.one_way else rng.uniform(0, 2 * np.pi)
        speed = np.exp(rng.uniform(*np.log(filming.speeds)))
        heading = np.array([np.cos(angle), np.sin(angle)])
        start = np.concatenate([-0.5 * speed * heading + rng.uniform(-0.4, 0.4, 2), speed * heading])

        def rate(_: float, s: FloatArray) -> FloatArray:
            a = np.array(acceleration(s[2], s[3], forces))
            return np.concatenate([s[2:], a + (extra(s[:2], s[2:]) if extra else 0.0)])

        y = solve_ivp(rate, (0, t[-1]), start, "DOP853", t, rtol=1e-10, atol=1e-10).y
        places[:, body] = np.stack(shown(y[0], y[1], truth), axis=1)
    places += filming.sigma * _noise(rng, places.shape, filming.correlation)
    far = rng.random(places.shape[:2]) < filming.outliers
    places[far] += 20 * filming.sigma * rng.standard_normal((int(far.sum()), 2))
    places[rng.random(places.shape[:2]) < filming.missing] = np.nan
    names = tuple(f"puck-{k}" for k in range(filming.bodies))
    return Recording(shot, np.arange(len(t)), t, names, places, np.ones(places.shape[:2]), PLANE)


def _noise(rng: np.random.Generator, shape: tuple[int, ...], correlation: float) -> FloatArray:
    fresh = rng.standard_normal(shape)
    for k in range(1, shape[0]):
        fresh[k] = correlation * fresh[k - 1] + np.sqrt(1 - correlation**2) * fresh[k]
    return fresh
