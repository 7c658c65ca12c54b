"""What may be missing, with probabilities that add to 1, and what these data cannot tell apart."""

from __future__ import annotations

import numpy as np

from diagnosis.fitting.hypothesis_fits import Fitted, Question
from diagnosis.selection.hypotheses import Hypothesis, Search
from diagnosis.selection.signatures import TWINS, Signatures, explained_direction
from diagnosis.selection.unknown_effects import Doubt
from diagnosis.verdicts.verdict import Candidate, Strength

_CLOSE = 3.0
"""log evidence within which a rival is not refuted."""
_LARGEST = 3
"""names in a group."""


def probabilities(state: Search, best: Hypothesis, doubt: Doubt) -> dict[str, float]:
    """Per effect, `none` and `unknown`: hypotheses share theirs among their effects; those that hold more than the
    best one were rejected."""
    tried = [one for one in state.tried.values() if not one.names > best.names]
    weight = np.array([state.weigh(one) for one in tried])
    weight = np.exp(weight - weight.max())
    weight *= (1 - doubt.probability) / weight.sum()
    found = dict.fromkeys((*state.choices, "none"), 0.0) | {"unknown": doubt.probability}
    for one, share in zip(tried, weight, strict=True):
        for name in one.names or {"none"}:
            found[name] += float(share) / max(one.size, 1)
    total = sum(found.values())
    return {name: value / total for name, value in found.items()}


def leading(chances: dict[str, float], named: frozenset[str]) -> dict[str, float]:
    """With the likeliest of what is named first: effects that look alike have spoken together for something missing,
    each alone may be less likely than nothing."""
    first, most = max(sorted(named), key=chances.__getitem__), max(chances, key=chances.__getitem__)
    return chances | {first: chances[most], most: chances[first]}


def group_of(state: Search, best: Hypothesis, name: str, without: Signatures) -> tuple[str, ...]:
    """An effect and its rivals: alike once `without` it everything else is adjusted, and not refuted."""
    alike = []
    for other in state.choices:
        swapped = state.tried.get(best.names - {name} | {other})
        if other in best.names or swapped is None or state.weigh(best) - state.weigh(swapped) > _CLOSE:
            continue
        if _alike(state.question, name, other, without):
            alike.append((state.weigh(swapped), other))
    return (name, *(other for _, other in sorted(alike, reverse=True)[: _LARGEST - 1]))


def _alike(question: Question, name: str, other: str, without: Signatures) -> bool:
    """Whether two effects have the same signature, or one is a law that brings the other."""
    brought = {choice.name: choice.brings for choice in question.scene.alternatives}
    if name in brought or other in brought:
        return name in brought.get(other, ()) or other in brought.get(name, ())
    return explained_direction(without, question.mask((name,)), question.mask((other,))) > TWINS


def strengths(
    question: Question, fitted: Fitted, detectable: np.ndarray, names: tuple[str, ...]
) -> tuple[Strength, ...]:
    """The parameters of effects: as fitted where they were free, else what could have been seen of them."""
    sigma = np.full(len(question.priors), np.inf)
    sigma[fitted.free] = fitted.shooting.sigma
    untold = np.zeros(len(question.priors), bool)
    untold[fitted.free] = fitted.shooting.prior_only
    chosen = np.flatnonzero(question.mask(names))
    return tuple(
        Strength(
            question.priors[k].name.split(".", 1)[1],
            question.priors[k].unit,
            float(fitted.shared[k]),
            float(sigma[k]),
            float(detectable[k]),
            bool(untold[k]),
        )
        for k in chosen
    )


def ranked(
    chances: dict[str, float],
    groups: dict[str, tuple[str, ...]],
    told: dict[str, tuple[Strength, ...]],
) -> tuple[Candidate, ...]:
    """Most probable first."""
    order = sorted(chances, key=lambda name: chances[name], reverse=True)
    return tuple(Candidate(name, chances[name], groups.get(name, (name,)), told.get(name, ())) for name in order)
