"""What a study says to people and programs: verdict, causes, how far the gap shrinks on shots that chose nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from diagnosis.fitting.fit_residuals import residuals
from diagnosis.fitting.gap_closure import (
    HORIZON,
    Closing,
    Foreseen,
    closing,
    floor,
    foreseeable,
    predict,
    shares,
    windows_ahead,
)
from diagnosis.fitting.hypothesis_fits import Fitted, Question, look
from diagnosis.selection.effect_selection import lacking
from diagnosis.selection.signatures import signatures
from diagnosis.selection.study import Study
from diagnosis.verdicts.candidate_probabilities import group_of, leading, probabilities, ranked, strengths
from diagnosis.verdicts.experiment_design import film_next, film_to_see, film_what_is_left
from diagnosis.verdicts.localisation import places, shape
from diagnosis.verdicts.verdict import Candidate, EffectShare, Gap, Report, Strength, Verdict
from models.core.typing import FloatArray
from models.estimation.gap_scenes.gap_scene import GapScene, Recording

_MIDDLING = 0.674
"""standard deviations that half of all strengths exceed."""


def reported(study: Study, recordings: tuple[Recording, ...], rng: np.random.Generator) -> Report:
    """The report, on `recordings` that nothing has looked at yet."""
    scene, best = study.question.scene, study.best
    verdict, groups, film = _verdict(study)
    gap, per_effect = _gap(study, recordings, rng)
    named = best.names if verdict in ("effects", "group") else ()
    phases = frozenset(phase for name in named for phase in _phases(scene, name))
    detectable = _detectable(study)
    return Report(
        scene=scene.name,
        model=scene.assumed,
        verdict=verdict,
        effects=tuple(sorted(best.names)) if verdict == "effects" else (),
        candidates=_candidates(study, groups, detectable, verdict in ("effects", "group")),
        where=places(study.left_before, study.base.pieces, phases) if verdict != "none" else (),
        shape=shape(study.after) if verdict == "unknown" else "",
        gap=gap,
        per_effect=per_effect,
        fitted=_all_strengths(study, detectable),
        forms=study.full.forms,
        unidentifiable=(*scene.gauges, *_hidden(study.question, detectable, frozenset(study.full.names))),
        not_tested=(*scene.not_tested, *_left_out(study)),
        film_next=_film(study, verdict, film),
        p_value=study.before.p_value,
        notes=(),
    )


def _left_out(study: Study) -> tuple[str, ...]:
    """Which shots were left out of the search."""
    used = {piece.shot for piece in study.state.first.fitted.pieces}
    return tuple(
        f"shot {shot} was left out: no path of the simulator comes near what was seen there"
        for shot in study.chosen
        if shot not in used
    )


def _verdict(study: Study) -> tuple[Verdict, dict[str, tuple[str, ...]], str]:
    """The verdict, the group of every effect named, and what to film."""
    question, best = study.question, study.best
    groups, film = {}, ""
    for name in best.names:
        without = lacking(study.state, best, name)
        seen = look(question, without)
        found = signatures(question, seen.told, without.free, best.fitted.lack)
        groups[name] = group_of(study.state, best, name, found)
        alike = tuple(one for one in groups[name] if one in question.candidates)
        if len(alike) > 1 and not film:
            rest = residuals(question, without, seen, np.random.default_rng(0))
            film = film_next(question, seen.told, rest, without.free, alike)
    if study.doubt.unknown:
        return "unknown", groups, film
    if not best.names:
        return ("unknown" if study.doubt.something_left else "none"), groups, film
    alone = len(best.names) == 1 and any(len(group) > 1 for group in groups.values())
    return ("group" if alone else "effects"), groups, film


def _film(study: Study, verdict: Verdict, apart: str) -> str:
    """What to film after this verdict: what separates a group (`apart`, if any), what is left, or what was missed."""
    if verdict == "unknown":
        return film_what_is_left(study.question, study.left_after)
    if apart:
        return apart
    question = study.question
    names = tuple(name for name in question.candidates if name not in study.full.names)
    told, found, lack = study.seen.told, study.left_after, study.full.lack
    return film_to_see(question, told, found, study.full.free, _usual(question), names, lack)


def _usual(question: Question) -> FloatArray:
    """(P,) strength that half of all tables exceed."""
    return _MIDDLING * np.array([prior.sigma for prior in question.priors])


def _phases(scene: GapScene, name: str) -> tuple[str, ...]:
    by_name = {effect.name: effect.phases for effect in scene.effects}
    return by_name.get(name, ()) or {choice.name: choice.phases for choice in scene.alternatives}.get(name, ())


def _candidates(
    study: Study, groups: dict[str, tuple[str, ...]], detectable: FloatArray, named: bool
) -> tuple[Candidate, ...]:
    question = study.question
    told = {name: strengths(question, _with(study, name), detectable, (name,)) for name in question.candidates}
    chances = probabilities(study.state, study.best, study.doubt)
    return ranked(leading(chances, study.best.names) if named else chances, groups, told)


def _detectable(study: Study) -> FloatArray:
    """(P,) smallest strength of every parameter that these data could have shown, all else as in the best model; of
    what the simulator has, the smallest change."""
    question, found = study.question, np.full(len(study.question.priors), np.inf)
    for name in (*question.candidates, *question.scene.assumed):
        mask = question.mask((name,))
        here = signatures(question, study.seen.told, study.full.free & ~mask, study.full.lack)
        found[mask] = here.detectable(mask)[mask]
    return found


def _with(study: Study, name: str) -> Fitted:
    """The best fit in which an effect is free; the base where none was tried."""
    if name in study.best.names:
        return study.full
    alone = study.state.tried.get(study.best.names | {name}) or study.state.tried.get(frozenset({name}))
    return study.base if alone is None else alone.fitted


def _all_strengths(study: Study, detectable: FloatArray) -> tuple[Strength, ...]:
    """Of the improved simulator, by effect and parameter: several effects have a mu."""
    names = tuple(effect.name for effect in study.question.scene.effects if effect.name in study.full.names)
    return tuple(
        replace(one, name=f"{name}.{one.name}")
        for name in (*study.question.scene.assumed, *names)
        for one in strengths(study.question, study.full, detectable, (name,))
    )


def _hidden(question: Question, detectable: FloatArray, named: frozenset[str]) -> tuple[str, ...]:
    """Effects not `named` that in some direction would more often than not be missed at usual strength: what the
    simulator has takes them up."""
    usual = _usual(question)
    masks = {name: question.mask((name,)) for name in question.candidates if name not in named}
    return tuple(name for name, mask in masks.items() if np.any(detectable[mask] > usual[mask]))


def _gap(
    study: Study, recordings: tuple[Recording, ...], rng: np.random.Generator
) -> tuple[Gap, tuple[EffectShare, ...]]:
    question, full = study.question, study.full
    foreseen = foreseeable(question, windows_ahead(question, recordings) if recordings else (), full, rng)
    windows = foreseen.windows
    before, after = (predict(question, windows, one, foreseen.starts) for one in (study.base, full))
    least = floor(question, windows, full, after)
    told = closing(windows, before.squares, after.squares, least, rng)
    if not study.best.names and not study.doubt.something_left:
        told = replace(told, closed=float("nan"), interval=(-1.0, 1.0), resolved=False)
    shots = tuple(sorted({one.piece.shot for one in windows}))
    horizon = max((float(one.piece.t[-1] - one.piece.t[one.known - 1]) for one in windows), default=HORIZON)
    gap = Gap(f"rms_{question.scene.unit}", min(horizon, HORIZON), shots, told, windows, before.paths, after.paths)
    return gap, _per_effect(study, foreseen, before.squares, after.squares, least, told, rng)


def _per_effect(
    study: Study,
    foreseen: Foreseen,
    before: FloatArray,
    after: FloatArray,
    least: FloatArray,
    told: Closing,
    rng: np.random.Generator,
) -> tuple[EffectShare, ...]:
    names = tuple(sorted(study.best.names))
    if not names or not told.resolved:
        return ()
    if len(names) == 1:
        return (EffectShare(names[0], told.closed, told.interval),)
    known, windows, starts = {frozenset[str](): before, frozenset(names): after}, foreseen.windows, foreseen.starts

    def squares_with(chosen: frozenset[str]) -> FloatArray:
        if chosen not in known:
            one = study.state.tried.get(chosen)
            known[chosen] = before if one is None else predict(study.question, windows, one.fitted, starts).squares
        return known[chosen]

    found = []
    for name, part in shares(names, squares_with).items():
        one = closing(windows, before, before - part, least, rng, limit=float("inf"))
        found.append(EffectShare(name, one.closed, one.interval))
    return tuple(found)


def undecidable(scene: GapScene, reason: str) -> Report:
    """The report on shots that cannot be tested."""
    unknown = float("nan")
    nothing = Closing(unknown, unknown, unknown, unknown, (-1.0, 1.0), False)
    return Report(
        scene=scene.name,
        model=scene.assumed,
        verdict="undecidable",
        effects=(),
        candidates=(),
        where=(),
        shape="",
        gap=Gap(f"rms_{scene.unit}", HORIZON, (), nothing, (), (), ()),
        per_effect=(),
        fitted=(),
        forms=tuple(choice.assumed for choice in scene.alternatives),
        unidentifiable=scene.gauges,
        not_tested=scene.not_tested,
        film_next=f"Film more: {reason}.",
        p_value=1.0,
        notes=(reason,),
    )
