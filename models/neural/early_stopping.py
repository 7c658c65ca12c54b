"""Early stopping: held-out visible samples decide how long a network trains, then it trains as long on all of them.

Goodfellow, Bengio and Courville 2016, "Deep Learning", algorithm 7.2. The samples on which methods are compared are not
used.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.core.typing import FloatArray
from models.neural.common.method_interface import (
    FittedMotion,
    HeldOutSamples,
    MotionMethod,
    TrainingBudget,
    select_holdout,
    validate_samples,
)


@dataclass(frozen=True, slots=True)
class EarlyStopping:
    """A network whose length of training is that of the least error on held-out samples."""

    network: MotionMethod

    @property
    def name(self) -> str:
        """Name in tables: that of the network."""
        return self.network.name

    def fit(
        self, times: FloatArray, states: FloatArray, seed: int = 0, budget: TrainingBudget | None = None
    ) -> FittedMotion:
        """Train on a part of the samples until the error on the others settles, then as long on all samples.

        The motion is not trained (`FittedMotion.is_trained`) if the time limit ends one of both trainings, or if there
        are too few samples to hold any out. Arguments as in `MotionMethod.fit`.
        """
        t, x = validate_samples(times, states)
        whole = budget or TrainingBudget()
        is_held_out = select_holdout(len(t))
        if not is_held_out.any():
            return replace(self.network.fit(t, x, seed, whole), is_trained=False)
        holdout = HeldOutSamples(t[is_held_out], x[is_held_out])
        part = self.network.fit(t[~is_held_out], x[~is_held_out], seed, replace(whole, holdout=holdout))
        remaining = whole.seconds - part.seconds
        if not part.is_trained or remaining <= 0:
            return replace(part, is_trained=False)
        final = self.network.fit(t, x, seed, replace(whole, seconds=remaining, evaluations=len(part.loss_curve)))
        return replace(final, seconds=part.seconds + final.seconds)
