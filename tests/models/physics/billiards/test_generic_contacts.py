"""Generic laws of contacts: named laws that they contain, symmetry, and energy."""

from __future__ import annotations

import numpy as np
import pytest

from models.core.typing import FloatArray
from models.physics.billiards.contact_models import BALL_MODELS, CUSHION_MODELS
from models.physics.billiards.parameter_vector import (
    IMPULSE_PARAMETERS,
    REBOUND_PARAMETERS,
    TABLE_PARAMETERS,
    neutral_parameters,
    parameter_index,
)
from models.physics.billiards.simulation.contact_resolution import resolve_ball_contact, resolve_cushion_contact
from models.physics.billiards.simulation.table_physics import Physics

RADIUS, MASS = 0.03, 0.2
MIRROR = np.array([1.0, -1.0, 1.0, -1.0, -1.0, 1.0, -1.0])
"""Reflection at the plane of the x and z axes: y, vy, wx and wz change their sign."""
USUAL = {"cushion_restitution.e": 0.8, "cushion_friction.mu": 0.15, "ball_restitution.e": 0.9, "ball_friction.mu": 0.05}


def physics(**values: float) -> FloatArray:
    """Return the parameters (P,) of usual contacts with these values; two underscores stand for the dot."""
    p = neutral_parameters()
    for name, value in (USUAL | {name.replace("__", "."): value for name, value in values.items()}).items():
        p[parameter_index(name)] = value
    return p


def rebound(state: FloatArray, p: FloatArray, code: int = 0) -> FloatArray:
    """Return the state (7,) after a contact with a cushion on the side of +x."""
    out = np.zeros(7)
    resolve_cushion_contact(state, 1.0, 0.0, RADIUS, MASS, p, code, False, out)
    return out


def collide(states: FloatArray, p: FloatArray, code: int = 1) -> FloatArray:
    """Return the states (2, 7) of two balls after their contact."""
    out = np.zeros(14)
    resolve_ball_contact(states[0], states[1], RADIUS, RADIUS, MASS, MASS, p, code, False, out)
    return out.reshape(2, 7)


def energy(states: FloatArray) -> float:
    return float((states[..., 2:4] ** 2).sum() + 0.4 * RADIUS**2 * (states[..., 4:7] ** 2).sum())


def draw_state(rng: np.random.Generator) -> FloatArray:
    return np.array([0.0, 0.0, rng.uniform(0.2, 3.0), rng.uniform(-2, 2), *rng.uniform(-80, 80, 3)])


def draw_law(rng: np.random.Generator, indices: tuple[int, ...], scale: float) -> FloatArray:
    p = physics()
    p[list(indices)] = scale * rng.standard_normal(len(indices))
    return p


def test_the_generic_rebound_contains_the_restitution_and_its_fall_with_speed() -> None:
    state = np.array([0.0, 0.0, 2.0, 0.5, 3.0, 40.0, 20.0])
    plain = {"cushion_friction__mu": 0.0}
    expected = rebound(state, physics(**plain, cushion_restitution__e=0.85, cushion_restitution_speed__slope=0.02))
    generic = rebound(state, physics(**plain, cushion_rebound__e_0=0.05, cushion_rebound__e_1=-0.02))
    np.testing.assert_allclose(generic, expected, atol=1e-12)


def test_the_generic_grips_contain_sticking_contacts() -> None:
    """An impulse of 2/7 of the slip stops it, of a ball at a cushion and of two balls."""
    state = np.array([0.0, 0.0, 2.0, 0.5, 0.0, 40.0, 20.0])
    after = rebound(state, physics(cushion_friction__mu=0.0, cushion_rebound__grip_0=2 / 7))
    assert after[3] + RADIUS * after[6] == pytest.approx(0.0, abs=1e-12)
    pair = np.array([state, [2 * RADIUS, 0.0, 0.0, 0.0, 0.0, 0.0, 5.0]])
    a, b = collide(pair, physics(ball_friction__mu=0.0, ball_impulse__grip_0=2 / 7))
    assert a[3] - b[3] + RADIUS * (a[6] + b[6]) == pytest.approx(0.0, abs=1e-12)


def test_the_generic_impulse_contains_the_restitution() -> None:
    pair = np.array([[0.0, 0.0, 2.0, 0.5, 0.0, 40.0, 20.0], [2 * RADIUS, 0.0, -0.2, 0.1, 0.0, 0.0, 5.0]])
    expected = collide(pair, physics(ball_friction__mu=0.0, ball_restitution__e=0.95))
    np.testing.assert_allclose(collide(pair, physics(ball_friction__mu=0.0, ball_impulse__e_0=0.05)), expected)


@pytest.mark.parametrize("code", range(len(CUSHION_MODELS)))
def test_a_generic_rebound_is_symmetric_and_creates_no_energy(code: int) -> None:
    rng, changes = np.random.default_rng(code), 0
    for _ in range(200):
        state, p = draw_state(rng), draw_law(rng, REBOUND_PARAMETERS, 0.2)
        after = rebound(state, p, code)
        np.testing.assert_allclose(rebound(MIRROR * state, p, code), MIRROR * after, atol=1e-12)
        assert energy(after) <= (1 + 1e-8) * energy(state)
        assert after[2] <= 0.0
        changes += bool(np.any(after != rebound(state, physics(), code)))
    assert 50 < changes < 200, "some laws are left out, and some act"


@pytest.mark.parametrize("code", range(len(BALL_MODELS)))
def test_a_generic_impulse_is_symmetric_and_creates_no_energy(code: int) -> None:
    rng, changes = np.random.default_rng(code), 0
    for _ in range(200):
        pair, p = np.array([draw_state(rng), draw_state(rng) - 1.0]), draw_law(rng, IMPULSE_PARAMETERS, 0.2)
        pair[1, :3] = 2 * RADIUS, 0.0, 0.5 * pair[0, 2]
        after = collide(pair, p, code)
        np.testing.assert_allclose(collide(MIRROR * pair, p, code), MIRROR * after, atol=1e-12)
        assert energy(after) <= (1 + 1e-8) * energy(pair)
        assert after[0, 2] <= after[1, 2] + 1e-12
        np.testing.assert_allclose(after[:, 2:4].sum(axis=0), pair[:, 2:4].sum(axis=0), atol=1e-12)
        changes += bool(np.any(after != collide(pair, physics(), code)))
    assert changes > 20


def test_no_table_and_no_simulation_takes_a_generic_law() -> None:
    assert not {"cloth_force", "cushion_rebound", "ball_impulse"} & {
        name.partition(".")[0] for name in TABLE_PARAMETERS
    }
    with pytest.raises(ValueError, match=r"effects are .*slope.*cushion_rebound") as refusal:
        Physics.from_effects({"cushion_rebound": {"e_0": 0.1}})
    assert "cloth_force" not in str(refusal.value)
