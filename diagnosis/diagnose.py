"""The whole diagnosis: shots in, a report out. Shots that report are opened once, after the verdict stands."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from diagnosis.blocks import Structure, structure
from diagnosis.candidates import group_of, leading, probabilities, ranked, strengths
from diagnosis.close import HORIZON, Closing, Foreseen, closing, floor, foreseeable, predict, shares, windows_ahead
from diagnosis.exchanged import names_given_back
from diagnosis.film_next import film_next, film_to_see, film_what_is_left
from diagnosis.fitting import Fitted, Question, Seen, fit, follow, look, question_of
from diagnosis.growing import not_followed
from diagnosis.hypotheses import Hypothesis, Search, Watch, unwatched
from diagnosis.noise import Noise, estimate_noise, with_noise
from diagnosis.other_shots import alone, confirmed, gain, of_shots
from diagnosis.pieces import LEAST, fit_begun, lengthened, stretches
from diagnosis.residuals import Residuals, residuals
from diagnosis.signatures import signatures
from diagnosis.split import Split, split_shots
from diagnosis.unknown import MOSTLY, Doubt, doubt, lawful, least_gain
from diagnosis.verdict import Candidate, EffectShare, Gap, Report, Strength, Verdict
from diagnosis.where import places, shape
from diagnosis.which import lacking, search
from models.gap_scene import Eventful, Floats, GapScene, Recording

_MIDDLING = 0.674
"""standard deviations that half of all strengths exceed."""
_BY_CHANCE = 1e-4
"""chance that a body which lies still seems to move."""


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


def diagnose(scene: GapScene, recordings: tuple[Recording, ...], seed: int = 0, watch: Watch = unwatched) -> Report:
    """Where simulator and world part, which effect is missing, and how far the gap shrinks with it; `watch` is told
    what is being tried."""
    own = [names_given_back(one) for one in recordings]
    split = split_shots(tuple(recording for recording, _ in own))
    reason = _too_little(scene, split)
    if reason:
        return _undecidable(scene, reason)
    watch("fitting what the simulator has", ())
    study = _study(scene, split, np.random.default_rng(seed), watch)
    watch("predicting shots that chose nothing", tuple(sorted(study.best.names)))
    report = tuple(with_noise(split.report, study.noise))
    found = _reported(study, report, np.random.default_rng([seed, 1]))
    return replace(found, notes=tuple(str(exchange) for _, exchanges in own for exchange in exchanges))


def _too_little(scene: GapScene, split: Split) -> str:
    """Why nothing can be tested; empty where something can."""
    still = not any(_moves(one) for one in split.fit)
    if still and any(int(one.seen.sum(axis=0).max()) >= LEAST for one in split.fit):
        return "nothing moves in these shots"
    pieces = [piece.seen for one in split.fit for piece in scene.stretches(one)]
    rows = sum(int(seen.sum()) for seen in pieces if seen.any(axis=1).sum() >= LEAST)
    if rows < 2 * LEAST:
        return f"{rows} observations are too few to test anything; at least {2 * LEAST} are needed"
    return ""


def _moves(recording: Recording) -> bool:
    """Whether a body gets further than its own scatter explains."""
    for body in range(len(recording.bodies)):
        seen = recording.places[recording.seen[:, body], body]
        if len(seen) < LEAST:
            continue
        scatter = np.abs(np.diff(seen, axis=0)).mean() * np.sqrt(np.pi) / 2
        if np.ptp(seen, axis=0).max() > 2 * norm.isf(_BY_CHANCE / len(seen)) * scatter:
            return True
    return False


def _study(scene: GapScene, split: Split, rng: np.random.Generator, watch: Watch) -> Study:
    noise = estimate_noise((*split.fit, *split.select))
    question = question_of(scene, noise.correlation)
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
    ahead = _ahead(question, second or first, before, after, rng)
    found = doubt(left, seen.told, state.base.fitted, full, ahead, gains)
    if not (found.something_left and found.explained > MOSTLY and second and question.probes):
        return found
    return replace(found, lawful=_lawful(question, full, second, after))


def _lawful(question: Question, whole: Fitted, recordings: tuple[Recording, ...], best: Fitted) -> float:
    """Share of what `best` leaves of these shots that a generic law, as other shots told it, explains."""
    probed = fit(question, best.pieces, (*best.names, *question.probes), best.forms, best.shared, best.starts)
    pieces, starts = of_shots(whole, recordings)
    return lawful(follow(question, pieces, best, starts), follow(question, pieces, probed, starts))


def _ahead(
    question: Question, recordings: tuple[Recording, ...], base: Fitted, best: Fitted, rng: np.random.Generator
) -> Closing:
    """How much better shots that may be looked at are predicted."""
    foreseen = foreseeable(question, windows_ahead(question, recordings), best, rng)
    windows = foreseen.windows
    before, after = (predict(question, windows, one, foreseen.starts) for one in (base, best))
    return closing(windows, before.squares, after.squares, floor(question, windows, best, after), rng)


def _reported(study: Study, recordings: tuple[Recording, ...], rng: np.random.Generator) -> Report:
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
        told = look(question, without).told
        found = signatures(question, told, without.free, best.fitted.lack)
        groups[name] = group_of(study.state, best, name, found)
        alike = tuple(one for one in groups[name] if one in question.candidates)
        if len(alike) > 1 and not film:
            rest = residuals(question, without, look(question, without), np.random.default_rng(0))
            film = film_next(question, told, rest, without.free, alike)
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


def _usual(question: Question) -> Floats:
    """(P,) strength that half of all tables exceed."""
    return _MIDDLING * np.array([prior.sigma for prior in question.priors])


def _phases(scene: GapScene, name: str) -> tuple[str, ...]:
    by_name = {effect.name: effect.phases for effect in scene.effects}
    return by_name.get(name, ()) or {choice.name: choice.phases for choice in scene.alternatives}.get(name, ())


def _candidates(
    study: Study, groups: dict[str, tuple[str, ...]], detectable: Floats, named: bool
) -> tuple[Candidate, ...]:
    question = study.question
    told = {name: strengths(question, _with(study, name), detectable, (name,)) for name in question.candidates}
    chances = probabilities(study.state, study.best, study.doubt)
    return ranked(leading(chances, study.best.names) if named else chances, groups, told)


def _detectable(study: Study) -> Floats:
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


def _all_strengths(study: Study, detectable: Floats) -> tuple[Strength, ...]:
    """Of the improved simulator, by effect and parameter: several effects have a mu."""
    names = tuple(effect.name for effect in study.question.scene.effects if effect.name in study.full.names)
    return tuple(
        replace(one, name=f"{name}.{one.name}")
        for name in (*study.question.scene.assumed, *names)
        for one in strengths(study.question, study.full, detectable, (name,))
    )


def _hidden(question: Question, detectable: Floats, named: frozenset[str]) -> tuple[str, ...]:
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
    before: Floats,
    after: Floats,
    least: Floats,
    told: Closing,
    rng: np.random.Generator,
) -> tuple[EffectShare, ...]:
    names = tuple(sorted(study.best.names))
    if not names or not told.resolved:
        return ()
    if len(names) == 1:
        return (EffectShare(names[0], told.closed, told.interval),)
    known, windows, starts = {frozenset[str](): before, frozenset(names): after}, foreseen.windows, foreseen.starts

    def squares_with(chosen: frozenset[str]) -> Floats:
        if chosen not in known:
            one = study.state.tried.get(chosen)
            known[chosen] = before if one is None else predict(study.question, windows, one.fitted, starts).squares
        return known[chosen]

    found = []
    for name, part in shares(names, squares_with).items():
        one = closing(windows, before, before - part, least, rng, limit=float("inf"))
        found.append(EffectShare(name, one.closed, one.interval))
    return tuple(found)


def _undecidable(scene: GapScene, reason: str) -> Report:
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
