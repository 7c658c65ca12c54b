"""Prior knowledge of a table: its contact models, and its parameters with errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.physics.billiards.parameter_vector import TABLE_PARAMETERS
from models.physics.billiards.simulation.parametrised_shot import ContactModels
from models.physics.billiards.simulation.table_physics import contact_parameters
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# Least prior sigma, as a share of the default: a table is not the same on two days.
MIN_RELATIVE_SIGMA = 0.01


@dataclass(frozen=True, slots=True)
class TablePrior:
    """Contact models and parameters of a table from an earlier diagnosis or fit."""

    laws: ContactModels
    priors: tuple[Prior, ...]
    """Named as in `models.physics.billiards.parameter_vector`."""

    def merge_priors(self, default_priors: tuple[Prior, ...]) -> tuple[Prior, ...]:
        """Replace default priors by those of the table, and append its further effects."""
        own = {prior.name: prior for prior in self.priors}
        used = set(contact_parameters(self.laws.cushion, self.laws.ball))
        further = [
            prior
            for prior in self.priors
            if prior.name not in {one.name for one in default_priors}
            and (prior.name in used or not prior.name.startswith(("cushion", "ball")))
        ]
        return (*(own.get(prior.name, prior) for prior in default_priors), *further)


def build_table_prior(cushion: str, ball: str, effects: dict[str, tuple[float, float | None]]) -> TablePrior:
    """Build the prior of a table from contact models and parameter values.

    Args:
        cushion: Name of the cushion contact model.
        ball: Name of the ball contact model.
        effects: Value and standard deviation by `effect.parameter`; None where only the value is known.

    Returns:
        The prior.

    Raises:
        ValueError: A name is not a parameter of a table, or a value is out of bounds.
    """
    priors = []
    for name, (value, sigma) in effects.items():
        if name not in TABLE_PARAMETERS:
            raise ValueError(f"a table has {', '.join(TABLE_PARAMETERS)}; it has no {name}")
        default = find_prior(*name.split("."))
        spread = default.sigma * (abs(default.value) if default.relative else 1.0)
        low, high = min(default.bounds[0], 0.0), default.bounds[1]
        if not low <= value <= high:
            raise ValueError(f"{name} is between {low:g} and {high:g}; got {value:g}")
        width = spread if sigma is None else max(sigma, MIN_RELATIVE_SIGMA * spread)
        priors.append(replace(default, name=name, value=value, sigma=width, relative=False, bounds=(low, high)))
    return TablePrior(ContactModels(cushion, ball), tuple(priors))
