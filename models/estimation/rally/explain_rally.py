"""From candidates to a rally: association, search over sequences of flights, joint fit, landing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from models.core.corrections import NO_CORRECTIONS, BallMark, Corrections
from models.core.court import Sport
from models.core.court_camera import CourtScene
from models.core.progress import Progress
from models.core.rally import BallCandidates, Rally, RallyEvent, RallyEventKind
from models.core.typing import FloatArray, IntArray
from models.estimation.rally.event_chances import EVIDENCE_SHARE, SLIP
from models.estimation.rally.event_evidence import name_contact
from models.estimation.rally.flight_fit import (
    RallyFit,
    fit_rally,
    flight_slice,
    refine_fit,
    start_row,
)
from models.estimation.rally.flight_observations import (
    EventMark,
    FlightObservations,
    stabilize_places,
)
from models.estimation.rally.flight_segmentation import segment_rally
from models.estimation.rally.guided_association import Sight, choose_candidates, look_at_candidates
from models.estimation.rally.image_association import associate_candidates
from models.estimation.rally.initial_flights import align_flights
from models.estimation.rally.landing_hypotheses import merge_landings
from models.estimation.rally.play_order import judge_order, locate_event
from models.estimation.rally.rally_building import build_rally, find_last_player, weigh_flights
from models.estimation.rally.rally_clock import estimate_capture_times, is_uneven
from models.estimation.rally.rally_marks import (
    choose_placed,
    correct_candidates,
    find_contradicted,
    resolve_marks,
    resolve_places,
    settle_marks,
)
from models.estimation.rally.rally_revision import WORST_RIVAL, Doubt, leave_out_flights, revise_structures, weigh_fit
from models.estimation.rally.rolling_ball import end_at_roll

# m and s up to which events of the same kinds are the same: far less than two explanations differ by.
_SAME_PLACE, _SAME_MOMENT = 0.25, 0.02
# s between flights up to which they follow each other at once.
_SAME_TIME = 1e-6
# Largest number of rival explanations.
_MOST_RIVALS = 8
# Probability from which an event is stated: what is less probable than not did not happen.
_LEAST_EVENT = 0.5
# Sequences of flights that are fitted wholly.
_MOST_SEQUENCES = 2


@dataclass(frozen=True, slots=True)
class RallyExplanations:
    """What may have happened in a clip."""

    rallies: tuple[Rally, ...]
    """The most probable first."""
    evidence: FloatArray
    """(R,) natural logarithm."""
    doubts: tuple[Doubt, ...]
    """Events of the first one that might be otherwise, of which nothing else depends."""


def explain_rally(
    scene: CourtScene,
    candidates: BallCandidates,
    frame: IntArray,
    t: FloatArray,
    progress: Progress,
    corrections: Corrections = NO_CORRECTIONS,
) -> Rally:
    """Explain the candidates of a clip as the most probable rally; without flights where nothing flies.

    Args:
        scene: Court and camera.
        candidates: Candidates of all frames.
        frame: (T,) indices of the distinct frames in the file.
        t: (T,) s, when they are shown.
        progress: Receives the finished share.
        corrections: Places and events that a person marked, which are taken as given.
    """
    places = resolve_places(corrections.balls, frame)
    candidates = correct_candidates(candidates, places)
    t = _find_capture_times(scene, candidates, frame, t)
    marks = resolve_marks(corrections.events, frame, t)
    rally = combine_explanations(find_explanations(scene, candidates, frame, t, progress, places, marks))
    if lost := find_contradicted(rally, marks):  # it must not cost what is right
        others = tuple(mark for mark in marks if mark not in lost)
        rally = combine_explanations(find_explanations(scene, candidates, frame, t, progress, places, others))
    return settle_marks(end_at_roll(rally, candidates, places, marks), places, marks)


def find_explanations(
    scene: CourtScene,
    candidates: BallCandidates,
    frame: IntArray,
    t: FloatArray,
    progress: Progress,
    places: tuple[BallMark, ...] = (),
    marks: tuple[EventMark, ...] = (),
) -> RallyExplanations:
    """Find the rallies that the candidates of a clip may show.

    Args:
        scene: Court and camera.
        candidates: Candidates of all frames.
        frame: (T,) indices of the distinct frames in the file.
        t: (T,) s, when they were taken.
        progress: Receives the finished share.
        places: Places that a person marked, of which the candidates are part.
        marks: Events that a person marked, as part of the evidence.

    Returns:
        At least one rally.
    """
    sport = scene.sport
    chosen = choose_placed(associate_candidates(scene, candidates, frame, t), candidates, frame, places)
    placed = t[np.isin(frame, [one.ball.frame for one in places if one.kind == "placed"])]
    progress(0.2)
    sight = look_at_candidates(scene, candidates, frame, t, chosen, marks, placed)
    px = stabilize_places(scene.camera, frame[sight.rows], candidates.centre[chosen[sight.rows]])
    hypotheses = segment_rally(sight.observed, px, sport, lambda share: progress(0.2 + 0.4 * share))
    fits: list[RallyFit] = []
    hypotheses = hypotheses[:_MOST_SEQUENCES]
    for k, hypothesis in enumerate(hypotheses):
        fit = fit_rally(sight.observed, sport, align_flights(sight.observed, sport, hypothesis))
        if fit is not None and not any(_are_same(fit, other) for other in fits):
            fits.append(fit)
        progress(0.6 + 0.3 * (k + 1) / len(hypotheses))
    if not fits:
        return RallyExplanations((_build_empty(scene, candidates, frame, t),), np.zeros(1), ())
    fits.sort(key=lambda fit: -weigh_fit(fit, sight.observed))
    least = weigh_fit(fits[0], sight.observed) - WORST_RIVAL
    near = [fit for fit in fits if weigh_fit(fit, sight.observed) > least]
    revisions = revise_structures(sight.observed, sport, near)
    revised = revisions[0]
    others = [*(revision.best for revision in revisions[1:]), *fits]
    fits = [revised.best, *revised.rivals, *(fit for fit in others if not _are_same(fit, revised.best))]
    chosen = choose_candidates(scene, candidates, frame, t, sight.chosen, fits[0])
    chosen = choose_placed(chosen, candidates, frame, places)
    if (chosen != sight.chosen).any():
        sight = look_at_candidates(scene, candidates, frame, t, chosen, marks, placed)
        refined = (refine_fit(sight.observed, sport, fit.structure, fit.values) for fit in fits)
        fits = [fit for fit in refined if fit is not None] or fits
    fits = [_leave_out_unlikely(fit, sight, candidates, sport) for fit in _select_fits(fits, sight.observed)]
    evidence = np.array([weigh_fit(fit, sight.observed) for fit in fits])
    order = np.argsort(-evidence, kind="stable")
    rallies = tuple(build_rally(scene, candidates, frame, t, sight, fits[k]) for k in order)
    progress(1.0)
    return RallyExplanations(rallies, evidence[order], revised.doubts)


def _find_capture_times(scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray) -> FloatArray:
    """Find when frames (T,) were taken that are shown at t (T,) s."""
    if not is_uneven(t):
        return t
    chosen = associate_candidates(scene, candidates, frame, t)
    rows = np.flatnonzero(chosen >= 0)
    px = stabilize_places(scene.camera, frame[rows], candidates.centre[chosen[rows]])
    return estimate_capture_times(rows, px, candidates.sigma[chosen[rows]], t)


def _leave_out_unlikely(fit: RallyFit, sight: Sight, candidates: BallCandidates, sport: Sport) -> RallyFit:
    """Leave out flights that probably show something else, so that they do not bend their neighbours."""
    chances = np.array(weigh_flights(candidates, sight, fit, np.ones(len(sight.rows), np.bool_)))
    if (chances >= _LEAST_EVENT).all() or not (chances >= _LEAST_EVENT).any():
        return fit
    structure, values = leave_out_flights(fit.structure, fit.values, chances < _LEAST_EVENT)
    return refine_fit(sight.observed, sport, structure, values) or fit


def _select_fits(fits: list[RallyFit], observed: FlightObservations) -> list[RallyFit]:
    """Leave out explanations that occur twice, or that no longer matter."""
    best = sorted(fits, key=lambda fit: -weigh_fit(fit, observed))
    selected: list[RallyFit] = []
    for fit in best:
        matters = weigh_fit(fit, observed) > weigh_fit(best[0], observed) - WORST_RIVAL
        if matters and len(selected) < _MOST_RIVALS and not any(_are_same(fit, other) for other in selected):
            selected.append(fit)
    return selected


def _are_same(one: RallyFit, other: RallyFit) -> bool:
    """Check whether two fits are one explanation, of which the search may have stopped at slightly other values."""
    if one.structure.kinds != other.structure.kinds or one.structure.joined != other.structure.joined:
        return False
    off, count = np.abs(one.values - other.values), len(one.structure)
    places = np.concatenate([off[flight_slice(k)][:3] for k in range(count)])
    return bool(places.max() < _SAME_PLACE and off[start_row(0, count) :].max() < _SAME_MOMENT)


def _build_empty(scene: CourtScene, candidates: BallCandidates, frame: IntArray, t: FloatArray) -> Rally:
    nothing = np.full((len(t), 2), np.nan)
    return Rally(
        scene, frame, t, nothing, nothing, nothing, np.zeros(len(t), np.bool_), (), (),
        players=candidates.players, notes=("no-flight",),
    )  # fmt: skip


def _weigh_doubts(doubts: tuple[Doubt, ...], kind: RallyEventKind, t: float, interval: float, share: float) -> float:
    """Return the probability that doubts leave to an event of a kind at a time, s."""
    near = (doubt for doubt in doubts if doubt.kind == kind and abs(doubt.t - t) < interval / 2)
    return 1 / (1 + sum(float(np.exp(share * doubt.gain)) for doubt in near))


def combine_explanations(explanations: RallyExplanations, share: float = EVIDENCE_SHARE) -> Rally:
    """Weigh the events and the landing of the best rally by all explanations.

    Args:
        explanations: Explanations.
        share: Share of the evidence that counts.
    """
    rallies, doubts, best = explanations.rallies, explanations.doubts, explanations.rallies[0]
    if not best.flights:
        return best
    weights = np.exp(share * (explanations.evidence - explanations.evidence.max()))
    weights, interval = weights / weights.sum(), float(np.median(np.diff(best.t)))
    events = []
    for event in best.events:
        support = sum(
            weight
            for rally, weight in zip(rallies, weights, strict=True)
            if any(other.kind == event.kind and abs(other.t - event.t) < 1.5 * interval for other in rally.events)
        )
        support *= _weigh_doubts(doubts, event.kind, event.t, interval, share)
        events.append(replace(event, probability=float(min(event.probability * support, 1.0))))
    contact, pairs = name_contact(best.scene.sport), []
    for rally, weight in zip(rallies, weights, strict=True):
        landing = rally.landings[0] if rally.landings else None
        if landing is not None:
            trusted = _weigh_doubts(doubts, contact, landing.t, interval, share)
            landing = replace(landing, weight=landing.weight * trusted)
        pairs.append((float(weight), landing))
    landings, nothing = merge_landings(pairs)
    last_player = find_last_player(events)
    events = lower_by_rules(best, events)
    events = [event for event in events if event.probability >= _LEAST_EVENT]
    return replace(best, events=tuple(events), landings=landings, no_landing=nothing, last_player=last_player)


def lower_by_rules(rally: Rally, events: list[RallyEvent]) -> list[RallyEvent]:
    """Lower the probability of events that cannot follow each other; the object may do anything while it is lost.

    What agrees with the rules gains nothing: they are part of the evidence of the explanations.

    Args:
        rally: Its flights; gaps between them are spans in which the object was lost.
        events: Events, in the order of time.
    """
    sport = rally.scene.sport
    # the hit that begins a flight after a gap lies in the gap
    gaps = [before.end for before, after in pairwise(rally.flights) if after.start > before.end + _SAME_TIME]
    spans = np.searchsorted(gaps, [event.t - _SAME_TIME for event in events])
    for span in set(spans.tolist()):
        rows = np.flatnonzero(spans == span)
        part = [events[k] for k in rows]
        x, sigma = np.array([[event.place[0], np.sqrt(event.covariance[0, 0])] for event in part]).T
        is_off = np.array([event.kind == "bounce" and sport.is_beside_table(event.place[2]) for event in part])
        chances = judge_order(
            tuple(event.kind for event in part),
            locate_event(x, sigma, is_off, sport),
            (1 - SLIP) * np.array([event.probability for event in part]),
            sport,
        )
        for k, chance in zip(rows, chances, strict=True):
            events[k] = replace(events[k], probability=min(events[k].probability, float(chance)))
    return events
