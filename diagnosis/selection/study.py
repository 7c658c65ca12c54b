"""What shots say that may be looked at before the verdict: search, best hypothesis, and what speaks against it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.fitting.diagnosis_windows import fit_begun, lengthened, stretches
from diagnosis.fitting.fit_residuals import Residuals, residuals
from diagnosis.fitting.gap_closure import closed_ahead
from diagnosis.fitting.hypothesis_fits import Fitted, Question, Seen, fit, follow, look, question_of
from diagnosis.fitting.noise_estimation import Noise, estimate_noise, with_noise
from diagnosis.fitting.residual_blocks import Structure, structure
from diagnosis.fitting.shot_split import Split
from diagnosis.fitting.window_growth import not_followed
from diagnosis.selection.cross_shot_evidence import alone, confirmed, gain, of_shots
from diagnosis.selection.effect_selection import search
from diagnosis.selection.hypotheses import Hypothesis, Search, Watch
from diagnosis.selection.unknown_effects import MOSTLY, Doubt, doubt, lawful, least_gain
from models.estimation.gap_scenes.gap_scene import Eventful, GapScene, Recording
from models.numerics.executor import ALONE, Crew


@dataclass(frozen=True, slots=True)
class Study:
    """What estimation and selection have found, on the shots that they may use."""

    question: Question
    noise: Noise
    state: Search
    best: Hypothesis
    base: Fitted
    """what the simulator has, on all shots but those that report."""
    full: Fitted
    """the best hypothesis, on the same."""
    seen: Seen
    """around `full`."""
    chosen: tuple[int, ...]
    """shots that might have been used."""
    left_before: Residuals
    left_after: Residuals
    before: Structure
    after: Structure
    doubt: Doubt


def studied(scene: GapScene, split: Split, rng: np.random.Generator, watch: Watch, crew: Crew = ALONE) -> Study:
    """Search, adopt, and doubt, on all shots but those that report."""
    noise = estimate_noise((*split.fit, *split.select))
    question = question_of(scene, noise.correlation, crew)
    first, second = with_noise(split.fit, noise), with_noise(split.select, noise)
    state = _searched(question, (*first, *second), watch)
    best = confirmed(question, state, first, second)
    base, full = state.alone, best.fitted
    seen, seen_full = look(question, base), look(question, full)
    left_before = residuals(question, base, seen, rng)
    left_after = residuals(question, full, seen_full, rng)
    before, after = structure(left_before), structure(left_after)
    doubts = _doubt(question, first, second, state, best, (base, full), after, seen_full, rng)
    chosen = tuple(sorted(one.shot for one in (*first, *second) if len(stretches(question, (one,)))))
    return Study(
        question, noise, state, best, base, full, seen_full, chosen, left_before, left_after, before, after, doubts
    )


def _searched(question: Question, recordings: tuple[Recording, ...], watch: Watch) -> Search:
    """Search on windows that need no hypothesis, and again on those that the best one allows."""
    base = fit_begun(question, recordings)
    odd = not_followed(question, base)
    if odd:
        recordings = tuple(one for one in recordings if one.shot not in odd)
        base = fit_begun(question, recordings)
    state = search(question, base, lambda fitted: lengthened(question, recordings, fitted), watch)
    if state.alone is base and isinstance(question.scene, Eventful):
        state.alone = lengthened(question, recordings, base)
    return state


def _doubt(
    question: Question,
    first: tuple[Recording, ...],
    second: tuple[Recording, ...],
    state: Search,
    best: Hypothesis,
    fits: tuple[Fitted, Fitted],
    left: Structure,
    seen: Seen,
    rng: np.random.Generator,
) -> Doubt:
    """Whether something unknown is there: what `best` leaves, and whether `second` shots gain what `first` promise."""
    base, full = fits
    if not best.names:
        return doubt(left, seen.told, base, full, None, True)
    before, after = alone(question, first, base), alone(question, first, full)
    gains = not second or gain(question, full, second, before, after) > least_gain(len(first), len(second))
    ahead = closed_ahead(question, second or first, before, after, rng)
    found = doubt(left, seen.told, state.base.fitted, full, ahead, gains)
    if not (found.something_left and found.explained > MOSTLY and second and question.probes):
        return found
    return replace(found, lawful=_lawful(question, full, second, after))


def _lawful(question: Question, whole: Fitted, recordings: tuple[Recording, ...], best: Fitted) -> float:
    """Share of what `best` leaves of these shots that a generic law, as other shots told it, explains."""
    probed = fit(question, best.pieces, (*best.names, *question.probes), best.forms, best.shared, best.starts)
    pieces, starts = of_shots(whole, recordings)
    return lawful(follow(question, pieces, best, starts), follow(question, pieces, probed, starts))
