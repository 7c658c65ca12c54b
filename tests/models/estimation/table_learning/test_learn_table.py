"""A table is learned from filmed shots, and foresees other shots of it better than a usual table does."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.contact_graph import ClothFriction, ContactGraph, JointSolution
from models.core.errors import TrackError
from models.core.scene import Camera, Scene, Table
from models.core.tracks import Tracks
from models.estimation.forecast.ensemble_prediction import forecast_shot
from models.estimation.forecast.forecast_check import estimate_state
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.table_learning.learn_table import combine_noses, learn_table
from models.physics.billiards.simulation.simulate_shot import BallSet, SimulatedShot, simulate
from models.physics.billiards.simulation.table_physics import Physics
from models.physics.billiards.tables import NOSE_SIGMA
from models.tracking.track_noise import apply_noise, estimate_noise

R, FPS, NOISE, SECONDS = 0.03075, 50, 5e-4, 5.0
TABLE = Table("carom", "carom", 2.84, 1.42, R, 0.21, False)
SCENE = Scene(
    TABLE,
    Camera(
        np.array([[300.0, 0, 0, 0], [0, 300.0, 0, 0], [0, 0, -0.25, 1.0]]),
        852,
        426,
        300 * TABLE.corners,
        0.01 * np.eye(8),
        "cloth",
        4.0,
        0.3,
    ),
    np.array([40.0, -30.0, 10.0]),
    (),
)
EFFECTS = {
    "sliding_friction": {"mu": 0.2}, "rolling_resistance": {"mu": 0.005}, "spin_decay": {"rate": 5.0},
    "cushion_restitution": {"e": 0.92}, "cushion_friction": {"mu": 0.25}, "ball_restitution": {"e": 0.94},
}  # fmt: skip


def play(seed: int) -> SimulatedShot:
    """Simulate one spinning ball that meets several cushions."""
    rng = np.random.default_rng([11, seed])
    angle, speed = rng.uniform(0, 2 * np.pi), rng.uniform(2.0, 3.5)
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    roll, side = rng.uniform(0.3, 1.0), rng.uniform(-0.8, 0.8) * speed / R
    state = np.array([[rng.uniform(0.5, 2.3), rng.uniform(0.4, 1.0), *v, -roll * v[1] / R, roll * v[0] / R, side]])
    balls = BallSet(("white",), state, np.array([R]), np.array([TABLE.ball_mass]))
    return simulate(balls, TABLE, Physics.from_effects(EFFECTS, "han_2005", "inelastic"), SECONDS)


def film(shot: SimulatedShot, seed: int) -> Tracks:
    t = np.arange(int(SECONDS * FPS)) / FPS
    xy = shot.states_at(t)[..., :2] + np.random.default_rng([12, seed]).normal(0, NOISE, (len(t), 1, 2))
    sigma = np.full((len(t), 1), NOISE)
    return Tracks(
        np.arange(len(t)), t, ("white",), ("white",), xy, 300 * xy, sigma, sigma, np.zeros_like(xy),
        np.full((len(t), 1), 300 * R), np.array([[80.0, 0.0, 0.0]]),
    )  # fmt: skip


@pytest.mark.slow
def test_a_learned_table_foresees_other_shots_better() -> None:
    fits = []
    for seed in range(8):
        tracks = film(play(seed), seed)
        solution = explain(tracks, SCENE).solution
        assert solution is not None
        fits.append((solution, apply_noise(tracks, estimate_noise(tracks, 0.1, R))))
    lesson = learn_table(fits, TABLE, ("mirror", "han_2005", "stronge"))
    assert lesson.table.cushion_law == "han_2005"
    learned = {one.name: one.value for one in lesson.parameters}
    assert learned["rolling_resistance.mu"] == pytest.approx(0.005, rel=0.05)
    assert learned["sliding_friction.mu"] == pytest.approx(0.2, rel=0.05)
    assert learned["cushion_friction.mu"] == pytest.approx(0.25, rel=0.15)
    assert lesson.table.scatter.velocity < 0.02  # the simulated cushions obey their model
    errors = []
    for seed in range(20, 28):
        shot = play(seed)
        tracks, later = film(shot, seed), np.array([1.5, 3.0])
        true = shot.states_at(later)[-1, 0, :2]
        for table in (lesson.table, None):
            prediction = forecast_shot(estimate_state(tracks, SCENE, 1.5, table), later, draws=256)
            errors.append(np.hypot(*(prediction.path[-1, 0] - true)))
    with_table, without = np.median(np.reshape(errors, (-1, 2)), axis=0)
    assert with_table < 0.03
    assert with_table < 0.6 * without


def test_a_ball_that_meets_no_cushion_teaches_no_table() -> None:
    rolls = BallSet(("white",), np.array([[0.5, 0.7, 0.5, 0, 0, 0.5 / R, 0]]), np.array([R]), np.array([0.21]))
    tracks = film(simulate(rolls, TABLE, Physics.from_effects(EFFECTS, "han_2005", "inelastic"), SECONDS), 0)
    solution = explain(tracks, SCENE).solution
    assert solution is not None
    with pytest.raises(TrackError, match="too few"):
        learn_table([(solution, tracks)], TABLE)


def make_noses(offsets: list[float], sigmas: list[float]) -> JointSolution:
    """Make a fit without segments that measured its noses (m) with independent errors, besides the prior."""
    graph, covariance = ContactGraph((), ()), np.eye(10)
    precision = 1 / np.square(sigmas)
    posterior = 1 / (precision + NOSE_SIGMA**-2)
    covariance[3:7, 3:7] = np.diag(posterior)
    fitted = np.array(offsets) * precision * posterior
    return JointSolution(graph, ClothFriction(0.2, 0.01), 1.0, fitted, np.zeros(3), 0.0, covariance)


def test_noses_weigh_by_their_errors_and_an_untouched_one_keeps_its_prior() -> None:
    rng, never = np.random.default_rng(4), 10.0
    true = np.array([-3e-3, 2e-3, 1e-3, 0.0])
    shots = [
        make_noses((true + rng.normal(0, 1e-3, 4)).tolist(), [5e-4, 5e-4, 5e-4 if k == 0 else never, never])
        for k in range(12)
    ]
    noses, covariance = combine_noses(shots)
    sigma = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose(noses[:2], true[:2], atol=1e-3)
    assert abs(noses[2] - 1e-3) < 3 * sigma[2]  # one shot touched it: eleven others do not count as zero
    assert noses[2] > 2e-4
    assert noses[3] == pytest.approx(0.0, abs=1e-5)
    assert sigma[3] > NOSE_SIGMA > 2 * sigma[0]
    assert sigma[0] > 0.9e-3  # spread from shot to shot
