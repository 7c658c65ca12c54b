"""Candidate effects with probabilities that add to 1, and the effects that these data cannot separate."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.fitting.body_strengths import BodyFit, estimate_shot_steps, measure_scatter
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, ShotInformation
from diagnosis.selection.hypotheses import (
    INSEPARABLE_CORRELATION,
    REFUTED_RIVAL_LOG_EVIDENCE,
    EffectSearch,
    Hypothesis,
    Signatures,
    absorb_by_free,
    compute_signatures,
    direction_correlation,
    whitening_directions,
)
from diagnosis.selection.unknown_effects import SUSPICIOUS_P_VALUE, UnknownEvidence
from diagnosis.verdicts.verdict import BodyStrength, Strength
from models.core.typing import BoolArray, FloatArray

# p-value from which readers may take an agreement for chance.
SMALL_P_VALUE = 0.05
# Largest number of names in a group.
_MAX_GROUP = 3


def compute_probabilities(search: EffectSearch, best: Hypothesis, evidence: UnknownEvidence) -> dict[str, float]:
    """Compute the probability of each effect, of `none` and of `unknown`.

    A hypothesis shares its probability among its effects; supersets of the best one were rejected and do not count.
    """
    compared = [one for one in search.hypotheses.values() if not one.names > best.names]
    weight = np.array([search.log_evidence(one) for one in compared])
    weight = np.exp(weight - weight.max())
    weight *= (1 - evidence.probability) / weight.sum()
    probabilities = dict.fromkeys((*search.choices, "none"), 0.0) | {"unknown": evidence.probability}
    for one, share in zip(compared, weight, strict=True):
        for name in one.names or {"none"}:
            probabilities[name] += float(share) / max(one.size, 1)
    total = sum(probabilities.values())
    return {name: value / total for name, value in probabilities.items()}


def put_answer_first(probabilities: dict[str, float], named: frozenset[str]) -> dict[str, float]:
    """Exchange probabilities so that the most probable effect of the answer comes first.

    Similar effects together are evidence that something is missing, although each alone may be less likely than none;
    and evidence that no effect is the right one may be divided among them.
    """
    first, most = max(sorted(named), key=probabilities.__getitem__), max(probabilities, key=probabilities.__getitem__)
    return probabilities | {first: probabilities[most], most: probabilities[first]}


def find_group(search: EffectSearch, best: Hypothesis, name: str, without: Signatures) -> tuple[str, ...]:
    """Find an effect and the rivals that are neither refuted nor separable, given signatures `without` the effect."""
    alike = []
    for other in search.choices:
        swapped = search.hypotheses.get(best.names - {name} | {other})
        if (
            other in best.names
            or swapped is None
            or search.log_evidence(best) - search.log_evidence(swapped) > REFUTED_RIVAL_LOG_EVIDENCE
        ):
            continue
        if _are_inseparable(search.problem, name, other, without):
            alike.append((search.log_evidence(swapped), other))
    return (name, *(other for _, other in sorted(alike, reverse=True)[: _MAX_GROUP - 1]))


def _are_inseparable(problem: DiagnosisProblem, name: str, other: str, without: Signatures) -> bool:
    """Return whether two effects have the same signature, or one is a contact model that brings the other."""
    brought = {choice.name: choice.companions for choice in problem.scene.alternatives}
    if name in brought or other in brought:
        return name in brought.get(other, ()) or other in brought.get(name, ())
    return direction_correlation(without, problem.mask((name,)), problem.mask((other,))) > INSEPARABLE_CORRELATION


def estimate_shot_spreads(shot_information: ShotInformation, fitted: EffectFit) -> FloatArray:
    """Estimate the standard deviation (P,) of each strength between shots; 0 where all shots may have the same.

    Shots are compared near the common fit, each by its own gradient, with errors widened by the lack of fit.
    """
    spreads = np.zeros(len(fitted.shared))
    for k in np.flatnonzero(fitted.free):
        steps, weights = estimate_shot_steps(shot_information, int(k), fitted.lack_of_fit)
        if len(steps) < 2:
            continue
        scatter = measure_scatter(steps, weights)
        if scatter.p_value < SUSPICIOUS_P_VALUE:
            spreads[k] = np.sqrt(scatter.variance)
    return spreads


def summarize_strengths(
    problem: DiagnosisProblem,
    fitted: EffectFit,
    detectable: FloatArray,
    names: tuple[str, ...],
    shot_spreads: FloatArray | None = None,
    body_spreads: FloatArray | None = None,
) -> tuple[Strength, ...]:
    """Summarize the parameters of effects: as fitted where they were free, else with their detectable strength."""
    sigma = np.full(len(problem.priors), np.inf)
    sigma[fitted.free] = fitted.shooting.sigma
    is_prior_only = np.zeros(len(problem.priors), bool)
    is_prior_only[fitted.free] = fitted.shooting.prior_only
    return tuple(
        replace(
            _summarize_parameter(problem, k, fitted.shared, sigma, detectable),
            prior_only=bool(is_prior_only[k]),
            shot_spread=0.0 if shot_spreads is None else float(shot_spreads[k]),
            body_spread=0.0 if body_spreads is None else float(body_spreads[k]),
        )
        for k in np.flatnonzero(problem.mask(names)).tolist()
    )


def _summarize_parameter(
    problem: DiagnosisProblem, k: int, values: FloatArray, sigma: FloatArray, detectable: FloatArray
) -> Strength:
    """Summarize parameter number k from values, sigmas and detectable strengths (P,) of all parameters."""
    name, prior = problem.priors[k].name.split(".", 1)[1], problem.priors[k]
    return Strength(name, prior.unit, float(values[k]), float(sigma[k]), float(detectable[k]))


def summarize_bodies(problem: DiagnosisProblem, body_fit: BodyFit, name: str) -> tuple[BodyStrength, ...]:
    """Summarize the strengths of an effect on each body; empty where all bodies may have the same."""
    chosen, unknown = np.flatnonzero(problem.mask((name,)) & body_fit.own), np.full(len(body_fit.own), np.nan)
    if not len(chosen):
        return ()
    return tuple(
        BodyStrength(
            body,
            len({segment.shot for segment in body_fit.segments if segment.bodies == (body,)}),
            tuple(
                _summarize_parameter(problem, k, body_fit.shared[number], body_fit.sigma[number], unknown)
                for k in chosen.tolist()
            ),
        )
        for number, body in enumerate(body_fit.bodies)
    )


# Most shots of which all flips are tried: 4096, as the last shot keeps its sign.
_MAX_EXACT_SHOTS = 13
# Fewest shots that are tested: two allow no p-value below a half.
_MIN_SHOTS = 3


def flip_signs(
    problem: DiagnosisProblem, shot_information: ShotInformation, free: BoolArray, name: str, rng: np.random.Generator
) -> float:
    """Return the probability that shots without a missing effect agree about some effect as well as about this one.

    Args:
        problem: Scene and priors.
        shot_information: Information of each shot at a fit without the effect.
        free: (P,) mask of the parameters that this fit adjusts.
        name: The effect.
        rng: Random generator of the flips, where there are too many to try them all.

    Returns:
        p-value, at least 2 to the power of 1 - Q for Q shots; NaN where the effect has no strength, or shots are few.
    """
    masks = [problem.mask((other,)) & ~free for other in problem.candidates]
    own = problem.mask((name,)) & ~free
    if not own.any() or len(shot_information.shots) < _MIN_SHOTS:
        return float("nan")
    effect_signatures = compute_signatures(problem, shot_information, free)
    scores, whole = shot_information.score, shot_information.information.sum(axis=0)
    pulls = scores - absorb_by_free(problem, whole, free, scores[:, free].T).T
    flips = _draw_flips(len(pulls), rng)

    def measure(mask: BoolArray) -> FloatArray:
        directions = whitening_directions(effect_signatures, mask)
        along = flips @ (pulls[:, mask] @ directions)
        return np.asarray(np.square(along).sum(axis=1) / max(directions.shape[1], 1))

    largest = np.max([measure(mask) for mask in masks if mask.any()], axis=0)
    observed = measure(own)[0]
    return float(np.mean(largest >= observed * (1 - 1e-9)))


def flip_gains(gains: FloatArray, rivals: int) -> float:
    """Return the probability that shots gain as much from another contact model as these do, if none were better.

    Args:
        gains: (Q,) chi2 that each shot gains.
        rivals: Number of models among which it was chosen.

    Returns:
        p-value; NaN where shots are few.
    """
    if len(gains) < _MIN_SHOTS:
        return float("nan")
    drawn = _draw_flips(len(gains), np.random.default_rng(0)) @ gains
    # these gains have a sign, so that all shots may be flipped together
    tail = np.mean(np.concatenate([drawn, -drawn]) >= drawn[0] * (1 - 1e-9))
    return float(min(rivals * tail, 1.0))


def smallest_p_value(count: int) -> float:
    """Return the smallest p-value that flips of `count` shots allow; NaN where they are too few to test."""
    return float(2.0 ** (1 - min(count, _MAX_EXACT_SHOTS))) if count >= _MIN_SHOTS else float("nan")


def _draw_flips(count: int, rng: np.random.Generator) -> FloatArray:
    """Draw K choices of signs for Q shots (K, Q); the first choice flips none.

    With few shots, these are all choices in which the last shot keeps its sign: flipping all signs changes nothing.
    """
    if count <= _MAX_EXACT_SHOTS:
        is_flipped = np.arange(2 ** (count - 1))[:, None] >> np.arange(count) & 1
    else:
        is_flipped = rng.integers(0, 2, (2 ** (_MAX_EXACT_SHOTS - 1), count))
        is_flipped[0] = 0
    return np.where(is_flipped, -1.0, 1.0)
