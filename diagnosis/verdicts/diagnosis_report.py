"""The report of a study: verdict, causes, and how far the gap shrinks on hold-out shots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.fitting.fit_residuals import compute_residuals
from diagnosis.fitting.gap_closure import (
    GapClosure,
    PredictedShots,
    estimate_closure,
    predict_shots,
    shapley_shares,
    sum_squares,
)
from diagnosis.fitting.hypothesis_fits import DiagnosisProblem, EffectFit, fit_start_states, linearize_fit
from diagnosis.fitting.prediction_windows import HORIZON_S, PredictionWindow, predict_windows
from diagnosis.fitting.shot_preparation import SEGMENT_FRAMES
from diagnosis.selection.effect_selection import fit_without_effect
from diagnosis.selection.hypotheses import compute_signatures
from diagnosis.selection.hypothesis_trials import try_hypothesis
from diagnosis.selection.study import Study, select_shot_windows
from diagnosis.unexplained.force_law import find_force_law, measure_resolved_acceleration
from diagnosis.unexplained.local_patch import LocalPatch, find_local_patch, fit_outside_patch
from diagnosis.verdicts.candidate_probabilities import (
    compute_probabilities,
    estimate_shot_spreads,
    find_group,
    flip_gains,
    flip_signs,
    put_answer_first,
    smallest_p_value,
    summarize_bodies,
    summarize_strengths,
)
from diagnosis.verdicts.gap_localisation import (
    describe_structure,
    design_detecting_experiment,
    design_separating_experiment,
    design_unknown_experiment,
    localise_gap,
)
from diagnosis.verdicts.verdict import (
    CandidateEffect,
    DiagnosisReport,
    EffectShare,
    Gap,
    Strength,
    Unexplained,
    Verdict,
)
from diagnosis.verdicts.verdict_decision import decide_verdict
from models.core.recording import Recording
from models.core.typing import BoolArray, FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene
from models.estimation.gap_scenes.simulator_scene import SimulatorScene

_PATCH_NOTE = "the fitted parameters come from the motion outside the patch; with all of it they would be biased"
# Standard deviations that half of all strengths exceed.
_MEDIAN_SIGMAS = 0.674


def build_report(study: Study, recordings: tuple[Recording, ...], rng: np.random.Generator) -> DiagnosisReport:
    """Build the report of a study.

    Args:
        study: Results on fitting and selection shots.
        recordings: Hold-out shots, with the noise estimate applied.
        rng: Random generator of sampled starts and bootstrap.

    Returns:
        The report.
    """
    scene, best, evidence = study.problem.scene, study.best, study.unknown_evidence
    gap, per_effect = _measure_gap(study, recordings, rng)
    study = replace(study, unknown_evidence=evidence.supported)
    lacks_force = _lacks_shared_force(study)
    patch = find_local_patch(study.problem, study.full, rng) if lacks_force else None
    outside = study.full
    if patch is not None:
        outside = fit_outside_patch(study.problem, study.search.base.fitted, study.full, patch)
    named_effects, apart = _describe_named_effects(study)
    unexplained = _describe_unexplained(study, gap.closure, patch, lacks_force=lacks_force)
    probabilities = compute_probabilities(study.search, best, study.unknown_evidence)
    decision = decide_verdict(
        evidence, named_effects, probabilities, gap.closure, per_effect,
        len({*study.usable_shots, *(one.shot for one in recordings)}), len(gap.shots),
        not best.names <= set(outside.names), unexplained.is_clear,
    )  # fmt: skip
    verdict, named, notes = decision.verdict, decision.named, decision.notes
    # the candidates, among them `none` and `unknown`, that the verdict names
    answer = named or frozenset({verdict} & {"none", "unknown"})
    detectable = _detectable_strengths(study)
    probabilities = decision.share_probabilities(probabilities)
    candidates = _build_candidates(study, named_effects, detectable, probabilities, answer)
    film_next = (
        f"Record more: {decision.reason}."
        if verdict == "undecidable"
        else _recommend_experiment(study, verdict, apart, unexplained)
    )
    if np.isfinite(study.used_duration):  # of the search; hold-out shots are always predicted as a whole
        notes += (f"the search used the first {study.used_duration:.1f} s of each shot",)
    count, windows = study.used_windows
    if count < windows:
        notes += (f"the search used {count} of {windows} windows of the log, evenly over its time",)
    if outside is not study.full:
        notes += (_PATCH_NOTE,)
    acting = {choice.name: choice.phases for choice in scene.alternatives}
    acting |= {effect.name: effect.phases for effect in scene.effects if effect.phases}
    phases = frozenset(phase for name in named for phase in acting.get(name, ()))
    closed = {one.effect: one.closed for one in per_effect}
    by_closure = tuple(sorted(named, key=lambda name: (-closed.get(name, 0.0), name)))
    used = {segment.shot for segment in study.search.initial.fitted.segments}
    omitted = (
        f"shot {shot} was left out: no simulated path comes near its observations"
        for shot in study.usable_shots
        if shot not in used
    )
    return DiagnosisReport(
        scene=scene.name,
        model=scene.simulator_effects,
        verdict=verdict,
        effects=by_closure if verdict == "effects" else (),
        candidates=candidates,
        where=localise_gap(study.residuals_before, study.base.segments, phases) if verdict != "none" else (),
        gap=gap,
        per_effect=tuple(one for one in per_effect if one.effect not in decision.unmeasured),
        unexplained=unexplained,
        fitted=_summarize_all_strengths(study, outside, detectable),
        forms=study.full.forms,
        unidentifiable=(*scene.gauges, *_find_unidentifiable(study.problem, detectable, frozenset(study.full.names))),
        not_tested=(*scene.not_tested, *omitted),
        film_next=film_next,
        p_value=study.structure_before.p_value,
        notes=notes,
        reason=decision.reason,
    )


def _lacks_shared_force(study: Study) -> bool:
    """Tell whether more than noise remains that one force on all bodies could explain.

    Where strengths differ between bodies, what remains is beyond strengths that all bodies share.
    """
    return study.unknown_evidence.has_systematic_residuals and study.body_fit is None


def _describe_named_effects(study: Study) -> tuple[dict[str, CandidateEffect], str]:
    """Return what the shots say of every effect of the best hypothesis, and what would separate those of a group."""
    problem, best = study.problem, study.best
    named_effects, film = {}, ""
    for name in best.names:
        without = fit_without_effect(study.search, best, name)
        linearized = linearize_fit(problem, without)
        effect_signatures = compute_signatures(
            problem, linearized.shot_information, without.free, best.fitted.lack_of_fit
        )
        alike = find_group(study.search, best, name, effect_signatures)
        p_value = flip_signs(problem, linearized.shot_information, without.free, name, np.random.default_rng(0))
        choice = next((one for one in problem.scene.alternatives if one.name == name), None)
        if choice is not None:  # a model has no strength about which shots could agree
            p_value = flip_gains(_measure_shot_gains(problem, without, best.fitted), len(choice.forms) - 1)
        named_effects[name] = CandidateEffect(
            name, 0.0, tuple(one for one in alike if one not in study.refuted_by_bodies), (),
            p_value, smallest_p_value(len(linearized.shot_information.shots)),
            per_body=() if study.body_fit is None else summarize_bodies(problem, study.body_fit, name),
        )  # fmt: skip
        alike = tuple(one for one in named_effects[name].group if one in problem.candidates)
        if len(alike) > 1 and not film:
            rest = compute_residuals(problem, without, linearized, np.random.default_rng(0))
            film = design_separating_experiment(problem, linearized.shot_information, rest, without.free, alike)
    return named_effects, film


def _measure_shot_gains(problem: DiagnosisProblem, before: EffectFit, after: EffectFit) -> FloatArray:
    """Measure the chi2 (Q,) that each shot gains from a fit."""
    gains = []
    for shot in dict.fromkeys(one.shot for one in after.segments):
        costs = []
        for fitted in (before, after):
            windows = select_shot_windows(fitted, tuple(one for one in fitted.segments if one.shot == shot))
            costs.append(fit_start_states(problem, windows[0], fitted, windows[1]).cost)
        gains.append(costs[0] - costs[1])
    return np.array(gains)


def _recommend_experiment(study: Study, verdict: Verdict, apart: str, rest: Unexplained) -> str:
    """Recommend an experiment: it separates a group (`apart`), shows where a clear rest is, or a weak effect."""
    if verdict != "unknown" and apart:
        return apart
    if verdict == "unknown" or (rest.is_clear and rest.where):
        return design_unknown_experiment(study.problem, study.residuals_after)
    problem = study.problem
    names = tuple(name for name in problem.candidates if name not in study.full.names)
    information, residuals, lack = study.linearized.shot_information, study.residuals_after, study.full.lack_of_fit
    return design_detecting_experiment(
        problem, information, residuals, study.full.free, _typical_strengths(problem), names, lack
    )


def _typical_strengths(problem: DiagnosisProblem) -> FloatArray:
    """Return the strength (P,) that half of all tables exceed."""
    return _MEDIAN_SIGMAS * np.array([prior.sigma for prior in problem.priors])


def _build_candidates(
    study: Study,
    named_effects: dict[str, CandidateEffect],
    detectable: FloatArray,
    probabilities: dict[str, float],
    answer: frozenset[str],
) -> tuple[CandidateEffect, ...]:
    """Build the candidates, most probable first."""
    problem, body_fit = study.problem, study.body_fit
    shot_spreads, body_spreads = estimate_shot_spreads(study.linearized.shot_information, study.full), None
    if body_fit is not None:
        shot_spreads, body_spreads = np.where(body_fit.own, body_fit.shot_spread, shot_spreads), body_fit.spread
    probabilities = put_answer_first(probabilities, answer) if answer else probabilities
    candidates = []
    for name in sorted(probabilities, key=probabilities.__getitem__, reverse=True):
        one = named_effects.get(name, CandidateEffect(name, 0.0, (name,), ()))
        if name in problem.candidates:
            fitted, beside = _select_fit_with(study, name)
            spreads = (shot_spreads, body_spreads) if name in study.best.names else ()
            strengths = summarize_strengths(problem, fitted, detectable, (name,), *spreads)
            one = replace(one, strengths=strengths, fitted_beside=beside)
        candidates.append(replace(one, probability=probabilities[name]))
    return tuple(candidates)


def _detectable_strengths(study: Study) -> FloatArray:
    """Return the smallest detectable strength (P,) of every parameter; of the simulator's, the smallest change."""
    problem, strengths = study.problem, np.full(len(study.problem.priors), np.inf)
    for name in (*problem.candidates, *problem.scene.simulator_effects):
        mask = problem.mask((name,))
        here = compute_signatures(
            problem, study.linearized.shot_information, study.full.free & ~mask, study.full.lack_of_fit
        )
        strengths[mask] = here.detectable_strengths(mask)[mask]
    return strengths


def _select_fit_with(study: Study, name: str) -> tuple[EffectFit, tuple[str, ...] | None]:
    """Select the best fit in which an effect is free, and the effects beside it; the base where there is none."""
    if name in study.best.names:
        return study.full, tuple(sorted(study.best.names - {name}))
    hypotheses = study.search.hypotheses
    one = hypotheses.get(study.best.names | {name}) or hypotheses.get(frozenset({name}))
    return (study.base, None) if one is None else (one.fitted, tuple(sorted(one.names - {name})))


def _summarize_all_strengths(study: Study, fitted: EffectFit, detectable: FloatArray) -> tuple[Strength, ...]:
    """Summarize the parameters of the improved simulator, named `effect.parameter`, as several effects have a mu."""
    problem, scene = study.problem, study.problem.scene
    names = [one.name for one in scene.effects if one.name in fitted.names]
    own = scene.simulator_effects if scene.has_stated_values else ()
    stated = {(effect.name, one.name): one.value for effect in scene.effects if effect.name in own
              for one in effect.parameters}  # fmt: skip
    return tuple(
        replace(one, name=f"{name}.{one.name}", stated=stated.get((name, one.name), float("nan")))
        for name in (*scene.simulator_effects, *names)
        for one in summarize_strengths(problem, fitted, detectable, (name,))
    )


def _find_unidentifiable(problem: DiagnosisProblem, detectable: FloatArray, named: frozenset[str]) -> tuple[str, ...]:
    """Find effects not `named` that at typical strength would be missed in some direction more often than not."""
    is_missed = detectable > _typical_strengths(problem)
    has_sites = isinstance(problem.scene, SimulatorScene)
    others = (name for name in problem.candidates if name not in named)
    return tuple(one for name in others for one in list_missed_strengths(problem, name, is_missed, has_sites))


def list_missed_strengths(
    problem: DiagnosisProblem, effect: str, is_missed: BoolArray, has_sites: bool
) -> tuple[str, ...]:
    """List what of an effect the shots cannot show: all of it, or, of one with strengths per joint, some of these.

    Args:
        problem: Scene and priors.
        effect: Name of the effect.
        is_missed: (P,) parameters that would be missed at typical strength.
        has_sites: Whether parameters are strengths of joints, of which each may be missing alone; those of a direction
            belong together.

    Returns:
        The effect, or `effect.parameter` of those that would be missed.
    """
    numbers = np.flatnonzero(problem.mask((effect,)))
    weak = tuple(problem.priors[k].name for k in numbers if is_missed[k])
    return weak if has_sites and len(weak) < len(numbers) else (effect,) * bool(weak)


def _measure_gap(
    study: Study, recordings: tuple[Recording, ...], rng: np.random.Generator
) -> tuple[Gap, tuple[EffectShare, ...]]:
    """Measure the gap on hold-out shots before and after, and the share of each effect."""
    reference, reason = study.residuals_after.reference, _explain_unknown_floor(study, recordings)
    shots = predict_shots(study.problem, recordings, study.base, study.full, rng, study.body_fit)
    if reason:
        shots = replace(shots, floor=np.full(len(shots.windows), np.nan))
    windows = shots.windows
    closure = estimate_closure(windows, sum_squares(shots.before), sum_squares(shots.after), shots.floor, rng)
    horizon = max((float(one.segment.t[-1] - one.segment.t[one.start_rows - 1]) for one in windows), default=HORIZON_S)
    before, after = (tuple(one.path for one in predictions) for predictions in (shots.before, shots.after))
    gap = Gap(
        f"rms_{reference.unit}", min(horizon, HORIZON_S), tuple(sorted({one.segment.shot for one in windows})), closure,
        windows, before, after, reason, reference.coordinates if windows else (),
        _measure_error_as_stated(study, windows),
    )  # fmt: skip
    return gap, _share_closure(study, shots, closure, rng)


def _measure_error_as_stated(study: Study, windows: tuple[PredictionWindow, ...]) -> float:
    """Measure the rms distance of predictions with the coefficients of the simulator's file; NaN without a file."""
    problem = study.problem
    if not problem.scene.has_stated_values or not problem.scene.simulator_effects or not windows:
        return float("nan")
    values = np.array([one.value for one in problem.priors])
    stated = np.where(problem.mask(problem.scene.simulator_effects), values, study.base.shared)
    predicted = predict_windows(problem, windows, replace(study.base, shared=stated))
    count = sum(int(one.is_predicted.sum()) for one in windows)
    return float(np.sqrt(sum_squares(predicted).sum() / count))


def _explain_unknown_floor(study: Study, recordings: tuple[Recording, ...]) -> str:
    """Explain why the error of a right model is unknown; empty where it follows from the noise."""
    if study.noise.is_measured or all(one.is_sigma_stated for one in recordings):
        return ""
    return (
        f"the noise is unknown: no sigma is stated, and {study.noise.segment_count} stretches of"
        f" {SEGMENT_FRAMES} consecutive frames of smooth motion are too few to measure it"
    )


def _share_closure(
    study: Study, shots: PredictedShots, closure: GapClosure, rng: np.random.Generator
) -> tuple[EffectShare, ...]:
    """Share the closure among the named effects; where none is named, measure what the best one would close."""
    names = tuple(sorted(study.best.names))
    if not closure.resolved:
        return ()
    before = sum_squares(shots.before)
    squares = {frozenset[str](): before, frozenset(names): sum_squares(shots.after)}

    def squares_with(chosen: frozenset[str]) -> FloatArray:
        if chosen not in squares:
            one = try_hypothesis(study.search, chosen, study.search.base)
            squares[chosen] = sum_squares(predict_windows(study.problem, shots.windows, one.fitted))
        return squares[chosen]

    if not names:
        single = [one for one in study.search.hypotheses.values() if one.size == 1]
        names = tuple(max(single, key=study.search.log_evidence).names) if single else ()
    effect_shares = []
    for name, part in shapley_shares(names, squares_with).items():
        one = estimate_closure(shots.windows, before, before - part, shots.floor, rng, limit=float("inf"))
        alone = estimate_closure(shots.windows, before, squares_with(frozenset({name})), shots.floor, rng)
        beside = squares_with(frozenset(names) - {name}) - squares_with(frozenset(names))
        added = estimate_closure(shots.windows, before, before - beside, shots.floor, rng, limit=float("inf"))
        effect_shares.append(EffectShare(name, one.closed, one.interval, alone.closed, added.interval[0] > 0))
    return tuple(sorted(effect_shares, key=lambda one: one.closed, reverse=True))


def _describe_unexplained(
    study: Study,
    closure: GapClosure,
    patch: LocalPatch | None,
    *,
    lacks_force: bool,
) -> Unexplained:
    """Describe what remains after the named effects, on the shots that chose them; its size on hold-out shots."""
    is_systematic = study.unknown_evidence.has_systematic_residuals
    size = float(np.sqrt(np.maximum(closure.after**2 - closure.floor**2, 0.0)))
    reference = study.residuals_after.reference
    law = None
    if lacks_force and reference.unit != "px":  # an acceleration in the image is no force
        # where the named effects are no answer, what the simulator lacks is what it lacks without them
        without = study.base if study.unknown_evidence.is_unknown else study.full
        law = find_force_law(measure_resolved_acceleration(study.problem, without), reference.coordinates)
    return Unexplained(
        share=1.0 - closure.closed,
        size=size,
        times_floor=closure.after / closure.floor if closure.floor > 0 else float("nan"),
        probability=study.unknown_evidence.rest_probability if is_systematic else float("nan"),
        where=localise_gap(study.residuals_after, study.segments_after, frozenset()) if is_systematic else (),
        shape=describe_structure(study.structure_after, reference) if is_systematic else "",
        law=law,
        patch=patch,
    )


def build_undecidable_report(scene: GapScene, unit: str, reason: str) -> DiagnosisReport:
    """Build the report on shots that cannot be tested.

    Args:
        unit: Unit of the coordinates.
        reason: Why nothing can be tested.

    Returns:
        A report with the verdict `undecidable`.
    """
    return DiagnosisReport(
        scene=scene.name,
        model=scene.simulator_effects,
        verdict="undecidable",
        effects=(),
        candidates=(),
        where=(),
        gap=Gap(f"rms_{unit}", HORIZON_S),
        per_effect=(),
        unexplained=Unexplained(),
        fitted=(),
        forms=tuple(choice.simulator_form for choice in scene.alternatives),
        unidentifiable=scene.gauges,
        not_tested=scene.not_tested,
        film_next=f"Record more: {reason}.",
        p_value=1.0,
        notes=(),
        reason=reason,
    )
