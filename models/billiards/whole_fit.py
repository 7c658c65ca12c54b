"""The physics of a table from whole shots: its numbers with their errors, and the laws that explain the shots best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.billiards.cushion_chains import NOSE_SIGMA
from models.billiards.parameters import NAMES, USES
from models.billiards.playing import ABSENT, NUMBERS, Laws
from models.billiards.shots import Shots
from models.billiards.stretches import Stretch
from models.effects.catalogue import prior_of
from models.effects.effect import Prior
from models.fit import Parameter
from models.scene import CUSHIONS, Table
from models.shooting import Shooting, ShootingOptions, parameters_of, priors_of, shoot

Floats = NDArray[np.float64]

CANDIDATES = tuple(Laws(cushion, "inelastic") for cushion in ("mirror", "han_2005", "mathavan_2010", "stronge"))
CLOTH = ("sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate")
FACTOR_SIGMA = 0.003
"""of the distance at which balls touch, over two radii: what a calibration leaves open."""
_EXPLAINED = 1.3
"""chi2 per degree of freedom up to which the laws are taken to explain a shot."""

_RIGHT = 1.1
"""the same, below which nothing else is tried."""
_ROUNDS = 2
"""in which all first guesses are tried once more, with what is known of the table by then."""


@dataclass(frozen=True, slots=True)
class TableFit:
    """What whole shots tell of a table."""

    laws: Laws
    parameters: tuple[Parameter, ...]
    chi2_per_dof: float
    converged: bool
    starts: tuple[Floats, ...]
    """per stretch, as `playing` has them."""
    evidence: tuple[tuple[Laws, float], ...]
    """log evidence of every candidate, divided by the lack of fit of the best; the best one first."""


def unknowns_of(laws: Laws) -> tuple[Prior, ...]:
    """What is sought under these laws: cloth, restitution and friction, the size of the balls, and the noses."""
    used = (*USES[laws.cushion], *USES[laws.ball])
    names = [name for name in NAMES if name in CLOTH or name in used]
    physics = [replace(prior_of(*name.split(".")), name=name) for name in names if not name.endswith("speed.slope")]
    size = Prior("collision_radius.factor", "1", 1.0, FACTOR_SIGMA, False, (0.95, 1.05))
    noses = [Prior(f"nose.{side}", "m", 0.0, NOSE_SIGMA, False, (-0.03, 0.03)) for side in CUSHIONS]
    return (*physics, size, *noses)


def fit_table(
    stretches: tuple[Stretch, ...], table: Table, candidates: tuple[Laws, ...] = CANDIDATES,
    options: ShootingOptions | None = None,
) -> TableFit:  # fmt: skip
    """Fit whole shots under every candidate; the one with the largest evidence is reported.

    ValueError where there is nothing to fit.
    """
    if not stretches or not candidates:
        raise ValueError(f"a fit needs shots and laws; got {len(stretches)} stretches and {len(candidates)} laws")
    asked = ShootingOptions() if options is None else options
    tried = [(laws, searched(Shots(stretches, table, unknowns_of(laws), laws), asked)) for laws in candidates]
    least = max(1.0, min(found.chi2_per_dof for _, found in tried))
    ranked = sorted(tried, key=lambda one: -one[1].log_evidence)
    laws, best = ranked[0]
    return TableFit(
        laws, parameters_of(unknowns_of(laws), best), best.chi2_per_dof, best.converged, best.starts,
        tuple((one, found.log_evidence / least) for one, found in ranked),
    )  # fmt: skip


def searched(model: Shots, options: ShootingOptions) -> Shooting:
    """All shots together, begun from each alone.

    Which first guess of a spin is right shows once the table is known. So shots that are explained alone tell of the
    table first, the others are sought with what those have told, and only then all are fitted.
    """
    numbers = sorted({one.shot for one in model.stretches})
    alone = {number: shoot(_only(model, [number]), None, options) for number in numbers}
    good = [number for number in numbers if alone[number].chi2_per_dof < _EXPLAINED]
    good = good or [min(numbers, key=lambda number: alone[number].chi2_per_dof)]
    first = alone[min(good, key=lambda number: float(np.log(alone[number].sigma).sum()))]
    told = _together(model, good, alone, first.shared, options)
    for number in set(numbers) - set(good):
        known = replace(_only(model, [number]), unknowns=priors_of(model.unknowns, told))
        other = shoot(known, told.shared, options)
        if other.chi2_per_dof < alone[number].chi2_per_dof:
            alone[number] = other
    if len(good) < len(numbers):
        told = _together(model, numbers, alone, told.shared, options)
    for _ in range(_ROUNDS):
        if told.chi2_per_dof < _RIGHT:
            break
        again = shoot(model, told.shared, options)
        if not again.cost < told.cost - 1.0:
            break
        told = again
    return told


def _only(model: Shots, numbers: list[int]) -> Shots:
    """The model of some of its shots."""
    return replace(model, stretches=tuple(one for one in model.stretches if one.shot in numbers))


def _together(
    model: Shots, numbers: list[int], alone: dict[int, Shooting], shared: Floats, options: ShootingOptions
) -> Shooting:
    """Some shots in one fit, each begun where it was alone."""
    starts = tuple(start for number in numbers for start in alone[number].starts)
    return shoot(_only(model, numbers), shared, options, starts)


def numbers_of(fitted: TableFit) -> Floats:
    """(Q,) all numbers of `playing.NUMBERS` that a fit stands for."""
    values = ABSENT.copy()
    for parameter in fitted.parameters:
        values[NUMBERS.index(parameter.name)] = parameter.value
    return values
