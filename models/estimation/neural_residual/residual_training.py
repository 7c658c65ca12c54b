"""Train the residual of one scene, and say whether it earns its place.

Shots are split: some are fitted, some are looked at to stop in time, and who calls decides on others. A network is
trained from silence in short rounds; training stops where the shots that it did not see are no longer predicted better.
It is switched on only where it predicts them better by a tenth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from models.core.scene import Table
from models.core.typing import FloatArray
from models.estimation.multiple_shooting.fixed_parameters import Held
from models.estimation.multiple_shooting.shooting_fit import Shooting, ShootingOptions, shoot
from models.estimation.neural_residual.residual_windows import ResidualChains, residual_priors
from models.estimation.whole_shot.cushion_chains import SCATTER, Leg
from models.physics.effect import Prior

GAIN = 0.1
"""share of the error on unseen shots that a residual has to take away."""
STRENGTH = 0.1
"""of the prior: what friction and rebounds usually lack, as a share of them."""
LEAD = 0.5
"""s of a chain from which the rest is predicted."""
HORIZON = 2.0
"""s of prediction: longer than that, unseen spin and scatter decide."""
_PHYSICS = ShootingOptions(iterations=20, settling=8)
_ROUND = ShootingOptions(iterations=3, settling=1)
_ROUNDS = 3
_START = ShootingOptions(iterations=8, settling=6)
_POLISH = ShootingOptions(iterations=2, settling=1)


@dataclass(frozen=True, slots=True)
class Residual:
    """A trained correction, and what it gained."""

    on: bool
    """whether it predicted the shots that stopped it better by `GAIN`."""
    trained_weights: tuple[Prior, ...]
    """for `ResidualChains`."""
    trained: FloatArray
    """(P,) physics, then weights, of the best round."""
    physics: FloatArray
    """(8,) fitted without it."""
    error_without: float
    """m, typical open-loop miss of the shots that stopped it."""
    error_with: float
    """m, the same with the best round, which they chose: other shots have to confirm it."""

    @property
    def gain(self) -> float:
        """Share of the error that the best network took away."""
        return 1.0 - self.error_with / self.error_without

    @property
    def weights(self) -> tuple[Prior, ...]:
        """As delivered: none where it is off."""
        return self.trained_weights if self.on else ()

    @property
    def shared(self) -> FloatArray:
        """(P,) as delivered: physics, then the weights where it is on."""
        return self.trained if self.on else self.physics

    def model(self, legs: tuple[Leg, ...], table: Table, law: str, scatter: float = SCATTER) -> ResidualChains:
        """The physics as delivered, for other legs of the scene; `shared` are its values."""
        return ResidualChains(legs, table, law, self.weights, scatter=scatter)


def train_residual(
    fitted: tuple[Leg, ...],
    unseen: tuple[Leg, ...],
    table: Table,
    law: str,
    seed: int,
    scatter: float = SCATTER,
    strength: float = STRENGTH,
) -> Residual:
    """A residual for one scene from `fitted` legs, stopped by `unseen` legs; `seed` places the hidden units."""
    bare = ResidualChains(fitted, table, law, scatter=scatter)
    physics = shoot(bare, options=_PHYSICS)
    without = typical(prediction_errors(replace(bare, legs=unseen), physics.shared))
    weights = residual_priors(strength, seed)
    error, shared = _trained(replace(bare, weights=weights), unseen, physics)
    on = error <= (1.0 - GAIN) * without
    return Residual(on, weights, shared, physics.shared, without, error)


def prediction_errors(model: ResidualChains, shared: FloatArray, lead: float = LEAD) -> FloatArray:
    """(C,) m, RMS miss of each chain, open loop, from `lead` s after its first sample and for `HORIZON` s.

    The start of each chain is fitted to its first `lead` s; cushions and spin then follow from the model alone.
    """
    chains: dict[int, list[Leg]] = {}
    for leg in model.legs:
        chains.setdefault(leg.chain, []).append(leg)
    whole = [_missed(replace(model, legs=tuple(legs)), shared, lead) for legs in chains.values() if not legs[0].tied]
    return np.array([np.sqrt(np.mean(misses**2)) for misses in whole if len(misses)])


def typical(errors: FloatArray) -> float:
    """Geometric mean of errors (C,): a shot that went another way counts once; NaN of nothing."""
    return float(np.exp(np.mean(np.log(np.maximum(errors, 1e-6))))) if len(errors) else float("nan")


def _trained(model: ResidualChains, unseen: tuple[Leg, ...], physics: Shooting) -> tuple[float, FloatArray]:
    """The least error on unseen legs in all rounds, and the shared numbers there."""
    shared = np.concatenate([physics.shared, [prior.value for prior in model.weights]])
    starts, best = physics.starts, (float("inf"), shared)
    for _ in range(_ROUNDS):
        fit = shoot(model, shared, _ROUND, starts)
        shared, starts = fit.shared, fit.starts
        error = typical(prediction_errors(replace(model, legs=unseen), shared))
        if not error < best[0]:
            break
        best = (error, shared)
        if fit.converged:
            break
    return best


def _missed(chain: ResidualChains, shared: FloatArray, lead: float) -> FloatArray:
    """Of one chain."""
    first = chain.legs[0]
    early = first.t <= first.t[0] + lead if len(first.t) else np.empty(0, bool)
    if early.sum() < 5:
        return np.empty(0)
    seen = replace(first, t=first.t[early], xy=first.xy[early], whiten=first.whiten[early], bounce=None)
    lone = replace(chain, legs=(seen,))
    misses: list[FloatArray] = []
    starts: tuple[FloatArray, ...] | None = None
    for model, options in ((lone.without(), _START), (lone, _POLISH)):  # the physics alone is the faster to search with
        count = len(model.unknowns)
        held = Held(model, shared[:count], np.zeros(count, bool), model.unknowns)
        starts = shoot(held, options=options, starts=starts).starts
    state = lone.windows[0].start if starts is None else starts[0]
    for k, leg in enumerate(chain.legs):
        value, _ = chain.glide(state, leg.t - leg.begin, shared)
        ahead = (leg.t > first.t[0] + lead) & (leg.t <= first.t[0] + lead + HORIZON)
        misses.append(np.linalg.norm(value[ahead, :2] - leg.xy[ahead], axis=1))
        if leg.bounce is None or k + 1 == len(chain.legs):
            break
        state, _, _ = chain.hop(leg, state, chain.legs[k + 1].begin, shared)
    return np.concatenate(misses)
