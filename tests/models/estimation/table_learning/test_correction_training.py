"""A network learns what a cushion model lacks, and stays off where the model lacks nothing."""

from __future__ import annotations

import numpy as np
import pytest

from models.estimation.table_learning.correction_training import MIN_GAIN, train_correction
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.learned_table import ContactScatter
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import CUSHION_E, CUSHION_MU, SLIDING_MU, neutral_parameters
from models.physics.billiards.simulation.contact_resolution import rebound

R, M, COUNT = 0.03, 0.2, 400
HAN = CUSHION_MODELS.index("han_2005")
SCATTER = ContactScatter(0.015, 0.05, 0.05)


def make_contacts(lost_roll: float) -> tuple[CushionContacts, np.ndarray]:
    """Contacts of rolling balls, one per shot, on cushions that take another share of the roll than the model."""
    rng = np.random.default_rng(3)
    physics = neutral_parameters()
    physics[[SLIDING_MU, CUSHION_E, CUSHION_MU]] = 0.2, 0.88, 0.2
    before, after = np.zeros((COUNT, 4)), np.zeros((COUNT, 4))
    for k in range(COUNT):
        speed, angle, spin = rng.uniform(0.5, 3.0), rng.uniform(-1.0, 1.0), rng.normal(0, 0.3)
        vn, vt = speed * np.cos(angle), speed * np.sin(angle)
        before[k] = vn, vt, 0.0, 0.0
        an, at, bn, bt, _ = rebound(HAN, vn, vt, -vt / R, vn / R, spin / R, R, M, physics)
        after[k] = an, at, an - R * bt, at + R * bn
        after[k, 2] += lost_roll * vn * vn / speed  # grows with the angle, which no parameter of the model does
        after[k] += rng.normal(0, 1, 4) * speed * np.array([0.015, 0.015, 0.05, 0.05])
    numbers, ones = np.arange(COUNT), np.ones(COUNT, np.int64)
    contacts = CushionContacts(
        numbers, 0 * numbers, 0 * numbers, np.zeros(COUNT), before, after,
        np.broadcast_to(1e-8 * np.eye(8), (COUNT, 8, 8)), ones, np.zeros(COUNT), np.full(COUNT, 0.3),
    )  # fmt: skip
    return contacts, physics


def test_a_missing_effect_is_learned_and_judged_on_other_shots() -> None:
    contacts, physics = make_contacts(0.2)
    trained = train_correction(contacts, HAN, physics, R, M, SCATTER)
    assert trained is not None
    assert trained.is_worthwhile
    assert trained.gain > 0.6


@pytest.mark.parametrize("seed", range(3))
def test_the_correction_of_a_true_model_stays_off(seed: int) -> None:
    contacts, physics = make_contacts(0.0)
    trained = train_correction(contacts, HAN, physics, R, M, SCATTER, seed)
    assert trained is not None
    assert trained.gain < MIN_GAIN


def test_few_contacts_train_nothing() -> None:
    contacts, physics = make_contacts(0.2)
    part = contacts.select_chains(np.arange(COUNT) < 100)
    assert train_correction(part, HAN, physics, R, M, SCATTER) is None
