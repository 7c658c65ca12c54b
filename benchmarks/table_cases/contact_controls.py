"""Controls of the network: contacts that obey the learned model, and contacts of a cushion of no published form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from benchmarks.table_cases.foreign_cushion import rebound_from_pad
from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.table_learning.correction_training import measure_gain, split_shots, train_correction
from models.estimation.table_learning.cushion_contacts import CushionContacts
from models.estimation.table_learning.cushion_learning import learn_cushions
from models.estimation.table_learning.learned_table import LearnedTable
from models.estimation.table_learning.side_spin import MIN_CONTACT_SPEED, predict_rebounds
from models.physics.billiards.contact_models import CUSHION_MODELS
from models.physics.billiards.parameter_vector import SLIDING_MU, SPIN_DECAY
from models.physics.billiards.simulation.contact_resolution import rebound_with_slip

# Maps states (K, 5) before contacts to those after.
Rebound = Callable[[FloatArray], FloatArray]


def simulate_contacts(
    contacts: CushionContacts, rebound: Rebound, learned: LearnedTable, table: Table, rng: np.random.Generator
) -> CushionContacts:
    """Replace the states after contacts by those of a cushion, with the learned scatter and the errors of the fit."""
    radius, after, spin = table.ball_radius, np.empty_like(contacts.after), 0.0
    for k in range(len(after)):
        changed = contacts.spin_sigma[k] * rng.standard_normal()
        spin = changed if contacts.begins[k] else spin + changed
        loss = learned.physics[SPIN_DECAY] * radius * contacts.elapsed[k]
        spin = float(np.sign(spin) * max(abs(spin) - loss, 0.0))
        left = rebound(np.append(contacts.before[k], spin)[None])[0]
        left += max(contacts.speed[k], MIN_CONTACT_SPEED) * learned.scatter.draw(rng, ())
        after[k] = left[:4] + rng.multivariate_normal(np.zeros(4), contacts.covariance[k, 4:, 4:], method="eigh")
        spin = float(left[4])
    return replace(contacts, after=after)


def count_false_corrections(learned: LearnedTable, contacts: CushionContacts, table: Table, count: int) -> int:
    """Count how often a network is switched on where the contacts obey the learned model and scatter about it."""

    def obey(before: FloatArray) -> FloatArray:
        left = np.empty(5)
        rebound_with_slip(learned.law_code, before[0], table.ball_radius, table.ball_mass, learned.physics, left)
        return left[None]

    switched_on = 0
    for seed in range(count):
        simulated = simulate_contacts(contacts, obey, learned, table, np.random.default_rng([34, seed]))
        trained = train_correction(
            simulated, learned.law_code, learned.physics, table.ball_radius, table.ball_mass, learned.scatter, seed
        )
        switched_on += trained is not None and trained.is_worthwhile
    return switched_on


def measure_foreign_gains(
    learned: LearnedTable, contacts: CushionContacts, table: Table, seed: int
) -> tuple[float, float]:
    """Measure what the network and an oracle gain over the best fit of the published model on a foreign cushion.

    Returns:
        Shares of the mean squared deviation of reporting shots that the network removes, and that the true cushion
        does; the scatter about the cushion remains.
    """
    size = table.ball_radius, table.ball_mass
    simulated = simulate_contacts(contacts, rebound_from_pad, learned, table, np.random.default_rng([35, seed]))
    cloth = {"sliding_friction.mu": float(learned.physics[SLIDING_MU])}
    fit = learn_cushions(simulated, *size, cloth, (learned.cushion_law,))[0]
    law, decay = CUSHION_MODELS.index(fit.law), float(fit.physics[SPIN_DECAY])
    trained = train_correction(simulated, law, fit.physics, *size, fit.scatter, seed)
    plain = predict_rebounds(simulated, law, fit.physics, *size)
    count, width = plain.grid.shape
    before = np.concatenate([np.repeat(simulated.before, width, axis=0), plain.grid.reshape(-1, 1)], axis=1)
    oracle = replace(plain, predicted=rebound_from_pad(before).reshape(count, width, 5))
    part = split_shots(simulated, np.random.default_rng(seed))
    gain = measure_gain(simulated, plain, oracle, part == 2, table.ball_radius, fit.scatter, decay)
    return (0.0 if trained is None else trained.gain), gain
