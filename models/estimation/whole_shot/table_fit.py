"""The physics of a table from whole shots: its numbers with their errors, and the laws that explain the shots best."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from models.core.fit_result import Parameter
from models.core.scene import CUSHIONS, Table
from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.shooting_fit import Shooting, ShootingOptions, parameters_of, priors_of, shoot
from models.estimation.whole_shot.continuation_fit import grown, grown_if_lawful
from models.estimation.whole_shot.cushion_chains import NOSE_SIGMA
from models.estimation.whole_shot.shot_segments import Stretch
from models.estimation.whole_shot.shot_windows import Shots
from models.estimation.whole_shot.table_prior import KnownTable
from models.physics.billiards.parameters import NAMES, USES
from models.physics.billiards.simulation.parametrised_shot import ABSENT, MOVING, NUMBERS, Laws, sizes, unpacked
from models.physics.effect import Prior
from models.physics.effects.catalogue import prior_of

CANDIDATES = tuple(Laws(cushion, "inelastic") for cushion in ("mirror", "han_2005", "mathavan_2010", "stronge"))
CLOTH = ("sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate")
FACTOR_SIGMA = 0.01
"""of the distance at which balls touch, over two radii: what a calibration leaves open."""
_CLEAR = 4.0
"""standard deviations."""
_SEED = 2010
"""of what is drawn where a caller brings no generator: the same shots give the same fit."""
_EXPLAINED = 1.3
"""chi2 per degree of freedom up to which the laws are taken to explain a shot."""
_RIGHT = 1.1
"""the same, below which the states are taken to be about right, whatever the laws."""


@dataclass(frozen=True, slots=True)
class TableFit:
    """What whole shots tell of a table."""

    laws: Laws
    parameters: tuple[Parameter, ...]
    chi2_per_dof: float
    converged: bool
    states: tuple[FloatArray, ...]
    """per stretch (N, 7), as `playing` counts them: place, velocity, slip, surface speed of side spin."""
    covariances: tuple[FloatArray, ...]
    """per stretch (N, 7, 7) of each ball's state; 0 for the velocities and spins of a ball that lies."""
    evidence: tuple[tuple[Laws, float], ...]
    """log evidence of every candidate, divided by the lack of fit of the best; the best one first."""

    @property
    def explained(self) -> bool:
        """Whether these laws and numbers say what was seen, to the noise that was promised."""
        return self.converged and self.chi2_per_dof < _EXPLAINED


_UNTOLD = ("cushion_restitution_power.power",)
"""what a few shots cannot tell beside how restitution falls in proportion to the speed; absent."""


def unknowns_of(laws: Laws) -> tuple[Prior, ...]:
    """What is sought under these laws: cloth, restitution and friction, the size of the balls, and the noses."""
    used = (*USES[laws.cushion], *USES[laws.ball])
    names = [name for name in NAMES if name not in _UNTOLD and (name in CLOTH or name in used)]
    physics = [_prior(name) for name in names]
    size = Prior("collision_radius.factor", "1", 1.0, FACTOR_SIGMA, False, (0.95, 1.05))
    noses = [Prior(f"nose.{side}", "m", 0.0, NOSE_SIGMA, False, (-0.03, 0.03)) for side in CUSHIONS]
    return (*physics, size, *noses)


def _prior(name: str) -> Prior:
    """Of the catalogue, where it holds it; but balls and cushions may have no friction, as those of many simulators."""
    prior = replace(prior_of(*name.split(".")), name=name)
    if name not in ("ball_friction.mu", "cushion_friction.mu"):
        return prior
    return replace(prior, sigma=prior.value, relative=False, bounds=(0.0, prior.bounds[1]))


def fit_table(
    stretches: tuple[Stretch, ...], table: Table, candidates: tuple[Laws, ...] = CANDIDATES,
    options: ShootingOptions | None = None, rng: np.random.Generator | None = None,
) -> TableFit:  # fmt: skip
    """Fit whole shots under every candidate; the one with the largest evidence is reported.

    ValueError where there is nothing to fit.
    """
    if not stretches or not candidates:
        raise ValueError(f"a fit needs shots and laws; got {len(stretches)} stretches and {len(candidates)} laws")
    models = {laws: Shots(stretches, table, unknowns_of(laws), laws) for laws in candidates}
    return _compared(models, options, rng)


def fit_known(stretches: tuple[Stretch, ...], table: Table, known: KnownTable) -> TableFit:
    """Fit whole shots on a table that is known: by its laws, from its numbers, and with its further effects.

    ValueError where there is nothing to fit.
    """
    if not stretches:
        raise ValueError("a fit needs shots; got none")
    return _compared(
        {known.laws: Shots(stretches, table, known.among(unknowns_of(known.laws)), known.laws)}, None, None
    )


def _compared(models: dict[Laws, Shots], options: ShootingOptions | None, rng: np.random.Generator | None) -> TableFit:
    """The fit of greatest evidence."""
    asked = ShootingOptions() if options is None else options
    chance = np.random.default_rng(_SEED) if rng is None else rng
    stretches = next(iter(models.values())).stretches
    begun = _lawful(models, asked, chance) if len(models) > 1 else []
    tried = list(begun)
    for laws in (one for one in models if one not in [other for other, _ in tried]):
        tried.append((laws, _under(models[laws], tried, asked, chance)))
    ranked = _ranked(tried)
    if begun and ranked[0][0] != begun[0][0]:  # spins that suit other laws may have led its own astray
        tried += _lawful({ranked[0][0]: models[ranked[0][0]]}, asked, chance)
        ranked = _ranked(tried)
    least = max(1.0, min(found.chi2_per_dof for _, found in ranked))
    laws, best = ranked[0]
    return TableFit(
        laws, parameters_of(models[laws].unknowns, best), best.chi2_per_dof, best.converged,
        tuple(unpacked(start, one.moving) for start, one in zip(best.starts, stretches, strict=True)),
        tuple(_by_ball(all_of, one.moving) for all_of, one in zip(best.start_covariances, stretches, strict=True)),
        tuple((one, found.log_evidence / least) for one, found in ranked),
    )  # fmt: skip


def _ranked(tried: list[tuple[Laws, Shooting]]) -> list[tuple[Laws, Shooting]]:
    """The best fit under each law, that of the largest evidence first."""
    best: dict[Laws, Shooting] = {}
    for laws, found in tried:
        if laws not in best or found.cost < best[laws].cost:
            best[laws] = found
    return sorted(best.items(), key=lambda one: -one[1].log_evidence)


def _lawful(
    models: dict[Laws, Shots], options: ShootingOptions, rng: np.random.Generator
) -> list[tuple[Laws, Shooting]]:
    """The first laws under which the search finds its way through all shots, if any: the others can begin there."""
    for laws, model in models.items():
        numbers = list(dict.fromkeys(one.shot for one in model.stretches))
        usual, alone = _usual(model), {}
        for number in numbers:
            found = grown_if_lawful(_only(model, [number]), usual, rng, options)
            if found is None:
                break
            alone[number] = found
        else:
            return [(laws, _joined(model, alone, options, rng))]
    return []


def _under(
    model: Shots, others: list[tuple[Laws, Shooting]], options: ShootingOptions, rng: np.random.Generator
) -> Shooting:
    """The fit under the laws of a model: begun where other laws explain the shots best, for there the states are about
    right, whatever the laws; and from what was seen alone, where no laws explain them yet."""
    if not others:
        return searched(model, options, rng)
    laws, near = min(others, key=lambda one: one[1].cost)
    told = {prior.name: value for prior, value in zip(unknowns_of(laws), near.shared, strict=True)}
    shared = np.array([told.get(prior.name, prior.value) for prior in model.unknowns])
    found = shoot(model, shared, options, near.starts)
    if any(one.converged and one.chi2_per_dof < _RIGHT for one in (near, found)):
        return found
    return min([found, searched(model, options, rng)], key=lambda one: one.cost)


def searched(
    model: Shots, options: ShootingOptions, rng: np.random.Generator, guess: FloatArray | None = None
) -> Shooting:
    """All shots together, begun from each alone, and each of those with the numbers `guess` (P,), the usual ones where
    not given.

    Which first guess of a spin is right shows once the table is known. So shots that are explained alone tell of the
    table first, the others are sought with what those have told, and only then all are fitted.
    """
    numbers = list(dict.fromkeys(one.shot for one in model.stretches))
    usual = _usual(model) if guess is None else guess
    return _joined(model, {one: grown(_only(model, [one]), usual, rng, options) for one in numbers}, options, rng)


def _usual(model: Shots) -> FloatArray:
    """(P,) numbers that most tables have."""
    return np.array([prior.value for prior in model.unknowns])


def _joined(model: Shots, alone: dict[int, Shooting], options: ShootingOptions, rng: np.random.Generator) -> Shooting:
    """All shots together, from the fit of each alone."""
    numbers = list(alone)
    if len(numbers) == 1:
        return alone[numbers[0]]
    good = [number for number in numbers if alone[number].chi2_per_dof < _RIGHT]
    good = good or [min(numbers, key=lambda number: alone[number].chi2_per_dof)]
    first = alone[min(good, key=lambda number: float(np.log(alone[number].sigma).sum()))]
    told = _together(model, good, alone, first.shared, options)
    for number in (one for one in numbers if one not in good):
        known = replace(_only(model, [number]), unknowns=priors_of(model.unknowns, told))
        other = grown(known, told.shared, rng, options)
        if other.chi2_per_dof < alone[number].chi2_per_dof:
            alone[number] = other
    if len(good) < len(numbers):
        told = _together(model, numbers, alone, told.shared, options)
    return told if _agree(model, alone, told) else _reconciled(model, alone, told, options, rng)


def _agree(model: Shots, alone: dict[int, Shooting], told: Shooting) -> bool:
    """Whether one set of numbers costs no more than noise explains over a set for each shot."""
    ties = len(model.unknowns) * (len(alone) - 1)
    return bool(told.cost - sum(one.cost for one in alone.values()) < ties + _CLEAR * np.sqrt(2 * ties) + 1)


def _reconciled(
    model: Shots, alone: dict[int, Shooting], told: Shooting, options: ShootingOptions, rng: np.random.Generator
) -> Shooting:
    """Shots that do not agree: one of them may have found a wrong spin with numbers to match, so that each is sought
    once more with what the others tell."""
    numbers = list(alone)
    for number in numbers:
        others = _together(model, [one for one in numbers if one != number], alone, told.shared, options)
        known = replace(_only(model, [number]), unknowns=priors_of(model.unknowns, others))
        again = {**alone, number: grown(known, others.shared, rng, options)}
        found = _together(model, numbers, again, others.shared, options)
        if found.cost < told.cost - 1.0:
            alone, told = again, found
    return told


def _only(model: Shots, numbers: list[int]) -> Shots:
    """The model of some of its shots."""
    return replace(model, stretches=tuple(one for one in model.stretches if one.shot in numbers))


def _together(
    model: Shots, numbers: list[int], alone: dict[int, Shooting], shared: FloatArray, options: ShootingOptions
) -> Shooting:
    """Some shots in one fit, each begun where it was alone."""
    starts = tuple(start for number in numbers for start in alone[number].starts)
    return shoot(_only(model, numbers), shared, options, starts)


def _by_ball(covariance: FloatArray, moving: BoolArray) -> FloatArray:
    """(N, 7, 7) of each ball, from (S, S) of a start."""
    found, at = np.zeros((len(moving), MOVING, MOVING)), sizes(moving)
    for k, (first, after) in enumerate(pairwise(at)):
        found[k, : after - first, : after - first] = covariance[first:after, first:after]
    return found


def numbers_of(fitted: TableFit) -> FloatArray:
    """(Q,) all numbers of `playing.NUMBERS` that a fit stands for."""
    values = ABSENT.copy()
    for parameter in fitted.parameters:
        values[NUMBERS.index(parameter.name)] = parameter.value
    return values
