"""Fits of the physics itself, as methods beside the networks."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from models.core.typing import FloatArray
from models.estimation.pendulum.pendulum_fit import swing
from models.estimation.rigid_bodies.rigid_body_fit import fit_boxes
from models.estimation.springs.latent_inference import infer
from models.neural.common.method_interface import Budget, checked
from pipeline.experiments.thesis.assessed_motion import Judged
from pipeline.experiments.thesis.scenes.boxes_scene import bodies
from pipeline.experiments.thesis.scenes.double_pendulum_scene import as_angles, as_points

NO_LOSS = np.empty(0)
BOXES_NUMBERS = 6
"""friction, restitution, drag, gravity, radius and density of the ball."""


@dataclass(frozen=True, slots=True)
class SpringsFit:
    """Masses, springs, dampers and gravity behind the points: nothing of them is told (`models.estimation.springs.latent_inference`)."""

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: Budget) -> Judged:
        """Always the whole search, whatever the budget: a part of it is no fit."""
        began = time.process_time()
        latent = infer(*checked(times, states))
        seconds = time.process_time() - began
        return Judged(lambda t: latent.at(t)[:, 0], NO_LOSS, len(latent.names), seconds, latent.doubts)


@dataclass(frozen=True, slots=True)
class ArmsFit:
    """Two rigid arms with friction behind the points of a real double pendulum (`models.pendulum`)."""

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: Budget) -> Judged:
        """Neither seed nor budget matter."""
        began = time.process_time()
        t, x = checked(times, states)
        found = swing(t, as_angles(x))
        seconds = time.process_time() - began
        return Judged(lambda t: as_points(found.at(t)[:, :2]), NO_LOSS, len(found.numbers), seconds, ())


@dataclass(frozen=True, slots=True)
class BoxesFit:
    """Rigid bodies that collide behind the points of the boxes (`models.boxes`), told only which points are whose."""

    name: str = "physics fit"

    def fit(self, times: FloatArray, states: FloatArray, seed: int, budget: Budget) -> Judged:
        """Neither seed nor budget matter."""
        began = time.process_time()
        t, x = checked(times, states)
        found = fit_boxes(t, x, bodies())
        seconds = time.process_time() - began
        return Judged(found.at, NO_LOSS, BOXES_NUMBERS, seconds, found.doubts)
