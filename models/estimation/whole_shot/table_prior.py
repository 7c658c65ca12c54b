"""A table that is known beforehand: by which laws things touch there, and its numbers with their errors."""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.physics.billiards.parameters import NAMES, USES
from models.physics.billiards.simulation.parametrised_shot import Laws
from models.physics.effect import Prior
from models.physics.effects.catalogue import prior_of

LEAST = 0.01
"""of the usual error: a table is not the same on two days."""


@dataclass(frozen=True, slots=True)
class KnownTable:
    """What an earlier diagnosis or fit told of a table."""

    laws: Laws
    priors: tuple[Prior, ...]
    """named as in `parameters.NAMES`."""

    def among(self, usual: tuple[Prior, ...]) -> tuple[Prior, ...]:
        """The usual priors, those of the table in their place; and those of further effects that it has."""
        known = {prior.name: prior for prior in self.priors}
        used = {*USES[self.laws.cushion], *USES[self.laws.ball]}
        further = [
            prior
            for prior in self.priors
            if prior.name not in {one.name for one in usual}
            and (prior.name in used or not prior.name.startswith(("cushion", "ball")))
        ]
        return (*(known.get(prior.name, prior) for prior in usual), *further)


def known_table(cushion: str, ball: str, effects: dict[str, tuple[float, float | None]]) -> KnownTable:
    """From laws and, by `effect.parameter`, values and standard deviations, None where only the value is known.

    ValueError for a name that is none of the physics of a table, or a value that no table has.
    """
    priors = []
    for name, (value, sigma) in effects.items():
        if name not in NAMES:
            raise ValueError(f"a table has {', '.join(NAMES)}; it has no {name}")
        usual = prior_of(*name.split("."))
        spread = usual.sigma * (abs(usual.value) if usual.relative else 1.0)
        low, high = min(usual.bounds[0], 0.0), usual.bounds[1]
        if not low <= value <= high:
            raise ValueError(f"{name} is between {low:g} and {high:g}; got {value:g}")
        width = spread if sigma is None else max(sigma, LEAST * spread)
        priors.append(replace(usual, name=name, value=value, sigma=width, relative=False, bounds=(low, high)))
    return KnownTable(Laws(cushion, ball), tuple(priors))
