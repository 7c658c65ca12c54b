"""The data of the rivals of the diagnosis: accelerations that a simulator lacks, and the terms of a library.

The simulator is fitted as in the diagnosis. With its parameters fixed, every short window of motion gets a start of its
own; the second derivative of the residuals is the acceleration that the simulator lacks there. A term is averaged over
the same samples with the weights with which that derivative averages the acceleration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from diagnosis.fitting.diagnosis_windows import MIN_ROWS, split_into_segments
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray, IntArray
from models.estimation.gap_scenes.contact_free_scene import ContactFreeScene
from models.estimation.gap_scenes.gap_scene import ContactRichScene
from models.estimation.gap_scenes.sliding_scene import meets_wall

# Phase of free motion by scene; the unknown spin of a ball that slides would hide forces.
FREE_PHASES = {"flight": "flight", "slide": "slide", "pendulum": "swing", "billiards": "free_roll"}
# Rows of a sample: a second derivative from fewer rows is mostly noise, and a swing turns within more.
_SAMPLE_ROWS = 15
# Rows of a sample of a body that stops.
_SHORT_ROWS = 9
# Standard deviations of an acceleration that may stop a body.
_STOP_SIGMAS = 3.0
# m/s or rad/s below which a direction of motion fades.
_MIN_SPEED = 1e-6

# Value, sigma, shot, motion and columns of a sample; the groups of the columns.
_Sample = tuple[tuple[FloatArray, float, int, FloatArray, FloatArray], tuple[str, ...]]
# Accelerations (K, D, c) of a term with c coefficients, by the name of its effect.
Terms = dict[str, FloatArray]


@dataclass(frozen=True, slots=True)
class ResidualSamples:
    """M samples of the acceleration with D coordinates that a simulator lacks, and C columns of terms there."""

    values: FloatArray
    """(M, D) in the unit of the scene per s^2."""
    sigma: FloatArray
    """(M,) standard deviation of each coordinate, from the noise alone."""
    shot: IntArray
    """(M,) index of the shot."""
    motion: FloatArray
    """(M, 2D) position and velocity."""
    columns: FloatArray
    """(M, D, C) acceleration for a coefficient of 1."""
    groups: tuple[str, ...]
    """(C,) effect that a column belongs to; another word where the catalogue has none with such an acceleration."""

    def select(self, chosen: BoolArray) -> ResidualSamples:
        """Return the chosen (M,) samples."""
        return ResidualSamples(
            self.values[chosen], self.sigma[chosen], self.shot[chosen], self.motion[chosen], self.columns[chosen],
            self.groups,
        )  # fmt: skip

    @property
    def design(self) -> FloatArray:
        """(M D, C) columns in standard deviations."""
        return np.asarray((self.columns / self.sigma[:, None, None]).reshape(self.values.size, -1))

    @property
    def target(self) -> FloatArray:
        """(M D,) accelerations in standard deviations."""
        return np.asarray((self.values / self.sigma[:, None]).ravel())


def sample_residuals(
    problem: DiagnosisProblem, shots: tuple[Recording, ...], fitted: EffectFit
) -> ResidualSamples | None:
    """Sample the acceleration that a simulator lacks, in free motion.

    Args:
        problem: One of the scenes of `FREE_PHASES`, and its noise.
        shots: Shots with the noise estimate applied; they need not be those of the fit.
        fitted: Fit of the simulator.

    Returns:
        The samples of all bodies; those in which a body may have stopped are left out. None where there are none.
    """
    windows, parts = tuple(_cut_windows(problem, shots)), list[_Sample]()
    while windows:
        starts = fit_start_states(problem, windows, fitted).starts
        samples = [list(_sample_window(problem, *pair, fitted)) for pair in zip(windows, starts, strict=True)]
        parts += [one for own in samples for one in own]
        if isinstance(problem.scene, ContactRichScene):
            break
        # a body that stops within a window may move at its beginning
        windows = tuple(
            window.select_rows(0, _SHORT_ROWS)
            for window, own in zip(windows, samples, strict=True)
            if not own
            and len(window.t) > _SHORT_ROWS
            and (window.is_observed[:_SHORT_ROWS].sum(axis=0) >= MIN_ROWS).all()
        )
    if not parts:
        return None
    values, sigma, shot, motion, columns = (np.array(column) for column in zip(*(one for one, _ in parts), strict=True))
    return ResidualSamples(values, sigma, shot, motion, columns, parts[0][1])


def _cut_windows(problem: DiagnosisProblem, shots: tuple[Recording, ...]) -> Iterator[Recording]:
    """Cut shots into windows of one sample, away from walls; in a contact-rich scene, longer ones that show spin."""
    walls = np.array(problem.scene.walls if isinstance(problem.scene, ContactFreeScene) else ())
    for segment in split_into_segments(problem, shots):
        rows = _SAMPLE_ROWS
        if isinstance(problem.scene, ContactRichScene):
            rows = max(rows, round(problem.scene.initial_window_length / float(np.median(np.diff(segment.t)))))
        for first in range(0, len(segment.t), rows):
            window = segment.select_rows(first, first + rows)
            if (window.is_observed.sum(axis=0) >= MIN_ROWS).all() and not (walls.size and meets_wall(window, walls)):
                yield window


def _sample_window(
    problem: DiagnosisProblem, window: Recording, start: FloatArray, fitted: EffectFit
) -> Iterator[_Sample]:
    """Yield the samples of a window."""
    scene = problem.scene
    path = scene.predict_positions(window, start, fitted.shared, fitted.forms)
    around = scene.observation_covariates(window, start, fitted.shared, fitted.forms)
    rows, bodies = np.nonzero(window.is_observed)
    inputs = None if window.inputs is None else window.inputs[rows, bodies, :, 0]
    terms = build_terms(scene.name, around.position, around.velocity, inputs)
    groups = tuple(name for name, part in terms.items() for _ in range(part.shape[2]))
    columns = np.concatenate(list(terms.values()), axis=2)
    is_free = np.array(around.phase) == FREE_PHASES[scene.name]
    correlated = float(np.sqrt((1 + problem.noise.correlation) / (1 - problem.noise.correlation)))
    misses = window.positions[rows, bodies] - path[rows, bodies]
    for body in range(len(window.bodies)):
        own = np.flatnonzero(bodies == body)
        for here in (own[k : k + _SAMPLE_ROWS] for k in range(0, len(own) - MIN_ROWS + 1, _SAMPLE_ROWS)):
            if not is_free[here].all() or not np.isfinite(misses[here]).all():
                continue
            t = window.t[rows[here]]
            span, middle = float(np.ptp(t)), (t[0] + t[-1]) / 2
            second = 2 * np.linalg.pinv(np.vander((t - middle) / span, 3))[0] / span**2
            value = second @ misses[here]
            sigma = float(np.linalg.norm(second) * window.sigma[rows[here], body].mean() * correlated)
            speed = float(np.sqrt(np.square(around.velocity[here]).sum(axis=1).mean()))
            if speed <= span / 2 * (float(np.linalg.norm(value)) + _STOP_SIGMAS * sigma):
                continue
            # a second derivative of a parabola averages accelerations with the weights (1 - u^2)^2
            weights = np.square(1 - np.square((t - middle) / (span / 2 * (1 + 1 / len(t)))))
            weights /= weights.sum()
            motion = np.concatenate([weights @ around.position[here], weights @ around.velocity[here]])
            yield (value, sigma, window.shot, motion, np.tensordot(weights, columns[here], 1)), groups


def build_terms(scene: str, position: FloatArray, velocity: FloatArray, inputs: FloatArray | None = None) -> Terms:
    """Build the library of terms of a scene.

    Args:
        scene: Name of the scene, one of `FREE_PHASES`.
        position: (K, D) in the unit of the scene.
        velocity: (K, D) in the unit of the scene per s.
        inputs: (K, I) known inputs; those of a flight are the axis of its spin.

    Returns:
        Accelerations by the name of an effect, or by a word where no effect of the scene has such an acceleration.
    """
    count = position.shape[1]
    speed = np.linalg.norm(velocity, axis=1)[:, None]
    along = velocity / np.maximum(speed, _MIN_SPEED)
    dry, viscous, square, spring = (-one[..., None] for one in (along, velocity, speed * velocity, position))
    if scene == "pendulum" and count == 2:
        return _build_double_pendulum_terms(position, velocity)
    if scene == "pendulum":
        return {
            "rods": -np.sin(position)[..., None], "joint_friction": np.concatenate([viscous, dry], axis=2),
            "air_drag": square, "gravity_tilt": np.cos(position)[..., None], "spring": spring,
        }  # fmt: skip
    uniform = np.broadcast_to(np.eye(count), (len(position), count, count))
    if scene == "flight":
        # wind accelerates by air drag, to first order, and by viscous drag
        blown = speed[..., None] * uniform + along[..., None] * velocity[:, None]
        lift = {} if count == 1 else {"magnus": _rotate_velocity(velocity, inputs)[..., None]}
        wind = {} if count == 1 else {"wind": np.concatenate([uniform[..., :-1], blown[..., :-1]], axis=2)}
        drags = {"air_drag": square, "viscous_drag": viscous, "constant_brake": dry}
        return {**drags, **lift, **wind, "gravity": uniform[..., -1:], "spring": spring}
    turn = {"turn": _rotate_velocity(velocity, None)[..., None]}
    drags = {"viscous_drag": viscous, "air_drag": square, "slope": uniform}
    if scene == "slide":
        return {"sliding_friction": dry, **drags, **turn, "spring": spring}
    return {"rolling_resistance": dry, **drags, "nap": (along[:, :1] * along)[..., None], **turn}


def _rotate_velocity(velocity: FloatArray, axis: FloatArray | None) -> FloatArray:
    """Rotate velocities (K, D) by 90 degrees: in their plane or about -y, or about a stated axis (K, 3)."""
    if axis is not None and velocity.shape[1] == 3:
        return np.cross(axis, velocity)
    rotated = np.zeros_like(velocity)
    rotated[:, 0], rotated[:, -1] = -velocity[:, -1], velocity[:, 0]
    return rotated


def _build_double_pendulum_terms(angle: FloatArray, velocity: FloatArray) -> Terms:
    """Build the terms of two rods: every one acts on both angles, with a coefficient for each."""
    turning = np.diff(velocity, axis=1, prepend=0.0)
    bend = np.sin(angle[:, :1] - angle[:, 1:])
    shapes = {
        "rods": np.concatenate([np.sin(angle), bend * np.square(velocity)], axis=1),
        "joint_friction": np.concatenate([turning, np.sign(turning)], axis=1),
        "gravity_tilt": np.cos(angle),
        "spring": angle,
    }
    return {
        name: np.concatenate([shape[:, None] * row[:, None] for row in np.eye(2)], axis=2)
        for name, shape in shapes.items()
    }
