"""Side spin that no frame shows follows from what cushions do with it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from models.estimation.table_learning.cushion_contacts import CushionContacts, join_contacts
from models.estimation.table_learning.cushion_learning import learn_cushions
from models.estimation.table_learning.learned_table import ContactScatter
from models.estimation.table_learning.side_spin import SpinDistribution, brake_spin, filter_side_spin, predict_rebounds
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import (
    CUSHION_E,
    CUSHION_MU,
    SLIDING_MU,
    SPIN_DECAY,
    neutral_parameters,
)
from models.physics.billiards.simulation.contact_resolution import rebound

R, M, DECAY = 0.028575, 0.17, 5.0
SCATTER = ContactScatter(0.02, 0.08, 0.05)
HAN = CUSHION_MODELS.index("han_2005")
Floats = NDArray[np.float64]


def make_physics(e: float = 0.88, mu: float = 0.22) -> Floats:
    physics = neutral_parameters()
    physics[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = 0.2, e, mu
    return physics


def meet_cushion(before: Floats, spin: float, physics: Floats, law: int = HAN) -> tuple[Floats, float]:
    """Return the state (4,) after a contact and the surface speed of the side spin that is left."""
    vn, vt, un, ut = before
    out = rebound(law, vn, vt, (ut - vt) / R, (vn - un) / R, spin / R, R, M, physics)
    vn, vt, wn, wt, wz = out
    return np.array([vn, vt, vn - R * wt, vt + R * wn]), R * wz


def make_chain(
    rng: np.random.Generator, spin: float, count: int = 3, noise: float = 1.0
) -> tuple[CushionContacts, list[float]]:
    """Let a rolling ball meet `count` cushions, a second apart; also return its side spin before each."""
    physics, rows, spins = make_physics(), [], []
    shares = noise * np.array([SCATTER.velocity] * 2 + [SCATTER.slip] * 2)
    speed = 2.0
    for k in range(count):
        angle = rng.uniform(-1.0, 1.0)
        before = np.array([speed * np.cos(angle), speed * np.sin(angle), 0.0, 0.0])
        spins.append(spin)
        after, left = meet_cushion(before, spin, physics)
        rows.append((before, after + rng.normal(0, 1, 4) * shares * speed, int(k == 0), 0.0 if k == 0 else 1.0))
        spin = float(np.sign(left) * max(abs(left) - DECAY * R, 0.0))
        speed *= 0.8
    before, after, begins, elapsed = (np.array(column) for column in zip(*rows, strict=True))
    zeros, begun = np.zeros(count, np.int64), begins.astype(bool)
    contacts = CushionContacts(
        zeros, zeros, zeros, np.arange(count, dtype=float), before, after,
        np.broadcast_to(1e-8 * np.eye(8), (count, 8, 8)), begins, elapsed, np.where(begun, 1.2, 0.0),
    )  # fmt: skip
    return contacts, spins


@pytest.mark.parametrize("spin", [-1.6, -0.4, 0.0, 0.9])
def test_the_filter_finds_the_side_spin_within_its_own_error(spin: float) -> None:
    contacts, spins = make_chain(np.random.default_rng(1), spin)
    rebounds = predict_rebounds(contacts, HAN, make_physics(), R, M)
    result = filter_side_spin(contacts, rebounds, R, SCATTER, DECAY)
    assert result.before.sum(axis=1) == pytest.approx(1.0)
    spread = np.sqrt((result.before * (result.grid - result.mean_before[:, None]) ** 2).sum(axis=1))
    assert np.all(np.abs(result.mean_before - spins) < 3.5 * spread + 0.03)
    assert spread[-1] < 0.4  # a third of the prior


def test_a_wrong_cushion_model_explains_the_contacts_worse() -> None:
    chains = [make_chain(np.random.default_rng(k), 1.0)[0] for k in range(6)]
    contacts = join_contacts(chains)
    likelihood = {}
    for law in ("mirror", "han_2005"):
        rebounds = predict_rebounds(contacts, CUSHION_MODELS.index(law), make_physics(), R, M)
        likelihood[law] = filter_side_spin(contacts, rebounds, R, SCATTER, DECAY).log_likelihood.sum()
    assert likelihood["han_2005"] > likelihood["mirror"] + 20


def test_braking_loses_speed_towards_zero_and_no_probability() -> None:
    grid = np.linspace(-2, 2, 121)
    start = np.exp(-0.5 * ((grid - 1.0) / 0.05) ** 2)
    start /= start.sum()
    braked = SpinDistribution(grid, brake_spin(grid, start, 0.4, 0.1))
    assert braked.probability.sum() == pytest.approx(1.0)
    assert braked.mean == pytest.approx(0.6, abs=0.01)
    assert braked.sigma == pytest.approx(np.hypot(0.05, 0.1), rel=0.1)
    stopped = SpinDistribution(grid, brake_spin(grid, start, 5.0, 0.0))
    assert stopped.mean == pytest.approx(0.0, abs=1e-6)


def test_draws_have_the_moments_of_their_distribution() -> None:
    grid = np.linspace(-1, 1, 81)
    weight = np.where(grid > 0, 3.0, 1.0) * np.exp(-0.5 * ((np.abs(grid) - 0.5) / 0.1) ** 2)
    spin = SpinDistribution(grid, weight / weight.sum())
    drawn = spin.draw(np.random.default_rng(0), 20_000)
    assert drawn.mean() == pytest.approx(spin.mean, abs=0.02)
    assert drawn.std() == pytest.approx(spin.sigma, rel=0.02)
    assert (drawn > 0).mean() == pytest.approx(0.75, abs=0.02)


def test_learning_recovers_the_parameters_and_the_scatter_of_a_model() -> None:
    rng = np.random.default_rng(5)
    contacts = join_contacts(make_chain(rng, float(spin))[0] for spin in rng.normal(0, 1.0, 40))
    best, other = learn_cushions(contacts, R, M, {"sliding_friction.mu": 0.2}, ("mirror", "han_2005"))
    assert (best.law, other.law) == ("han_2005", "mirror")
    values = {one.name: one for one in best.parameters}
    friction = values["cushion_friction.mu"]
    assert abs(friction.value - 0.22) < 4 * friction.sigma < 0.04
    # speed dependence is fitted too: what counts is the restitution at the speed of the contacts
    slope, power = (values[f"cushion_restitution_{name}"].value for name in ("speed.slope", "power.power"))
    assert values["cushion_restitution.e"].value * 1.2**-power - slope * 1.2 == pytest.approx(0.88, abs=0.01)
    assert best.scatter.velocity == pytest.approx(SCATTER.velocity, rel=0.35)
    assert best.scatter.slip == pytest.approx(SCATTER.slip, rel=0.35)
    rebounds = predict_rebounds(contacts, HAN, best.physics, R, M)
    deviation = filter_side_spin(contacts, rebounds, R, best.scatter, float(best.physics[SPIN_DECAY])).deviation
    assert np.median(np.abs(deviation[:, :2])) < 0.03
