"""Fit of a table's physics to whole shots: parameters with errors, and the contact models of greatest evidence."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from models.core.fit_result import Parameter
from models.core.scene import CUSHIONS, Table
from models.core.typing import BoolArray, FloatArray
from models.estimation.multiple_shooting.posterior_samples import GaussianPosterior
from models.estimation.multiple_shooting.shooting_fit import (
    ShootingFit,
    ShootingOptions,
    convert_to_priors,
    fit_windows,
    summarize_parameters,
)
from models.estimation.whole_shot.continuation_fit import UnexplainedView, fit_by_continuation, fit_if_explained
from models.estimation.whole_shot.known_table import TablePrior
from models.estimation.whole_shot.shot_segments import ShotSegment
from models.estimation.whole_shot.shot_windows import ShotWindows
from models.physics.billiards.parameter_vector import PARAMETER_NAMES
from models.physics.billiards.simulation.parametrised_shot import (
    MOVING_BALL_SIZE,
    SIDE_SPIN,
    ContactModels,
    pack_start,
    start_offsets,
    unpack_start,
)
from models.physics.billiards.simulation.table_physics import contact_parameters
from models.physics.billiards.tables import NOSE_SIGMA
from models.physics.effect import Prior
from models.physics.effects.billiards_catalogue import find_prior

# Pairs of contact models; first those that came nearest to recorded tables.
CANDIDATE_LAWS = tuple(
    ContactModels(cushion, "inelastic") for cushion in ("han_2005", "mathavan_2010", "mirror", "stronge")
)
CLOTH_PARAMETERS = ("sliding_friction.mu", "rolling_resistance.mu", "spin_decay.rate")
# Prior standard deviation of the distance at which balls touch over two radii: uncertainty of a calibration.
FACTOR_SIGMA = 0.01
# Logarithm of a decisive Bayes factor (Kass and Raftery 1995, doi:10.1080/01621459.1995.10476572).
DECISIVE_LOG_EVIDENCE = float(np.log(150.0))
# Standard deviations that count as significant.
_SIGNIFICANT_SIGMAS = 4.0
# Random seed: the same shots give the same fit.
_DEFAULT_SEED = 2010
# chi2 per degree of freedom up to which the contact models explain a shot.
_EXPLAINED_CHI2 = 1.3
# chi2 per degree of freedom up to which the states are nearly right, whichever the contact models.
_GOOD_CHI2 = 1.1


@dataclass(frozen=True, slots=True)
class ShotSample:
    """A posterior sample of the first segment."""

    start: FloatArray
    """(S,) as in `parametrised_shot`."""
    values: FloatArray
    """(Q,) all parameters."""
    ball_model: str
    """Contact model of two balls."""


@dataclass(frozen=True, slots=True)
class TableFit:
    """The physics of a table fitted to whole shots."""

    laws: ContactModels
    parameters: tuple[Parameter, ...]
    chi2_per_dof: float
    converged: bool
    states: tuple[FloatArray, ...]
    """Per segment (N, 7), as in `parametrised_shot`: position, velocity, slip, surface speed of side spin."""
    covariances: tuple[FloatArray, ...]
    """Per segment (N, 7, 7) of each ball's state; 0 for velocities and spins of a resting ball."""
    evidence: tuple[tuple[ContactModels, float], ...]
    """Log evidence of every candidate, divided by the lack of fit of the best; the best one first."""
    samples: tuple[ShotSample, ...] = ()
    """Posterior samples; empty if they were not requested, or nothing explains the shots."""

    @property
    def equal_models(self) -> tuple[str, ...]:
        """Cushion models whose evidence is no decisive reason against them, without the best one."""
        highest = self.evidence[0][1]
        return tuple(laws.cushion for laws, log in self.evidence[1:] if log > highest - DECISIVE_LOG_EVIDENCE)

    @property
    def is_explained(self) -> bool:
        """Whether contact models and parameters explain the observations to within their nominal noise."""
        return self.converged and self.chi2_per_dof < _EXPLAINED_CHI2


@dataclass(frozen=True, slots=True)
class LawSearch:
    """Result of a search for contact models that explain whole shots."""

    best: TableFit
    """The fit of greatest evidence."""
    unexplained: tuple[tuple[ContactModels, UnexplainedView], ...]
    """The first view that each pair of contact models does not explain; the longest explained part first."""


# Posterior samples of a fit: standard deviations are known to 6 %.
POSTERIOR_SAMPLES = 128
# Laws of friction between balls, and factors on the side spin of the best fit, that are tried besides it.
_RIVAL_BALL_LAWS, _RIVAL_SIDE_SPINS = ("inelastic", "alciatore"), (-1.0, 0.0)
# Of a fit below the best one: its samples would be fewer than one.
_LEAST_LOG_EVIDENCE = -7.0
# Samples that correct the Laplace approximation of the evidence of one fit.
_EVIDENCE_SAMPLES = 40
# m/s: fits whose side spins differ by less are one.
_SAME_SIDE_SPIN = 0.02
# Of contact models that start from the states of another: they are near, or do not fit.
_RIVAL_OPTIONS = ShootingOptions(iterations=15)
# Left out: a few shots do not separate the first from a restitution that falls in proportion to the speed, nor the
# second from restitution and friction; the noses then have the height of their contact model.
_NOT_IDENTIFIABLE = ("cushion_restitution_power.power", "cushion_height.ratio")


def table_priors(laws: ContactModels) -> tuple[Prior, ...]:
    """Build the priors of a fit with these contact models.

    Args:
        laws: Contact models of cushions and balls.

    Returns:
        Priors of cloth, restitution and friction, size of the balls, and nose offsets.
    """
    used = contact_parameters(laws.cushion, laws.ball)
    names = [
        name for name in PARAMETER_NAMES if name not in _NOT_IDENTIFIABLE and (name in CLOTH_PARAMETERS or name in used)
    ]
    physics = [_table_prior(name) for name in names]
    size = Prior("collision_radius.factor", "1", 1.0, FACTOR_SIGMA, False, (0.95, 1.05))
    noses = [Prior(f"nose.{side}", "m", 0.0, NOSE_SIGMA, False, (-0.03, 0.03)) for side in CUSHIONS]
    return (*physics, size, *noses)


def _table_prior(name: str) -> Prior:
    """Look up a prior in the catalogue, and allow zero friction of balls and cushions, as in many simulators."""
    prior = replace(find_prior(*name.split(".")), name=name)
    if name not in ("ball_friction.mu", "cushion_friction.mu"):
        return prior
    return replace(prior, sigma=prior.value, relative=False, bounds=(0.0, prior.bounds[1]))


def search_laws(
    segments: tuple[ShotSegment, ...], table: Table, table_prior: TablePrior | None = None,
    candidates: tuple[ContactModels, ...] = CANDIDATE_LAWS, is_sampled: bool = True,
) -> LawSearch:  # fmt: skip
    """Search for contact models that explain whole shots.

    Args:
        segments: Segments of all shots.
        table: Dimensions of the table.
        table_prior: Contact models and parameters of an earlier fit, with further effects; None: all candidates.
        candidates: Pairs of contact models; those of `table_prior` where it is given.
        is_sampled: Whether a fit that explains the shots has posterior samples.

    Returns:
        The best fit, and where each model stops to explain the shots.

    Raises:
        ValueError: There is no segment.
    """
    if not segments:
        raise ValueError("a fit needs shots; got none")
    if table_prior is None:
        priors = {laws: table_priors(laws) for laws in candidates}
    else:
        priors = {table_prior.laws: table_prior.merge_priors(table_priors(table_prior.laws))}
    models = {laws: ShotWindows(segments, table, own, laws) for laws, own in priors.items()}
    views: dict[ContactModels, UnexplainedView] = {}
    fits = _fit_all(models, np.random.default_rng(_DEFAULT_SEED), views)
    return LawSearch(
        _summarize_best(models, fits, is_sampled),
        tuple(sorted(views.items(), key=lambda one: -one[1].explained_until)),
    )


def _fit_all(
    models: dict[ContactModels, ShotWindows], rng: np.random.Generator, views: dict[ContactModels, UnexplainedView]
) -> list[tuple[ContactModels, ShootingFit]]:
    """Fit every model; `views` receives the first view that each of several does not explain."""
    fits = _fit_first_explaining(models, rng, views) if len(models) > 1 else []
    first = [laws for laws, _ in fits]
    for laws in (one for one in models if one not in first):
        fits.append((laws, _fit_laws(models[laws], fits, rng)))
    best = _rank_by_evidence(fits)[0][0]
    if first and best != first[0]:  # spins that suit other contact models may have misled its fit
        fits += _fit_first_explaining({best: models[best]}, rng, {})
    return fits


def _summarize_best(
    models: dict[ContactModels, ShotWindows], fits: list[tuple[ContactModels, ShootingFit]], is_sampled: bool
) -> TableFit:
    """Summarize the fit of greatest evidence, with posterior samples if it explains the shots."""
    ranked = _rank_by_evidence(fits)
    segments = next(iter(models.values())).segments
    least = max(1.0, min(fit.chi2_per_dof for _, fit in ranked))
    laws, best = ranked[0]
    return TableFit(
        laws, summarize_parameters(models[laws].unknowns, best), best.chi2_per_dof, best.converged,
        tuple(unpack_start(start, one.moving) for start, one in zip(best.starts, segments, strict=True)),
        tuple(_split_covariance(cov, one.moving) for cov, one in zip(best.start_covariances, segments, strict=True)),
        tuple((one, fit.log_evidence / least) for one, fit in ranked),
        _sample_rivals(models[laws], laws, best) if is_sampled and best.chi2_per_dof < _EXPLAINED_CHI2 else (),
    )  # fmt: skip


def _sample_rivals(model: ShotWindows, laws: ContactModels, best: ShootingFit) -> tuple[ShotSample, ...]:
    """Sample from the best fit and from those with other side spins and the other law of friction between balls.

    No frame shows side spin, and throw depends on it as on that law, so that the best fit may be one of several that
    explain the shot. Their evidence, divided by the factor on variances of the best, weights them.
    """
    usual, own_priors = {prior.name for prior in table_priors(laws)}, {prior.name: prior for prior in model.unknowns}
    added = tuple(prior for prior in model.unknowns if prior.name not in usual)
    modes = [(laws, model, best)]
    for ball in _RIVAL_BALL_LAWS:
        rival = ContactModels(laws.cushion, ball)
        unknowns = (*(own_priors.get(prior.name, prior) for prior in table_priors(rival)), *added)
        own = model if rival == laws else replace(model, laws=rival, unknowns=unknowns)
        earlier = [best.starts] if rival == laws else []
        for share in (1.0, *_RIVAL_SIDE_SPINS):
            starts = tuple(
                _scale_side_spin(start, one.moving, share)
                for start, one in zip(best.starts, model.segments, strict=True)
            )
            if any(all(map(np.array_equal, starts, other)) for other in earlier):
                continue  # without side spin, every share of it is the same
            earlier.append(starts)
            fitted = _continue_from(own, model.unknowns, starts, best.shared, _RIVAL_OPTIONS)
            if not any(rival == other and _is_same_mode(fitted, fit, model) for other, _, fit in modes):
                modes.append((rival, own, fitted))
    rng, widening = np.random.default_rng(_DEFAULT_SEED), float(np.sqrt(best.inflation))
    highest = max(fit.log_evidence for *_, fit in modes)
    posteriors, evidence = [], []
    for rival, own, fit in modes:
        handicap = (fit.log_evidence - highest) / best.inflation
        if handicap > _LEAST_LOG_EVIDENCE:
            posterior = GaussianPosterior.around_fit(own, fit.starts, fit.shared, widening)
            ratios = np.array([posterior.log_ratio(step) for step in posterior.draw_steps(_EVIDENCE_SAMPLES, rng)])
            posteriors.append((rival, own, posterior))
            evidence.append(handicap + np.log(np.mean(np.exp(np.minimum(ratios, 0.0))) + 1e-6))
    weights = np.exp(np.array(evidence) - max(evidence))
    counts = rng.multinomial(POSTERIOR_SAMPLES, weights / weights.sum())
    return tuple(
        ShotSample(starts[0], own.fill_values(shared), rival.ball)
        for count, (rival, own, posterior) in zip(counts, posteriors, strict=True)
        if count
        for starts, shared in posterior.sample_by_slices(int(count), rng)
    )


def _is_same_mode(one: ShootingFit, other: ShootingFit, model: ShotWindows) -> bool:
    """Return whether two fits have nearly the same side spins at the start."""
    sides = [unpack_start(fit.starts[0], model.segments[0].moving)[:, SIDE_SPIN] for fit in (one, other)]
    return bool(np.abs(sides[0] - sides[1]).max() < _SAME_SIDE_SPIN)


def _scale_side_spin(start: FloatArray, moving: BoolArray, share: float) -> FloatArray:
    """Multiply the side spin of all balls at the start of a segment."""
    padded = unpack_start(start, moving)
    padded[:, SIDE_SPIN] *= share
    return pack_start(padded, moving)


def _rank_by_evidence(fits: list[tuple[ContactModels, ShootingFit]]) -> list[tuple[ContactModels, ShootingFit]]:
    """Keep the best fit of each pair of contact models, and sort by falling evidence."""
    best: dict[ContactModels, ShootingFit] = {}
    for laws, fit in fits:
        if laws not in best or fit.cost < best[laws].cost:
            best[laws] = fit
    return sorted(best.items(), key=lambda one: -one[1].log_evidence)


def _fit_first_explaining(
    models: dict[ContactModels, ShotWindows], rng: np.random.Generator, views: dict[ContactModels, UnexplainedView]
) -> list[tuple[ContactModels, ShootingFit]]:
    """Fit the first pair of contact models that explains all shots, if any: the others can start from its states.

    `views` receives the first view that each of the others does not explain.
    """
    for (laws, model), own in zip(models.items(), rng.spawn(len(models)), strict=True):
        values, alone = _prior_values(model), {}
        for number in _list_shots(model):
            fitted = fit_if_explained(_select_shots(model, [number]), values, own)
            if isinstance(fitted, UnexplainedView):
                views[laws] = fitted
                break
            alone[number] = fitted
        else:
            return [(laws, _combine_shots(model, alone, own))]
    return []


def _fit_laws(
    model: ShotWindows, others: list[tuple[ContactModels, ShootingFit]], rng: np.random.Generator
) -> ShootingFit:
    """Fit one pair of contact models, starting from the states and parameters of the best fit of others.

    There the states are nearly right, whichever the contact models. Without any fit that explains the shots, start from
    the observations alone.
    """
    if not others:
        return fit_from_single_shots(model, rng)
    laws, neighbour = min(others, key=lambda one: one[1].cost)
    fitted = _continue_from(model, table_priors(laws), neighbour.starts, neighbour.shared, ShootingOptions())
    if any(one.converged and one.chi2_per_dof < _GOOD_CHI2 for one in (*(one for _, one in others), fitted)):
        return fitted
    return min([fitted, fit_from_single_shots(model, rng)], key=lambda one: one.cost)


def _continue_from(
    model: ShotWindows, priors: tuple[Prior, ...], starts: tuple[FloatArray, ...], values: FloatArray,
    options: ShootingOptions,
) -> ShootingFit:  # fmt: skip
    """Fit contact models from start states and from values (P,) of parameters that have these priors."""
    neighbour_values = {prior.name: value for prior, value in zip(priors, values, strict=True)}
    shared = np.array([neighbour_values.get(prior.name, prior.value) for prior in model.unknowns])
    return fit_windows(model, shared, options, starts)


def fit_from_single_shots(model: ShotWindows, rng: np.random.Generator) -> ShootingFit:
    """Fit all shots together, starting from the fit of each alone.

    Which initial guess of a spin is right shows once the table is known. The shots that are explained alone therefore
    constrain the table first, the others are fitted with these priors, and only then all together.

    Args:
        model: Model of all shots.
        rng: Random generator.

    Returns:
        The fit of all shots.
    """
    values = _prior_values(model)
    alone = {one: fit_by_continuation(_select_shots(model, [one]), values, rng) for one in _list_shots(model)}
    return _combine_shots(model, alone, rng)


def _prior_values(model: ShotWindows) -> FloatArray:
    """Return the means (P,) of the priors."""
    return np.array([prior.value for prior in model.unknowns])


def _list_shots(model: ShotWindows) -> list[int]:
    """List the numbers of the shots, in the order of time."""
    return list(dict.fromkeys(one.shot for one in model.segments))


def _combine_shots(model: ShotWindows, alone: dict[int, ShootingFit], rng: np.random.Generator) -> ShootingFit:
    """Fit all shots together, starting from the fit of each alone."""
    numbers = list(alone)
    if len(numbers) == 1:
        return alone[numbers[0]]
    good = [number for number in numbers if alone[number].chi2_per_dof < _GOOD_CHI2]
    good = good or [min(numbers, key=lambda number: alone[number].chi2_per_dof)]
    first = alone[min(good, key=lambda number: float(np.log(alone[number].sigma).sum()))]
    combined = _fit_together(model, good, alone, first.shared)
    for number in (one for one in numbers if one not in good):
        other = _fit_with_priors(model, number, combined, rng)
        if other.chi2_per_dof < alone[number].chi2_per_dof:
            alone[number] = other
    if len(good) < len(numbers):
        combined = _fit_together(model, numbers, alone, combined.shared)
    return combined if _is_consistent(model, alone, combined) else _reconcile_shots(model, alone, combined, rng)


def _is_consistent(model: ShotWindows, alone: dict[int, ShootingFit], combined: ShootingFit) -> bool:
    """Return whether one set of parameters costs no more than noise explains over one set per shot."""
    ties = len(model.unknowns) * (len(alone) - 1)
    excess = combined.cost - sum(one.cost for one in alone.values())
    return bool(excess < ties + _SIGNIFICANT_SIGMAS * np.sqrt(2 * ties) + 1)


def _reconcile_shots(
    model: ShotWindows, alone: dict[int, ShootingFit], combined: ShootingFit, rng: np.random.Generator
) -> ShootingFit:
    """Refit inconsistent shots, each with the others as prior.

    One of them may have converged to a wrong spin with parameters that match it.
    """
    numbers = list(alone)
    for number in numbers:
        others = _fit_together(model, [one for one in numbers if one != number], alone, combined.shared)
        again = {**alone, number: _fit_with_priors(model, number, others, rng)}
        refitted = _fit_together(model, numbers, again, others.shared)
        if refitted.cost < combined.cost - 1.0:
            alone, combined = again, refitted
    return combined


def _fit_with_priors(model: ShotWindows, number: int, others: ShootingFit, rng: np.random.Generator) -> ShootingFit:
    """Fit one shot with the result of others as priors."""
    own = replace(_select_shots(model, [number]), unknowns=convert_to_priors(model.unknowns, others))
    return fit_by_continuation(own, others.shared, rng)


def _select_shots(model: ShotWindows, numbers: list[int]) -> ShotWindows:
    """Build the model of some of the shots."""
    return replace(model, segments=tuple(one for one in model.segments if one.shot in numbers))


def _fit_together(
    model: ShotWindows, numbers: list[int], alone: dict[int, ShootingFit], shared: FloatArray
) -> ShootingFit:
    """Fit some shots together, each started from its own fit."""
    starts = tuple(start for number in numbers for start in alone[number].starts)
    return fit_windows(_select_shots(model, numbers), shared, starts=starts)


def _split_covariance(covariance: FloatArray, moving: BoolArray) -> FloatArray:
    """Split the covariance (S, S) of a start into that of each ball (N, 7, 7)."""
    covariances, at = np.zeros((len(moving), MOVING_BALL_SIZE, MOVING_BALL_SIZE)), start_offsets(moving)
    for k, (first, after) in enumerate(pairwise(at)):
        covariances[k, : after - first, : after - first] = covariance[first:after, first:after]
    return covariances
