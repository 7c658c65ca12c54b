"""The height of the contact with a cushion: every model against impulses at the point of contact, and absent."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.physics.billiards import parameter_vector
from models.physics.billiards.contact_model import LEAST_HEIGHT, find_model
from models.physics.billiards.contact_models import CUSHION_MODELS, REGISTERED_CUSHION_MODELS
from models.physics.billiards.simulation.table_physics import Physics

RADIUS, MASS = 0.028575, 0.17
SPEEDS = np.array([1.0, 1.0, RADIUS, RADIUS, RADIUS])
"""Turns vn, vt, wn, wt, wz into speeds of the surface, m/s."""
OWN_HEIGHT = {"mirror": 1.0, "han_2005": 1.27, "mathavan_2010": 1.27, "stronge": 1.27}
every_law = pytest.mark.parametrize("name", CUSHION_MODELS)


def physics(height: float, e: float = 0.85, mu: float = 0.2, cloth: float = 0.2) -> FloatArray:
    p = parameter_vector.neutral_parameters()
    p[parameter_vector.CUSHION_E], p[parameter_vector.CUSHION_HEIGHT] = e, height
    p[parameter_vector.CUSHION_MU], p[parameter_vector.SLIDING_MU] = mu, cloth
    return p


def rebound(name: str, ball: FloatArray, p: FloatArray) -> FloatArray:
    resolve = find_model(REGISTERED_CUSHION_MODELS, name).resolve
    return np.array(resolve(*(p.dtype.type(x) for x in (*ball.tolist(), RADIUS, MASS)), p))


def contacts(count: int) -> list[FloatArray]:
    """Draw balls of 0.2 to 4 m/s, a third of them rolling."""
    rng, balls = np.random.default_rng(11), []
    for i in range(count):
        ball = np.array([rng.uniform(0.2, 4), rng.normal() * 1.5, *(rng.normal(size=3) * 50)])
        if i % 3 == 0:
            ball[2:4] = -ball[1] / RADIUS, ball[0] / RADIUS
        balls.append(ball)
    return balls


def push_at_point(ball: FloatArray, height: float, normal: float, rub: FloatArray) -> FloatArray:
    """Apply an impulse (per mass) at the point of contact: `normal` out of the nose, and `rub` (n, t, z).

    The ball keeps its height, so the vertical part changes its spin alone.
    """
    arm = RADIUS * np.array([np.sqrt(1 - (height - 1) ** 2), 0.0, height - 1])
    impulse = rub - normal * arm / RADIUS
    spin = ball[2:] + np.cross(arm, impulse) * 2.5 / RADIUS**2
    return np.array([min(ball[0] + impulse[0], 0.0), ball[1] + impulse[1], *spin])


def slip_at_point(ball: FloatArray, height: float) -> tuple[float, FloatArray]:
    """Return the closing speed at the point of contact, and the slip (n, t, z) of the surface there, m/s."""
    normal = np.array([np.sqrt(1 - (height - 1) ** 2), 0.0, height - 1])
    surface = np.array([ball[0], ball[1], 0.0]) + np.cross(ball[2:], RADIUS * normal)
    return float(surface @ normal), surface - (surface @ normal) * normal


@pytest.mark.parametrize("height", [0.9, 1.0, 1.15, 1.27, 1.4])
def test_hans_impulse_acts_at_the_height_of_the_nose(height: float) -> None:
    e, mu = 0.85, 0.2
    for ball in contacts(200):
        closing, slip = slip_at_point(ball, height)
        share = min(mu * (1 + e) * closing / np.linalg.norm(slip), 2 / 7)
        expected = push_at_point(ball, height, (1 + e) * closing, -share * slip)
        np.testing.assert_allclose(rebound("han_2005", ball, physics(height)) * SPEEDS, expected * SPEEDS, atol=1e-12)


@pytest.mark.parametrize("height", [0.9, 1.15, 1.4])
def test_a_mirror_reflects_the_level_speed_and_rubs_at_the_height_of_its_contact(height: float) -> None:
    e, mu = 0.85, 0.2
    for ball in contacts(200):
        normal = (1 + e) * ball[0] / np.sqrt(1 - (height - 1) ** 2)
        along = slip_at_point(ball, height)[1][1]
        rub = -np.sign(along) * min(mu * normal, 2 / 7 * abs(along))
        expected = push_at_point(ball, height, normal, np.array([0.0, rub, 0.0]))
        np.testing.assert_allclose(rebound("mirror", ball, physics(height)) * SPEEDS, expected * SPEEDS, atol=1e-12)
        assert rebound("mirror", ball, physics(height))[0] == pytest.approx(-e * ball[0], rel=1e-12)


@every_law
def test_an_absent_height_is_that_of_the_model(name: str) -> None:
    assert dict(find_model(REGISTERED_CUSHION_MODELS, name).standard_values) == {
        "cushion_height.ratio": OWN_HEIGHT[name]
    }
    for ball in contacts(60):
        own = rebound(name, ball, physics(OWN_HEIGHT[name]))
        np.testing.assert_array_equal(rebound(name, ball, physics(0.0)), own)
        assert np.abs(rebound(name, ball, physics(1.38)) - own).max() > 1e-6 or name == "mirror"


@every_law
@pytest.mark.parametrize("height", [0.0, 1.12, 1.4])
def test_the_derivative_by_the_height_is_that_of_the_differences(name: str, height: float) -> None:
    """A complex step at an absent height gives the derivative at the height of the model."""
    step, number = 1e-6, parameter_vector.CUSHION_HEIGHT
    assert height == 0.0 or height > LEAST_HEIGHT
    for ball in contacts(20):
        p = physics(height).astype(np.complex128)
        p[number] += 1e-30j
        exact = rebound(name, ball.astype(np.complex128), p).imag / 1e-30 * SPEEDS
        at = height or OWN_HEIGHT[name]
        ends = [rebound(name, ball, physics(at + sign * step)) * SPEEDS for sign in (1, -1)]
        np.testing.assert_allclose(exact, (ends[0] - ends[1]) / (2 * step), atol=2e-3 * np.hypot(*ball[:2]), rtol=1e-3)


@every_law
@pytest.mark.parametrize("height", [0.6, 0.9, 1.1, 1.4, 1.5])
def test_no_height_creates_energy_or_lets_a_ball_through(name: str, height: float) -> None:
    rng = np.random.default_rng(5)
    for ball in contacts(300):
        after = rebound(name, ball, physics(height, rng.uniform(0, 1), rng.uniform(0, 0.6), rng.uniform(0, 0.5)))
        energy = [float((x[:2] @ x[:2]) + 0.4 * (x[2:] @ x[2:])) for x in (ball * SPEEDS, after * SPEEDS)]
        assert after[0] <= 0.0
        assert energy[1] <= energy[0] * (1 + 1e-6)


def test_a_higher_nose_takes_more_of_the_roll() -> None:
    """A rolling ball that meets a cushion of Han at right angles keeps less speed, the higher the nose."""
    ball = np.array([1.0, 0.0, 0.0, 1 / RADIUS, 0.0])
    speeds = [-rebound("han_2005", ball, physics(height, mu=0.0))[0] for height in (1.0, 1.15, 1.27, 1.4)]
    assert speeds[0] == pytest.approx(0.85)
    assert np.all(np.diff(speeds) < 0)


@every_law
def test_every_cushion_law_of_a_shot_accepts_a_height(name: str) -> None:
    given = Physics.from_effects({"cushion_height": {"ratio": 1.2}}, name)
    assert given.values[parameter_vector.CUSHION_HEIGHT] == 1.2
    with pytest.raises(ValueError, match=r"cushion_height.ratio is between 0.5 and 1.5; got 2"):
        Physics.from_effects({"cushion_height": {"ratio": 2.0}}, name)
