"""Fits of a physical model, as methods beside the networks."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from models.core.recording import record_points
from models.core.typing import FloatArray
from models.estimation.pendulum.pendulum_fit import fit_pendulum
from models.estimation.rigid_bodies.rigid_body_fit import fit_rigid_bodies
from models.estimation.springs.latent_inference import infer_springs
from models.neural.common.method_interface import TrainingBudget, validate_samples
from pipeline.experiments.thesis.assessed_motion import AssessedMotion
from pipeline.experiments.thesis.scenes.boxes_scene import body_indices
from pipeline.experiments.thesis.scenes.double_pendulum_scene import convert_to_angles, convert_to_points

NO_LOSS = np.empty(0)
BOXES_NUMBERS = 6
"""Number of parameters: friction, restitution, drag, gravity, radius and density of the ball."""


@dataclass(frozen=True, slots=True)
class SpringsFit:
    """Masses, springs, dampers and gravity behind the points, without further input.

    See `models.estimation.springs.latent_inference`.
    """

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Run the whole search, whatever the budget: a part of it is no fit."""
        began = time.process_time()
        latent = infer_springs(record_points(*validate_samples(times, states)))
        seconds = time.process_time() - began
        return AssessedMotion(
            lambda t: latent.states_at(t)[:, 0], NO_LOSS, len(latent.names), seconds, latent.rejections
        )


@dataclass(frozen=True, slots=True)
class ArmsFit:
    """Two rigid arms with friction behind the points of a recorded double pendulum."""

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Fit the arms; seed and budget have no effect."""
        began = time.process_time()
        t, x = validate_samples(times, states)
        pendulum = fit_pendulum(t, convert_to_angles(x))
        seconds = time.process_time() - began
        return AssessedMotion(
            lambda t: convert_to_points(pendulum.states_at(t)[:, :2]), NO_LOSS, len(pendulum.parameters), seconds, ()
        )


@dataclass(frozen=True, slots=True)
class BoxesFit:
    """Colliding rigid bodies behind the points of the boxes, given the body of each point."""

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: TrainingBudget) -> AssessedMotion:
        """Fit the bodies; seed and budget have no effect."""
        began = time.process_time()
        t, x = validate_samples(times, states)
        rigid_bodies = fit_rigid_bodies(t, x, body_indices())
        seconds = time.process_time() - began
        return AssessedMotion(rigid_bodies.positions_at, NO_LOSS, BOXES_NUMBERS, seconds, rigid_bodies.warnings)
