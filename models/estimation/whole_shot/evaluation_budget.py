"""Budget of a search, in evaluations of its model: unlike a time limit, it gives the same result on every machine."""

from __future__ import annotations

from dataclasses import dataclass

DEFAULT_BUDGET = 5000.0
"""Simulations of a short view that the search of an ordinary run may cost: 2 to 3 s on a core of 2020, measured on
carom and pool clips with two to four moving balls (0.4 to 0.6 ms each)."""
_OBSERVATIONS_PER_SIMULATION = 150.0
"""Observations whose prediction takes as long as the simulation itself, measured."""
_LINEARIZATION = 2.0
"""Duration of a simulation with derivatives over one without them, measured."""
_INTEGRATED_MODELS = {"mathavan_2010": 8.0}
"""Further duration of the derivatives where a contact model is integrated numerically, in simulations, measured."""


class BudgetSpent(Exception):
    """The evaluations of a search are used up."""


@dataclass(slots=True)
class EvaluationBudget:
    """Evaluations that remain for a search; all models of the search share it."""

    remaining: float = DEFAULT_BUDGET
    """Simulations of a short view."""

    def spend(self, observations: int, cushion_model: str = "", linearized: bool = False) -> None:
        """Take one evaluation of a model.

        Args:
            observations: Number of observed positions that it predicts.
            cushion_model: Name of its cushion model.
            linearized: Whether it evaluates derivatives.

        Raises:
            BudgetSpent: Less remains than the evaluation costs.
        """
        cost = 1.0 + observations / _OBSERVATIONS_PER_SIMULATION
        if linearized:
            cost = _LINEARIZATION * cost + _INTEGRATED_MODELS.get(cushion_model, 0.0)
        if cost > self.remaining:
            self.remaining = 0.0
            raise BudgetSpent
        self.remaining -= cost
