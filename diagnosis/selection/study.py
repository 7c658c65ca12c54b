"""The study of fitting and selection shots: search, best hypothesis, and the evidence for an unknown effect."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from diagnosis.fitting.body_strengths import (
    BodyFit,
    compute_body_residuals,
    fit_body_strengths,
    linearize_bodies,
)
from diagnosis.fitting.diagnosis_windows import (
    count_windows,
    fit_initial_windows,
    fit_longer_windows,
    split_into_segments,
    thin_out_windows,
)
from diagnosis.fitting.fit_residuals import FitResiduals, ResidualStructure, compute_residuals, find_structure
from diagnosis.fitting.gap_closure import measure_closure
from diagnosis.fitting.hypothesis_fits import (
    COARSE_FIT,
    FULL_FIT,
    DiagnosisProblem,
    EffectFit,
    LinearizedFit,
    build_diagnosis_problem,
    fit_effects,
    fit_start_states,
    linearize_fit,
    refit_effects,
)
from diagnosis.fitting.shot_preparation import (
    NoiseEstimate,
    ShotSplit,
    apply_noise_estimate,
    estimate_noise,
    find_common_duration,
    shorten_recordings,
)
from diagnosis.fitting.window_continuation import find_unreachable_shots
from diagnosis.selection.effect_selection import fit_without_effect, search_effects, select_hypothesis
from diagnosis.selection.hypotheses import REFUTED_RIVAL_LOG_EVIDENCE, EffectSearch, Hypothesis, ProgressCallback
from diagnosis.selection.hypothesis_trials import restart_disagreeing_shots
from diagnosis.selection.unknown_effects import (
    MIN_EXPLAINED_SHARE,
    MIN_LAW_SHARE,
    UnknownEvidence,
    agreement_p_value,
    estimate_explained_share,
    min_selection_gain,
)
from models.core.recording import Recording
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import ContactRichScene, GapScene
from models.estimation.gap_scenes.simulator_scene import SimulatorScene
from models.estimation.multiple_shooting.shooting_fit import ShootingOptions
from models.numerics.executor import SERIAL, Executor

# s of all shots together that a search uses in a contact-rich scene, where its cost grows with the number of contacts.
#
# Nine shots of four seconds: with shots of two seconds nearly all effects of usual strength are named.
ENOUGH_SECONDS = 36.0
# Windows of all shots together that a search uses of a simulator from outside, each half a typical period or longer.
#
# A bound on the time of a search, which grows with the windows times the parameters; other numbers were not measured.
# The report states the share that was used.
ENOUGH_WINDOWS = 32


@dataclass(frozen=True, slots=True)
class Study:
    """Results of estimation and selection, without hold-out shots."""

    problem: DiagnosisProblem
    noise: NoiseEstimate
    search: EffectSearch
    best: Hypothesis
    base: EffectFit
    """Fit of the simulator to fitting and selection shots."""
    full: EffectFit
    """Fit of the best hypothesis to the same."""
    linearized: LinearizedFit
    """Linearisation of `full`."""
    usable_shots: tuple[int, ...]
    """Indices of the shots that could be used."""
    used_duration: float
    """s from the start of each shot that were used; infinite where all of it was."""
    used_windows: tuple[int, int]
    """Windows of a simulator from outside that were used, and of how many; (0, 0) for other scenes."""
    residuals_before: FitResiduals
    """Residuals of `base`."""
    residuals_after: FitResiduals
    """Residuals of `full`."""
    structure_before: ResidualStructure
    """Systematic structure of `residuals_before`."""
    structure_after: ResidualStructure
    """Systematic structure of `residuals_after`."""
    unknown_evidence: UnknownEvidence
    """Evidence for an effect that the library lacks."""
    body_fit: BodyFit | None = None
    """The best hypothesis with strengths of every body; None where all bodies may have the same. `residuals_after` are
    then its residuals."""
    refuted_by_bodies: frozenset[str] = frozenset()
    """Rivals that strengths of every body refute."""

    @property
    def segments_after(self) -> tuple[Recording, ...]:
        """Windows of `residuals_after`."""
        return self.full.segments if self.body_fit is None else self.body_fit.segments


def run_study(
    scene: GapScene,
    split: ShotSplit,
    rng: np.random.Generator,
    on_progress: ProgressCallback,
    executor: Executor = SERIAL,
) -> Study:
    """Search for missing effects and assess the evidence for an unknown one, without hold-out shots.

    Args:
        scene: Scene with a catalogue of effects.
        split: Recordings by use; `holdout` is not used.
        rng: Random generator of the noise samples.
        on_progress: Receives a description of each step and the names of its effects.
        executor: Distributes the fits over processes; it does not change the results.

    Returns:
        The study.
    """
    noise = estimate_noise((*split.fitting, *split.selection))
    problem = build_diagnosis_problem(scene, noise, executor)
    first, second = apply_noise_estimate(split.fitting, noise), apply_noise_estimate(split.selection, noise)
    duration, used_windows = float("inf"), (0, 0)
    if isinstance(scene, ContactRichScene):
        duration = find_common_duration((*first, *second), ENOUGH_SECONDS)
        first, second = shorten_recordings(first, duration), shorten_recordings(second, duration)
    if isinstance(scene, SimulatorScene):
        whole = (*first, *second)
        used = thin_out_windows(problem, whole, ENOUGH_WINDOWS)
        used_windows = count_windows(problem, used), count_windows(problem, whole)
        first, second = used[: len(first)], used[len(first) :]
    search = _run_search(problem, (*first, *second), on_progress)
    if isinstance(scene, ContactRichScene):
        restart_disagreeing_shots(search)
    confirmed = confirm_effects(search, first, second)
    best, body_fit, refuted = _compare_with_body_strengths(search, confirmed)
    base, full = search.simulator_fit, best.fitted
    linearized_base = linearize_fit(problem, base)
    linearized_full = linearized_base if full is base else linearize_fit(problem, full)
    residuals_before = compute_residuals(problem, base, linearized_base, rng)
    bodies = ((full, linearized_full),) if body_fit is None else linearize_bodies(problem, full, body_fit)
    residuals_after = compute_body_residuals(problem, bodies, rng)
    structure_before, structure_after = find_structure(residuals_before), find_structure(residuals_after)
    is_noise_known = noise.is_measured or all(one.is_sigma_stated for one in (*first, *second))
    scale = residuals_after.scale if is_noise_known else 1.0
    agreement = agreement_p_value(*((one.shot_information, fitted) for fitted, one in bodies))
    evidence = UnknownEvidence(structure_after.p_value, scale, agreement)
    unknown_evidence = _test_best(search, best, body_fit, (first, second), evidence, linearized_full, rng)
    usable_shots = tuple(sorted(one.shot for one in (*first, *second) if len(split_into_segments(problem, (one,)))))
    return Study(
        problem,
        noise,
        search,
        best,
        base,
        full,
        linearized_full,
        usable_shots,
        duration,
        used_windows,
        residuals_before,
        residuals_after,
        structure_before,
        structure_after,
        unknown_evidence,
        body_fit,
        refuted,
    )


def _run_search(
    problem: DiagnosisProblem, recordings: tuple[Recording, ...], on_progress: ProgressCallback
) -> EffectSearch:
    """Search on windows that need no hypothesis, and again on those that the best one allows."""
    base = fit_initial_windows(problem, recordings)
    odd = find_unreachable_shots(problem, base)
    if odd:
        recordings = tuple(one for one in recordings if one.shot not in odd)
        base = fit_initial_windows(problem, recordings)
    search = search_effects(problem, base, lambda fitted: fit_longer_windows(problem, recordings, fitted), on_progress)
    if search.simulator_fit is base and isinstance(problem.scene, ContactRichScene):
        search.simulator_fit = fit_longer_windows(problem, recordings, base)
    return search


def _test_best(
    search: EffectSearch,
    best: Hypothesis,
    body_fit: BodyFit | None,
    shots: tuple[tuple[Recording, ...], tuple[Recording, ...]],
    evidence: UnknownEvidence,
    linearized: LinearizedFit,
    rng: np.random.Generator,
) -> UnknownEvidence:
    """Add what the best hypothesis explains, and its gain on selection shots, to the evidence for an unknown effect."""
    problem, base, full, (first, second) = search.problem, search.simulator_fit, best.fitted, shots
    if not best.names:
        share, most = estimate_explained_share(base, full, linearized.shot_information, None)
        evidence = replace(evidence, explained_share=share, most_probability=most)
        if not (second and evidence.has_systematic_residuals):
            return evidence
        alone = refit_on_shots(problem, first, base)
        return evidence.judge_by_predictions(measure_closure(problem, second, alone, alone, rng))
    before, after = refit_on_shots(problem, first, base), refit_on_shots(problem, first, full)
    gains = not second or cross_shot_gain(problem, full, second, before, after) > min_selection_gain(
        len(first), len(second)
    )
    body_after = None if body_fit is None else fit_body_strengths(problem, after, body_fit.own)
    ahead = measure_closure(problem, second or first, before, after, rng, body_after)
    share, most = estimate_explained_share(search.base.fitted, full, linearized.shot_information, ahead)
    evidence = replace(
        evidence, explained_share=share, most_probability=most, selection_gains=gains, effect_count=best.size
    )
    if second:  # else these shots estimated the strengths
        evidence = evidence.judge_by_predictions(ahead)
    is_named = evidence.has_systematic_residuals and share > MIN_EXPLAINED_SHARE
    if not (is_named and second and problem.probes):
        return evidence
    return judge_by_generic_laws(problem, evidence, full, second, before, after)


def judge_by_generic_laws(
    problem: DiagnosisProblem,
    evidence: UnknownEvidence,
    whole: EffectFit,
    recordings: tuple[Recording, ...],
    before: EffectFit,
    after: EffectFit,
) -> UnknownEvidence:
    """Judge named effects by what generic laws, alone or beside them, explain of what they leave on other shots.

    Args:
        problem: Scene and priors.
        evidence: The evidence so far.
        whole: Fit of the named effects to all shots.
        recordings: Selection shots.
        before: Fit of the simulator to fitting shots.
        after: Fit of the named effects to fitting shots.

    Returns:
        The evidence with the probability of an imitation, else with the share of generic laws.
    """
    if evidence.effect_count > 1:  # several effects may imitate one law, as the terms of a series do
        law_share, is_better = _measure_generic_law_shares(problem, whole, recordings, after, before)
        if law_share > MIN_LAW_SHARE and 2 * sum(is_better) > len(is_better):
            return replace(evidence, imitation_probability=(sum(is_better) + 1) / (len(is_better) + 2))
    law_share = _measure_generic_law_shares(problem, whole, recordings, after, after)[0]
    return replace(evidence, generic_law_share=law_share)


def _measure_generic_law_shares(
    problem: DiagnosisProblem, whole: EffectFit, recordings: tuple[Recording, ...], best: EffectFit, beside: EffectFit
) -> tuple[float, list[bool]]:
    """Measure what generic laws, beside the effects of a fit to other shots, explain of what the best one leaves.

    Returns:
        Share of the misfit of these shots, and whether the laws explain each of the shots better.
    """
    names = (*beside.names, *problem.probes)
    probed = fit_effects(problem, best.segments, names, beside.forms, beside.shared, best.starts)
    left, gained, is_better = 0.0, 0.0, []
    for one in recordings:
        segments, starts = select_shot_windows(whole, (one,))
        if not segments:
            continue
        without, with_laws = (fit_start_states(problem, segments, fitted, starts) for fitted in (best, probed))
        left, gained = left + without.systematic_cost, gained + without.cost - with_laws.cost
        is_better.append(with_laws.cost < without.cost)
    return (float(np.clip(gained / left, -1.0, 1.0)) if left > 0 else 0.0), is_better


def _compare_with_body_strengths(
    search: EffectSearch, best: Hypothesis
) -> tuple[Hypothesis, BodyFit | None, frozenset[str]]:
    """Replace an effect whose strength differs between bodies by a rival that explains every body better.

    With strengths that all bodies share, each law leaves the differences between bodies, and the law that leaves less
    of them is not the right one.

    Returns:
        The best hypothesis; the same with strengths of every body, None where all bodies may have the same; and the
        effects that are worse in place of one whose strength differs.
    """
    problem, body_fit = search.problem, fit_body_strengths(search.problem, best.fitted)
    if body_fit is None:
        return best, None, frozenset()
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
        return best, body_fit, frozenset()
    noise = min(own.shooting.inflation for _, own in fits.values())
    evidence = {
        name: -0.5 * own.shooting.cost / noise - 0.5 * len(own.shooting.shared) * float(np.log(one.fitted.value_count))
        for name, (one, own) in fits.items()
    }
    first = max(evidence, key=evidence.__getitem__)
    refuted = frozenset(name for name in fits if evidence[first] - evidence[name] > REFUTED_RIVAL_LOG_EVIDENCE)
    chosen = fits[first][0]
    if chosen is not best:
        body_fit = fit_body_strengths(problem, chosen.fitted)
    return chosen, body_fit, refuted - chosen.names


def confirm_effects(search: EffectSearch, first: tuple[Recording, ...], second: tuple[Recording, ...]) -> Hypothesis:
    """Drop effects that `second` shots do not confirm, with strengths from the `first` shots.

    Args:
        search: The finished search.
        first: Fitting shots.
        second: Selection shots; if empty, each shot is tested with strengths from the others.

    Returns:
        The hypothesis of the effects that remain.
    """
    problem, best, split = search.problem, select_hypothesis(search), split_folds(first, second)
    while split and best.size > 1:
        gains = dict.fromkeys(sorted(best.names), 0.0)
        # a fit without an effect converges slowly; a coarse fit favours no hypothesis, as it starts from all shots
        without = {name: fit_without_effect(search, best, name) for name in gains}
        for others, here in split:
            whole = refit_on_shots(problem, others, best.fitted)
            for name in gains:
                gains[name] += cross_shot_gain(
                    problem, best.fitted, here, refit_on_shots(problem, others, without[name], COARSE_FIT), whole
                )
        least = min(gains, key=lambda name: gains[name])
        if gains[least] > 0:
            break
        best = search.hypotheses[best.names - {least}]
    return best


def split_folds(
    first: tuple[Recording, ...], second: tuple[Recording, ...]
) -> list[tuple[tuple[Recording, ...], tuple[Recording, ...]]]:
    """Split shots into pairs of shots that estimate strengths and shots that test them."""
    if second:
        return [(first, second)]
    numbers = sorted({one.shot for one in first})
    split = (
        (tuple(one for one in first if one.shot != n), tuple(one for one in first if one.shot == n)) for n in numbers
    )
    return [fold for fold in split if fold[0]]


def cross_shot_gain(
    problem: DiagnosisProblem, whole: EffectFit, recordings: tuple[Recording, ...], base: EffectFit, best: EffectFit
) -> float:
    """Return the chi2 that shots gain from effects whose parameters were fitted to other shots.

    Windows and initial start states are those of the fit to the `whole`.
    """
    segments, starts = select_shot_windows(whole, recordings)
    if not segments:
        return 0.0
    before, after = fit_start_states(problem, segments, base, starts), fit_start_states(problem, segments, best, starts)
    return (before.cost - after.cost) / max(best.lack_of_fit, 1.0)


def refit_on_shots(
    problem: DiagnosisProblem, recordings: tuple[Recording, ...], like: EffectFit, options: ShootingOptions = FULL_FIT
) -> EffectFit:
    """Refit a hypothesis to some of its shots."""
    segments, starts = select_shot_windows(like, recordings)
    return refit_effects(problem, segments, like, starts, options=options)


def select_shot_windows(
    fitted: EffectFit, recordings: tuple[Recording, ...]
) -> tuple[tuple[Recording, ...], tuple[FloatArray, ...]]:
    """Select the windows of some shots of a fit, and their start states."""
    shots = {one.shot for one in recordings}
    here = [k for k, segment in enumerate(fitted.segments) if segment.shot in shots]
    return tuple(fitted.segments[k] for k in here), tuple(fitted.starts[k] for k in here)
