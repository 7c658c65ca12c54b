"""A patch is located and measured from paths that cross it; motion that is the same everywhere has none."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from support.reference_frames import PLANE

from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, build_diagnosis_problem, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.unexplained.free_stretches import FreeStretch, find_free_stretches
from diagnosis.unexplained.local_patch import LocalPatch, find_local_patch, fit_outside_patch, locate_patch
from models.core.constants import GRAVITY
from models.core.recording import Recording
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.estimation.gap_scenes.sliding_scene import build_sliding_scene
from models.physics.billiards.tables import TABLE_PRESETS

SHOTS, FPS, SECONDS, NOISE = 9, 30, 0.8, 5e-4
MU, PATCH_MU, WEAK_MU, RADIUS = 0.1, 0.2, 0.02, 0.2
STEPS = 40
"""Steps of the simulation per frame."""
CENTRE = np.array([0.3, -0.2])
Brake = Callable[[np.ndarray, float, int], float]


def plain(place: np.ndarray, speed: float, shot: int) -> float:
    """Return the deceleration by friction alone."""
    return MU * GRAVITY


def sticky(place: np.ndarray, speed: float, shot: int) -> float:
    """Return the deceleration with a patch."""
    return (MU + PATCH_MU * float(math.dist(place, CENTRE) < RADIUS)) * GRAVITY


def weak(place: np.ndarray, speed: float, shot: int) -> float:
    """Return the deceleration with a weak patch."""
    return (MU + WEAK_MU * float(math.dist(place, CENTRE) < RADIUS)) * GRAVITY


def dragging(place: np.ndarray, speed: float, shot: int) -> float:
    """Return the deceleration by a drag that no library holds."""
    return MU * GRAVITY + 0.8 * speed**1.5


def ageing(place: np.ndarray, speed: float, shot: int) -> float:
    """Return the deceleration by friction that grows from shot to shot."""
    return (MU + 0.02 * shot) * GRAVITY


def move_body(brake: Brake, shot: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Simulate a body that slides through the middle: times, places and velocities."""
    t = np.arange(int(SECONDS * FPS)) / FPS
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(1.0, 2.0)
    heading = np.array([np.cos(angle), np.sin(angle)])
    place = CENTRE - 0.4 * heading + rng.uniform(-0.2, 0.2, 2)
    places, speeds = np.empty((len(t), 2)), np.empty(len(t))
    for k in range(len(t)):
        places[k], speeds[k] = place, speed
        for _ in range(STEPS):
            slower = max(speed - brake(place, speed, shot) / (FPS * STEPS), 0.0)
            place = place + 0.5 * (speed + slower) * heading / (FPS * STEPS)
            speed = slower
    return t, places + NOISE * rng.standard_normal(places.shape), speeds[:, None] * heading


def fit_simulator(brake: Brake, seed: int) -> tuple[DiagnosisProblem, EffectFit]:
    """Fit a simulator with friction to simulated shots."""
    rng, shots = np.random.default_rng(seed), []
    for shot in range(SHOTS):
        t, places, _ = move_body(brake, shot, rng)
        rows = np.arange(len(t))
        shots.append(Recording(shot, rows, t, ("body",), places[:, None], np.full((len(t), 1), NOISE), PLANE))
    problem = build_diagnosis_problem(build_sliding_scene(("sliding_friction",)), WHITE_NOISE)
    return problem, fit_effects(problem, tuple(shots))


def draw_stretches(seed: int, brake: Brake = weak) -> tuple[FreeStretch, ...]:
    """Simulate stretches over a patch, weak by default, with the residuals of a model without any resistance."""
    rng, stretches = np.random.default_rng(seed), []
    for shot in range(SHOTS):
        t, places, velocity = move_body(brake, shot, rng)
        moves = np.linalg.norm(velocity, axis=1) > 0.1
        t, places, velocity = t[moves], places[moves], velocity[moves]
        stretches.append(FreeStretch(shot, t, places, np.full(len(t), NOISE), places, velocity))
    return tuple(stretches)


def pulls(patch: LocalPatch, mu: float) -> np.ndarray:
    """Return the errors of place, radius and strength over their standard deviations."""
    errors = [*(patch.centre - CENTRE), patch.radius - RADIUS, patch.strength + mu * GRAVITY]
    return np.array(errors) / [*patch.centre_sigma, patch.radius_sigma, patch.strength_sigma]


def test_errors_of_a_patch_hold() -> None:
    found = [locate_patch(draw_stretches(seed), np.random.default_rng(seed)) for seed in range(4)]
    patches = [one for one in found if one is not None]
    assert len(patches) == len(found)
    drawn = np.array([pulls(one, WEAK_MU) for one in patches])
    assert 0.6 < np.sqrt(np.square(drawn[:, :2]).mean()) < 1.4
    assert (np.abs(drawn) < 2).mean() > 0.8
    assert np.median([np.linalg.norm(one.centre - CENTRE) for one in patches]) < 0.25 * RADIUS


@pytest.mark.parametrize(("aside", "is_stated"), [(0.0, False), (0.02, False), (0.06, True)])
def test_a_patch_whose_place_the_paths_leave_open_is_not_stated(aside: float, is_stated: bool) -> None:
    """The same motion along two lines on either side of a patch: from nearly one line, nobody sees where it lies."""
    turned = []
    for k, one in enumerate(draw_stretches(0)):
        along = (one.position - CENTRE) @ one.velocity[0] / np.linalg.norm(one.velocity[0])
        place = CENTRE + np.outer(along, [1.0, 0.0]) + np.array([0.0, aside * (-1) ** k])
        velocity = np.outer(np.linalg.norm(one.velocity, axis=1), [1.0, 0.0])
        turned.append(replace(one, position=place, residual=place, velocity=velocity))
    assert (locate_patch(tuple(turned), np.random.default_rng(0)) is not None) == is_stated


def test_what_a_single_stretch_shows_is_no_patch() -> None:
    drawn = [draw_stretches(seed, plain) for seed in range(4)]
    found = []
    for stretches in drawn:
        pushed = list(stretches)
        body = pushed[4]
        along = body.velocity[0] / np.linalg.norm(body.velocity[0])
        late = np.maximum(body.t - body.t.mean(), 0)[:, None]
        pushed[4] = replace(body, residual=body.residual - 0.05 * late * along)
        found.append(locate_patch(tuple(pushed), np.random.default_rng(0)))
    assert found == [None] * 4


def test_a_contact_that_the_model_missed_is_left_out() -> None:
    stretches = list(draw_stretches(0))
    body = stretches[3]
    bounce = np.maximum(body.t - body.t.mean(), 0)[:, None] * [0.5, -0.4]
    stretches[3] = FreeStretch(3, body.t, body.residual + bounce, body.sigma, body.position, body.velocity)
    patch = locate_patch(tuple(stretches), np.random.default_rng(0))
    assert patch is not None
    assert np.abs(pulls(patch, WEAK_MU)).max() < 3


def test_a_patch_is_measured_beside_the_simulator_and_does_not_bias_it() -> None:
    problem, base = fit_simulator(sticky, 1)
    patch = find_local_patch(problem, base, np.random.default_rng(1))
    assert patch is not None
    assert np.abs(pulls(patch, PATCH_MU)).max() < 3
    outside = fit_outside_patch(problem, base, base, patch)
    assert abs(base.shared[0] - MU) > 5 * base.shooting.sigma[0]
    assert abs(outside.shared[0] - MU) < 3 * outside.shooting.sigma[0]


def test_an_effect_that_imitates_a_patch_is_not_needed_outside_it() -> None:
    problem, base = fit_simulator(sticky, 1)
    best = fit_effects(problem, base.segments, ("viscous_drag",))
    patch = find_local_patch(problem, best, np.random.default_rng(1))
    assert patch is not None
    assert fit_outside_patch(problem, base, best, patch).names == ()


@pytest.mark.parametrize("brake", [plain, dragging, ageing])
def test_motion_that_is_alike_everywhere_has_no_patch(brake: Brake) -> None:
    problem, base = fit_simulator(brake, 0)
    assert find_local_patch(problem, base, np.random.default_rng(0)) is None


def test_stretches_hold_the_missing_acceleration_over_all_windows() -> None:
    _, base = fit_simulator(plain, 2)
    problem = build_diagnosis_problem(build_sliding_scene(), WHITE_NOISE)
    stretches = find_free_stretches(problem, fit_effects(problem, base.segments))
    assert len(stretches) == SHOTS
    for stretch in stretches:
        assert stretch.t[0] == 0.0  # nothing is left out where no contact comes before
        along = stretch.velocity[0] / np.linalg.norm(stretch.velocity[0])
        curve, covariance = np.polyfit(stretch.t, stretch.residual @ along, 2, cov=True)
        assert 2 * curve[0] == pytest.approx(-MU * GRAVITY, abs=4 * 2 * float(np.sqrt(covariance[0, 0])))


def test_a_ball_that_rolls_is_a_stretch_of_free_motion() -> None:
    mu, speed = 0.012, 0.8
    t = np.arange(50) / 60
    places = np.stack([0.6 + speed * t - 0.5 * mu * GRAVITY * t**2, np.full(len(t), 0.5)], axis=1)
    places += 1e-4 * np.random.default_rng(0).standard_normal(places.shape)
    both = np.stack([places, np.full_like(places, np.nan)], axis=1)  # the other ball is never seen
    shot = Recording(0, np.arange(50), t, ("cue", "red"), both, np.full((50, 2), 1e-4), PLANE)
    scene = build_billiards_scene(
        TABLE_PRESETS["carom-match"], (shot,), simulator_effects=("sliding_friction", "rolling_resistance")
    )
    problem = build_diagnosis_problem(scene, WHITE_NOISE)
    # two windows, of which the second begins anew from the observations
    fitted = fit_effects(problem, (shot.select_rows(0, 25), shot.select_rows(25, 50)))
    less = np.where(problem.mask(("rolling_resistance",)), fitted.shared - 0.005, fitted.shared)
    (stretch,) = find_free_stretches(problem, replace(fitted, shared=less))
    assert stretch.t[-1] - stretch.t[0] > 0.5
    assert 2 * np.polyfit(stretch.t, stretch.residual[:, 0], 2)[0] == pytest.approx(-0.005 * GRAVITY, rel=0.2)
