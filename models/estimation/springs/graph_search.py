"""Search for the graph of springs: hypotheses about pairs and stiffness, tested quickly, the best one fitted.

Residuals of a fit are tested for noise; rods stand for springs whose stiffness has only a lower bound.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.springs.parameter_layout import (
    MIN_RELATIVE_NOISE,
    MIN_SAMPLES,
    measure_scales,
    rank_pairs_by_variation,
)
from models.estimation.springs.spring_fit import (
    QUICK,
    THOROUGH,
    SearchEffort,
    SpringFit,
    covariance_of_shared,
    fit_graph,
    position_residuals,
    tighten_links,
)
from models.physics.springs.spring_system import SpringSystem, build_springs, evaluate_acceleration

Pair = tuple[int, int]

# Samples on which hypotheses are tested.
TRIAL_SAMPLES = 40
# rad of a spring's oscillation between two samples, the initial guesses of stiffness.
PHASE_LADDER = (1.0, 2.5, 0.4, 6.0)
# Initial guess from which a search reaches farthest.
USUAL_PHASE = 1.0
# Relative change of the distance of two particles up to which a spring may join them.
MAX_SPRING_VARIATION = 0.25
# chi2 per degree of freedom of a quick fit that needs no other.
SUFFICIENT_CHI2 = 1.5
# Relative changes of a distance up to which a rod may join two particles: fewer or more rods.
ROD_VARIATIONS = (0.01, 0.05)
# Relative difference of chi2 at which two guesses have converged to the same springs.
SAME_CHI2 = 0.02
# Standard deviation of the logarithm of a stiffness above which a pair may not be joined.
MAX_STIFFNESS_SIGMA = 0.3
# Motion of its ends by a rod's tension between two samples, over the noise, below which the rod may not exist.
SLACK_NOISE = 5.0
# Standard deviations of its stretching from which a rod is tried as a spring: errors of a poor fit are too large.
STRETCH_SIGMAS = 1.0
# Guessed damping of a spring, relative to critical damping.
GUESSED_DAMPING_RATIO = 0.02
# Search effort from an unfitted graph (`UNFITTED`), and from a fit that is almost right.
UNFITTED, REFINEMENT = SearchEffort(stages=0), SearchEffort(stages=4, iterations=5, last_iterations=20)
# Hypotheses that are fitted to all samples before the search gives up.
MAX_FULL_FITS = 2
# Pairs that are tried as the missing one.
MAX_ADDED_PAIRS = 6
# Pairs up to which each is tried as a rod among springs, and as a spring among rods.
MAX_MIXED_PAIRS = 4
# Rounds in which the noise is estimated from residuals.
MAX_NOISE_ROUNDS = 4


def search_graphs(series: Recording, is_fixed: BoolArray, noise: float | None) -> SpringFit:
    """Fit the plausible graphs and return the best fit; its residuals may still exceed the noise."""
    steady, missing = _split_pairs(series, is_fixed, MAX_SPRING_VARIATION)
    rigid = {tuple(_split_pairs(series, is_fixed, change)[0]) for change in ROD_VARIATIONS}
    rods = [_guess_graph(series, is_fixed, list(pairs), np.inf) for pairs in sorted(rigid, key=len)]
    fit = _fit_best_graph(
        series, rods + [_guess_graph(series, is_fixed, steady, phase) for phase in PHASE_LADDER], noise
    )
    if not find_rejections(fit, noise is not None):
        return fit
    more = [_guess_graph(series, is_fixed, sorted([*steady, pair]), USUAL_PHASE) for pair in missing[:MAX_ADDED_PAIRS]]
    edges = range(len(fit.graph.pairs)) if len(fit.graph.pairs) <= MAX_MIXED_PAIRS else ()
    mixed = [_change_stiffness(fit.graph, e, phase, series) for e in edges for phase in (np.inf, USUAL_PHASE)]
    if not more and not mixed:
        return fit
    other = _fit_best_graph(series, more + mixed, noise)
    return min((fit, other), key=lambda one: (bool(find_rejections(one, noise is not None)), one.chain.cost))


def _fit_best_graph(series: Recording, graphs: list[SpringSystem], noise: float | None) -> SpringFit:
    """Fit all samples with the graphs that explain the first ones best; return the first accepted or the best fit."""
    few = series.select_rows(0, TRIAL_SAMPLES)
    few = few if few.is_observed.sum(axis=0).min() >= MIN_SAMPLES else series
    fits: list[SpringFit] = []
    for quick_fit in sorted(_fit_first_samples(few, graphs, noise), key=lambda fit: fit.chain.cost)[:MAX_FULL_FITS]:
        fits.append(_prune_pairs(series, _fit_all_samples(series, _prune_pairs(few, quick_fit), noise), THOROUGH))
        if len(fits[-1].graph.rods) and find_rejections(fits[-1], noise is not None):
            fits.append(_replace_stretching_rods(series, fits[-1], noise))
        if not find_rejections(fits[-1], noise is not None):
            break
    return min(fits[::-1], key=lambda fit: (bool(find_rejections(fit, noise is not None)), fit.chain.cost))


def _fit_first_samples(few: Recording, graphs: list[SpringSystem], noise: float | None) -> list[SpringFit]:
    """Fit the first samples with one graph after another, until one explains them or two guesses agree."""
    fits: list[SpringFit] = []
    for graph in graphs:
        fit = fit_graph(few, graph, noise, QUICK)
        twice = any(_is_same_fit(fit, other) for other in fits)
        fits.append(fit)
        if twice or fit.chain.cost < SUFFICIENT_CHI2 * fit.freedom:
            break
    return fits


def _is_same_fit(fit: SpringFit, other: SpringFit) -> bool:
    """Return whether two searches among springs converged to the same point."""
    springy = len(fit.graph.pairs) > len(fit.graph.rods) == 0 and np.array_equal(fit.graph.pairs, other.graph.pairs)
    return bool(springy and abs(fit.chain.cost - other.chain.cost) < SAME_CHI2 * fit.chain.cost)


def _prune_pairs(series: Recording, fit: SpringFit, effort: SearchEffort = QUICK) -> SpringFit:
    """Remove the pairs that explain nothing: all of them at once, or else one after another."""
    doubtful = _list_doubtful_pairs(fit)
    together = _drop_pairs_if_worth(series, fit, doubtful, effort) if len(doubtful) > 1 else fit
    if together is not fit:
        return together
    for pair in doubtful:
        fit = _drop_pairs_if_worth(series, fit, [pair], effort)
    return fit


def _drop_pairs_if_worth(series: Recording, fit: SpringFit, pairs: list[list[int]], effort: SearchEffort) -> SpringFit:
    """Return the fit without some pairs where they save more parameters than they explain, or else the old one."""
    worth = float(np.log(series.positions.size)) * max(1.0, fit.chain.cost / max(fit.freedom, 1))
    less = fit_graph(
        series, _remove_pairs(fit.graph, pairs), fit.noise, effort, start=fit if effort is THOROUGH else None
    )
    pays = less.chain.cost - fit.chain.cost < worth * (len(fit.values) - len(less.values))
    return less if pays else fit


def _list_doubtful_pairs(quick_fit: SpringFit) -> list[list[int]]:
    """List pairs whose stiffness is uncertain or at its lower bound, or whose tension hardly moves anything."""
    graph, names = quick_fit.graph, quick_fit.model.layout.names
    if not np.isfinite(quick_fit.chain.cost):
        return []
    sigma = dict(zip(names, np.sqrt(np.diag(covariance_of_shared(quick_fit)).clip(0)).tolist(), strict=True))
    least = dict(zip(names, (quick_fit.chain.shared <= quick_fit.model.layout.low).tolist(), strict=True))
    pull = np.sqrt((_rod_tensions(graph, quick_fit.states) ** 2).mean(axis=0)) * quick_fit.model.units.span**2
    slack = dict(zip(graph.rods.tolist(), (pull < SLACK_NOISE * quick_fit.noise).tolist(), strict=True))
    return [
        pair for e, pair in enumerate(graph.pairs.tolist())
        if slack.get(e, False) or least.get(name := f"stiffness {pair[0]}-{pair[1]}", False)
        or sigma.get(name, 0.0) > MAX_STIFFNESS_SIGMA
    ]  # fmt: skip


def _split_pairs(series: Recording, is_fixed: BoolArray, change: float) -> tuple[list[Pair], list[Pair]]:
    """Split the pairs into those whose distance changes by less than `change`, and the others, by increasing change."""
    pairs, _, vary = rank_pairs_by_variation(series)
    free = [k for k, (i, j) in enumerate(pairs) if not (is_fixed[i] and is_fixed[j])]
    return sorted(pairs[k] for k in free if vary[k] < change), [pairs[k] for k in free if vary[k] >= change]


def _fit_all_samples(series: Recording, quick_fit: SpringFit, noise: float | None) -> SpringFit:
    """Fit all samples, starting from a quick fit."""
    return fit_noise(fit_graph(series, quick_fit.graph, noise, start=quick_fit), noise)


def fit_noise(fit: SpringFit, noise: float | None) -> SpringFit:
    """Refit with the noise estimated from the residuals, where it is not known."""
    for _ in range(MAX_NOISE_ROUNDS if noise is None else 0):
        ratio = float(np.sqrt(fit.chain.cost / max(fit.freedom, 1)))
        if not np.isfinite(ratio) or abs(np.log(max(ratio, 1e-12))) < 0.05:
            break
        fit = _rescale_noise(fit, max(ratio, 1e-3))
    return fit


def _rescale_noise(fit: SpringFit, ratio: float) -> SpringFit:
    """Refit with another noise."""
    weights = replace(
        fit.observed, weight=fit.observed.weight / ratio, shared_weight=fit.observed.shared_weight / ratio
    )
    return tighten_links(replace(fit, observed=weights, noise=fit.noise * ratio), fit.model.constraint_sigma)


def _replace_stretching_rods(series: Recording, rigid: SpringFit, noise: float | None) -> SpringFit:
    """Replace rods whose length measurably changes by springs, and refit; return the old fit without any.

    Springs that oscillate often between two samples cannot be found in another way: their slow motion is observed,
    their oscillation is damped away.
    """
    if not np.isfinite(rigid.chain.cost):
        return rigid
    give, sigma, rods = *_estimate_compliance(series, rigid), rigid.graph.rods
    stretching = rods[give > STRETCH_SIGMAS * sigma]
    stiffness, damping = rigid.graph.stiffness.copy(), rigid.graph.damping.copy()
    stiffness[stretching] = 1 / give[give > STRETCH_SIGMAS * sigma]
    damping[stretching] = GUESSED_DAMPING_RATIO * np.sqrt(stiffness[stretching])
    graph = replace(rigid.graph, stiffness=stiffness, damping=damping)
    left = float(np.sqrt(np.nanmean(position_residuals(rigid) ** 2)))
    return fit_noise(tighten_links(fit_graph(series, graph, noise, UNFITTED, start=rigid), left, REFINEMENT), noise)


def _guess_graph(series: Recording, is_fixed: BoolArray, pairs: list[Pair], phase: float) -> SpringSystem:
    """Build an initial graph: `phase` rad between two samples, rest lengths as observed."""
    every, distance, _ = rank_pairs_by_variation(series)
    far = dict(zip(every, distance.tolist(), strict=True))
    count, axes = series.positions.shape[1:]
    return build_springs(
        np.ones(count), pairs, (phase / measure_scales(series).span) ** 2, _guess_damping(phase, series),
        np.array([far[pair] for pair in pairs]), np.zeros(axes), tuple(np.flatnonzero(is_fixed).tolist()),
    )  # fmt: skip


def _guess_damping(phase: float, series: Recording) -> float:
    """Guess the damping of a spring that loses little energy per oscillation; of a rod, none."""
    return 0.02 * phase / measure_scales(series).span if np.isfinite(phase) else 0.0


def _change_stiffness(graph: SpringSystem, edge: int, phase: float, series: Recording) -> SpringSystem:
    """Replace the stiffness of one pair."""
    here = np.arange(len(graph.pairs)) == edge
    return replace(
        graph, stiffness=np.where(here, (phase / measure_scales(series).span) ** 2, graph.stiffness),
        damping=np.where(here, _guess_damping(phase, series), graph.damping),
    )  # fmt: skip


def _remove_pairs(graph: SpringSystem, pairs: list[list[int]]) -> SpringSystem:
    is_kept = np.array([pair not in pairs for pair in graph.pairs.tolist()], bool)
    return replace(
        graph, pairs=graph.pairs[is_kept], stiffness=graph.stiffness[is_kept], damping=graph.damping[is_kept],
        rest=graph.rest[is_kept],
    )  # fmt: skip


# chi2 per degree of freedom.
MAX_CHI2 = 1.5
# Correlation of neighbouring residuals, beyond chance.
MAX_CORRELATION = 0.1
# Standard deviations that chance may explain.
CHANCE_SIGMAS = 5.0
# Mean square of the residuals in an eighth of the time, over that of the median eighth.
MAX_UNEVENNESS = 3.0


def find_rejections(fit: SpringFit, noise_known: bool) -> tuple[str, ...]:
    """Return the reasons, in sentences, why the residuals of a fit are not noise; none where they are."""
    off = position_residuals(fit)
    count = int(np.isfinite(off).sum())
    rejections = []
    if not np.isfinite(fit.chain.cost):
        return ("No graph of springs could be fitted: the motion of the model diverges.",)
    if np.sqrt(np.nanmean(off**2)) < MIN_RELATIVE_NOISE * fit.model.units.length:  # the rest is integration error
        return ()
    chi2 = fit.chain.cost / max(fit.freedom, 1)
    if noise_known and chi2 > MAX_CHI2 + CHANCE_SIGMAS * np.sqrt(2 / max(fit.freedom, 1)):
        rejections.append(
            f"Residuals are {np.sqrt(np.nanmean(off**2)):.3g}, {np.sqrt(chi2):.1f} times the noise of {fit.noise:.3g}: "
            "these springs do not explain the motion."
        )
    if (alike := _lag_one_correlation(off)) > MAX_CORRELATION + CHANCE_SIGMAS / np.sqrt(count):
        rejections.append(f"Residuals of neighbouring samples are correlated ({alike:.2f}): they are not noise.")
    if (ratio := _residual_unevenness(off)) > MAX_UNEVENNESS + CHANCE_SIGMAS * np.sqrt(16 / count):
        rejections.append(
            f"Residuals are {np.sqrt(ratio):.1f} times larger in one part than elsewhere: they are not noise."
        )
    return tuple(rejections)


def _lag_one_correlation(off: FloatArray) -> float:
    """Compute the correlation of residuals (T, M) with the next ones."""
    there = np.nan_to_num(off)
    return float((there[1:] * there[:-1]).sum() / max((there**2).sum(), 1e-300))


def _residual_unevenness(off: FloatArray) -> float:
    """Compute the largest mean square of the residuals (T, M) in an eighth of the time, over the median one."""
    parts = [float(np.nanmean(part**2)) for part in np.array_split(off, 8) if np.isfinite(part).any()]
    return max(parts) / max(float(np.median(parts)), 1e-300)


def _estimate_compliance(series: Recording, fit: SpringFit) -> tuple[FloatArray, FloatArray]:
    """Estimate the lengthening (R,) of every rod per force on it, and its standard deviation.

    Observed lengths are compared with the tension that the fitted motion requires. It changes slowly compared with the
    oscillation of a stiff spring, whose length is therefore always that of equilibrium.
    """
    graph = fit.graph
    i, j = graph.pairs[graph.rods].T
    length = np.linalg.norm(series.positions[:, j] - series.positions[:, i], axis=2) - graph.rest[graph.rods]
    pull = _rod_tensions(graph, fit.states)
    ends = (~graph.fixed[i]).astype(float) + (~graph.fixed[j])
    values, sigmas = np.full(len(i), np.nan), np.full(len(i), np.nan)
    for r in range(len(i)):
        there = np.isfinite(length[:, r])
        off, force = length[there, r] - length[there, r].mean(), pull[there, r] - pull[there, r].mean()
        strength = float((force**2).sum())
        if strength > 0:
            values[r] = (off * force).sum() / strength
            sigmas[r] = fit.noise * np.sqrt(ends[r] / strength)
    return values, sigmas


def _rod_tensions(graph: SpringSystem, states: FloatArray) -> FloatArray:
    """Compute the tension (T, R) of every rod."""
    free = ~graph.fixed
    loose = SpringSystem(
        graph.mass, graph.fixed, graph.pairs, np.where(np.isinf(graph.stiffness), 0.0, graph.stiffness), graph.damping,
        graph.rest, graph.gravity, graph.radius, graph.contact,
    )  # fmt: skip
    tensions = np.zeros((len(states), len(graph.rods)))
    if len(graph.rods) == 0:
        return tensions
    for k, (x, v) in enumerate(states):
        required = graph.mass[:, None] * (evaluate_acceleration(graph, x, v) - evaluate_acceleration(loose, x, v))
        unit = np.zeros((*x.shape, len(graph.rods)))
        for r, (i, j) in enumerate(graph.pairs[graph.rods]):
            along = (x[j] - x[i]) / np.linalg.norm(x[j] - x[i])
            unit[i, :, r], unit[j, :, r] = along, -along
        tensions[k] = np.linalg.lstsq(unit[free].reshape(-1, len(graph.rods)), required[free].ravel(), rcond=None)[0]
    return tensions


def compute_stiffness_bound(series: Recording, fit: SpringFit) -> FloatArray:
    """Compute the lower bound (E,) of the stiffness of rods, at two standard deviations; NaN for springs."""
    bounds = np.full(len(fit.graph.pairs), np.nan)
    if len(fit.graph.rods) == 0:
        return bounds
    value, sigma = _estimate_compliance(series, fit)
    bounds[fit.graph.rods] = 1 / (np.maximum(value, 0.0) + 2 * sigma)
    return bounds
