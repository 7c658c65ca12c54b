"""Rivals of an effect whose strength differs between bodies, compared with strengths of every body.

With strengths that all bodies share, each law leaves the differences between bodies, and the law that leaves less of
them is not the right one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from diagnosis.bodies.body_strengths import BodyFit, fit_body_strengths
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem
from diagnosis.selection.hypotheses import REFUTED_RIVAL_LOG_EVIDENCE, EffectSearch, Hypothesis


@dataclass(frozen=True, slots=True)
class BodyChoice:
    """The best hypothesis, with strengths of every body where they differ."""

    best: Hypothesis
    body_fit: BodyFit | None
    """None where all bodies may have the same strengths."""
    refuted: frozenset[str] = frozenset()
    """Effects that are worse in place of one whose strength differs, each with strengths of every body."""


def compare_with_body_strengths(problem: DiagnosisProblem, search: EffectSearch, best: Hypothesis) -> BodyChoice:
    """Replace an effect whose strength differs between bodies by a rival that explains every body better.

    Args:
        problem: Scene and priors.
        search: The finished search.
        best: Its best hypothesis.

    Returns:
        The best hypothesis with its fit of every body.
    """
    body_fit = fit_body_strengths(problem, best.fitted)
    if body_fit is None:
        return BodyChoice(best, None)
    fits: dict[str, tuple[Hypothesis, BodyFit]] = {}
    for name in sorted(best.names):
        mask = problem.mask((name,))
        if not (mask & body_fit.own).any():
            continue
        fits[name] = best, body_fit
        for other in search.choices:
            swapped = search.hypotheses.get(best.names - {name} | {other})
            if other in best.names or swapped is None or swapped.fitted.segments is not best.fitted.segments:
                continue
            differing = problem.mask((other,)) | (body_fit.own & ~mask)
            its_fit = fit_body_strengths(problem, swapped.fitted, differing)
            if its_fit is not None:
                fits[other] = swapped, its_fit
    if not fits:
        return BodyChoice(best, body_fit)
    noise = min(own.lack_of_fit for _, own in fits.values())
    evidence = {
        name: -0.5 * own.cost / noise - 0.5 * own.parameter_count * float(np.log(one.fitted.value_count))
        for name, (one, own) in fits.items()
    }
    first = max(evidence, key=evidence.__getitem__)
    refuted = frozenset(name for name in fits if evidence[first] - evidence[name] > REFUTED_RIVAL_LOG_EVIDENCE)
    chosen = fits[first][0]
    if chosen is not best:
        body_fit = fit_body_strengths(problem, chosen.fitted)
    return BodyChoice(chosen, body_fit, refuted - chosen.names)
