"""A patch is fitted to paths that cross it; none is reported where another law, or nothing, is missing."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from support.reference_frames import PLANE

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.unexplained.force_law import measure_excess_acceleration
from diagnosis.unexplained.local_patch import PatchFit, fit_local_patch
from models.core.recording import Recording
from models.estimation.gap_scenes.sliding_scene import GRAVITY, build_sliding_scene

SHOTS, FPS, SECONDS, NOISE = 9, 30, 0.8, 5e-4
MU, PATCH_MU, RADIUS = 0.1, 0.2, 0.2
STEPS = 40
"""Steps of the simulation per frame."""
CENTRE = np.array([0.3, -0.2])
Brake = Callable[[np.ndarray, float], float]


def plain(place: np.ndarray, speed: float) -> float:
    """Return the deceleration by friction alone."""
    return MU * GRAVITY


def sticky(place: np.ndarray, speed: float) -> float:
    """Return the deceleration with a patch."""
    inside = np.hypot(*(place - CENTRE)) < RADIUS
    return (MU + PATCH_MU * float(inside)) * GRAVITY


def dragging(place: np.ndarray, speed: float) -> float:
    """Return the deceleration by a drag that no library holds."""
    return MU * GRAVITY + 0.8 * speed**1.5


def film_shot(brake: Brake, shot: int, rng: np.random.Generator) -> Recording:
    """Simulate and film a body that slides through the middle."""
    t = np.arange(int(SECONDS * FPS)) / FPS
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 2.0)
    heading = np.array([np.cos(angle), np.sin(angle)])
    place = CENTRE - 0.4 * heading + rng.uniform(-0.2, 0.2, 2)
    places = np.empty((len(t), 1, 2))
    for k in range(len(t)):
        places[k, 0] = place
        for _ in range(STEPS):
            slower = max(speed - brake(place, speed) / (FPS * STEPS), 0.0)
            place = place + 0.5 * (speed + slower) * heading / (FPS * STEPS)
            speed = slower
    places += NOISE * rng.standard_normal(places.shape)
    return Recording(shot, np.arange(len(t)), t, ("body",), places, np.full((len(t), 1), NOISE), PLANE)


def fit_simulator(brake: Brake, seed: int) -> tuple[DiagnosisProblem, EffectFit]:
    """Fit a simulator with friction to simulated shots."""
    rng = np.random.default_rng(seed)
    shots = tuple(film_shot(brake, shot, rng) for shot in range(SHOTS))
    problem = build_diagnosis_problem(build_sliding_scene(("sliding_friction",)), 0.0)
    return problem, fit_effects(problem, shots)


def search_patch(brake: Brake, seed: int) -> PatchFit | None:
    """Search a patch beside friction."""
    problem, base = fit_simulator(brake, seed)
    return fit_local_patch(problem, base, measure_excess_acceleration(problem, base))


def test_a_patch_is_measured_with_errors_that_hold_and_biases_nothing() -> None:
    patch_fit = search_patch(sticky, 1)
    assert patch_fit is not None
    patch, fitted = patch_fit.patch, patch_fit.fitted
    assert patch.strength == pytest.approx(-PATCH_MU * GRAVITY, rel=0.2)
    assert np.linalg.norm(patch.centre - CENTRE) < 0.5 * RADIUS
    pulls = [
        *(patch.centre - CENTRE) / patch.centre_sigma,
        (patch.radius - RADIUS) / patch.radius_sigma,
        (patch.strength + PATCH_MU * GRAVITY) / patch.strength_sigma,
        (fitted.shared[0] - MU) / fitted.shooting.sigma[0],
    ]
    assert np.abs(pulls).max() < 3


@pytest.mark.parametrize("brake", [plain, dragging])
def test_motion_that_is_alike_everywhere_has_no_patch(brake: Brake) -> None:
    assert search_patch(brake, 0) is None


def test_no_evidence_follows_from_a_place() -> None:
    problem = build_diagnosis_problem(build_sliding_scene(), 0.0)
    assert problem.places == ("local_patch",)
    assert not {"local_patch"} & {*problem.candidates, *problem.probes}
