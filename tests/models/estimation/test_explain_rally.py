"""Rallies with known truth: what happened is found, in space, with errors that hold."""

from dataclasses import replace

import numpy as np
import pytest

from models.core.corrections import Corrections, RallyCorrection
from models.core.progress import ignore_progress
from models.estimation.rally.explain_rally import explain_rally
from models.estimation.rally.flight_observations import prepare_observations
from models.estimation.rally.flight_segmentation import find_kinks
from models.estimation.rally.image_association import associate_candidates
from models.estimation.rally.rally_views import continue_flight, evaluate_rally
from models.sports.sport_catalogue import find_sports
from tests.support.simple_rallies import frames_of, observe_rally, play_rally, usual_view


def play(name, seed, hits=3, clutter=2.0, hide_from=None):
    """Play and explain a rally; observations from `hide_from`, s before the first touch of the ground, are hidden."""
    sport = find_sports()[name]
    rng = np.random.default_rng(seed)
    scene, rally = usual_view(sport), play_rally(sport, hits, rng)
    if hide_from is not None:
        rally.xyz[rally.frame_t > last_touch(rally)[0] - hide_from] = np.nan
    candidates = observe_rally(scene, rally, rng, clutter=clutter)
    explained = explain_rally(scene, candidates, frames_of(rally), rally.frame_t, ignore_progress)
    return scene, rally, candidates, explained


def last_touch(rally):
    """Return time and place of the first contact with the ground after the last hit."""
    row = max(k for k, kind in enumerate(rally.kinds) if kind == "hit") + 1
    return rally.t[row], rally.place[row]


@pytest.mark.parametrize("name", ["badminton", "tennis", "table-tennis"])
def test_the_object_is_followed_through_clutter(name):
    sport = find_sports()[name]
    rng = np.random.default_rng(3)
    scene, rally = usual_view(sport), play_rally(sport, 3, rng)
    candidates = observe_rally(scene, rally, rng, clutter=6.0)
    chosen = associate_candidates(scene, candidates, frames_of(rally), rally.frame_t)
    px, used = scene.camera.to_pixels(rally.xyz), chosen >= 0
    off = np.linalg.norm(candidates.centre[chosen[used]] - px[used], axis=1)
    assert (off < 4).sum() > 0.85 * ((px > 0) & (px < [1280, 720])).all(axis=1).sum() * 0.92
    assert not (off < 4).sum() < 0.97 * used.sum()


@pytest.mark.parametrize(("name", "seed"), [("badminton", 102), ("tennis", 105), ("table-tennis", 103)])
def test_hits_bounces_and_the_landing_of_a_rally_are_recovered(name, seed):
    _, rally, _, explained = play(name, seed)
    until, place = last_touch(rally)
    events = [(kind, t) for kind, t in zip(rally.kinds, rally.t, strict=True) if t <= until + 1e-6]
    missing = [
        (kind, t)
        for kind, t in events
        if not any(event.kind == kind and abs(event.t - t) <= 1 / 25 for event in explained.events)
    ]
    assert len(missing) <= 1, missing
    landing = explained.landings[0]
    off = (landing.place - place)[:2]
    assert off @ np.linalg.solve(landing.covariance[:2, :2], off) < 16
    assert np.linalg.norm(off) < 0.15
    assert explained.no_landing + sum(one.weight for one in explained.landings) == pytest.approx(1.0, abs=1e-9)
    flown = evaluate_rally(explained, rally.frame_t)
    errors = np.linalg.norm(flown.xyz - rally.xyz, axis=1)
    assert np.nanmedian(errors) < 0.3


def test_a_hidden_landing_is_continued_with_a_larger_error():
    *_, shown = play("badminton", 102)
    _, rally, _, hidden = play("badminton", 102, hide_from=0.2)
    _, place = last_touch(rally)
    landing = hidden.landings[0]
    assert not landing.is_seen
    assert landing.weight < shown.landings[0].weight
    assert np.trace(landing.covariance) > np.trace(shown.landings[0].covariance)
    off = (landing.place - place)[:2]
    assert off @ np.linalg.solve(landing.covariance[:2, :2], off) < 16


def test_nothing_flies_through_the_floor():
    scene, rally, _, explained = play("tennis", 105)
    xyz = evaluate_rally(explained, rally.frame_t).xyz
    assert np.nanmin(xyz[:, 2]) > scene.sport.object.radius - 0.05
    for index in range(len(explained.flights)):
        path = continue_flight(explained, index, 5.0)
        assert path.xyz[:, 2].min() > scene.sport.object.radius - 0.05


def test_clutter_alone_is_no_rally():
    scene, rally, candidates, _ = play("badminton", 102)
    off = np.random.default_rng(1).permutation(len(candidates))
    shuffled = type(candidates)(
        candidates.frame, candidates.centre[off], candidates.streak, candidates.score * 0 + 0.3, candidates.sigma,
        candidates.sigma_along,
    )  # fmt: skip
    explained = explain_rally(scene, shuffled, frames_of(rally), rally.frame_t, ignore_progress)
    assert len(explained.events) <= 1


def test_a_short_flight_towards_the_camera_has_a_wide_error_in_depth():
    from models.estimation.rally.single_flight import build_flight_prior, fit_single_flight
    from models.physics.flight.flight_motion import fly

    sport = find_sports()["tennis"]
    scene = usual_view(sport)
    t = np.arange(4) / 25
    xyz = fly(np.array([15.0, 5, 1.5, 10, 0, 2, 0.02, 0, 0, 0, 0]), t, 0.0).states[:, :3]
    px = scene.camera.to_pixels(xyz)
    observed = prepare_observations(scene.camera, np.arange(4), t, px, 0 * px, np.full_like(px, 0.7))
    flight = fit_single_flight(observed, sport, build_flight_prior(sport))
    assert flight is not None
    assert np.sqrt(flight.covariance[0, 0]) > 1.0


def test_a_long_gap_may_hide_an_event():
    """Two places on each side of it lie on one curve, whatever happened between."""
    scene = usual_view(find_sports()["tennis"])
    t = np.array([0.0, 0.04, 0.34, 0.38])
    for times, count in ((t, 2), (np.arange(4) / 25, 1)):
        px = np.stack([600 + 900 * times, 300 + 100 * times], axis=1)
        zero = np.zeros((4, 2))
        observed = prepare_observations(scene.camera, np.arange(4), times, px, zero, np.full((4, 2), 0.7))
        assert len(find_kinks(observed, px, scene.sport)) - 1 == count


def test_a_bounce_after_almost_nothing_is_not_stated():
    """Where a clip begins so, a hand may have thrown the ball up."""
    sport = find_sports()["tennis"]
    rng = np.random.default_rng(105)
    scene, rally = usual_view(sport), play_rally(sport, 2, rng)
    bounce = rally.t[rally.kinds.index("bounce")]
    candidates = observe_rally(scene, rally, rng, missing=0.0, clutter=0.0)
    rows = np.flatnonzero(rally.frame_t > bounce - 0.1)
    explained = explain_rally(scene, candidates, frames_of(rally)[rows], rally.frame_t[rows], ignore_progress)
    assert explained.events
    assert all(event.t > bounce + 0.1 for event in explained.events)
    marked = Corrections(events=(RallyCorrection("mark", "bounce", 25 * bounce),))
    seen = explain_rally(scene, candidates, frames_of(rally)[rows], rally.frame_t[rows], ignore_progress, marked)
    assert seen.events[0].kind == "bounce", "a person saw it"
    assert seen.events[0].t == pytest.approx(bounce, abs=0.04)


def test_a_candidate_far_outside_takes_no_memory():
    """A camera that turns puts its places far apart in the image that stands still."""
    sport = find_sports()["badminton"]
    rng = np.random.default_rng(3)
    scene, rally = usual_view(sport), play_rally(sport, 2, rng)
    candidates = observe_rally(scene, rally, rng, clutter=1.0)
    chosen = associate_candidates(scene, candidates, frames_of(rally), rally.frame_t)
    centre = candidates.centre.copy()
    unused = np.setdiff1d(np.arange(len(candidates)), chosen)
    centre[unused[0]] += 1e9
    moved = replace(candidates, centre=centre)
    assert (associate_candidates(scene, moved, frames_of(rally), rally.frame_t) == chosen).all()


def test_a_flight_of_what_hardly_looks_like_the_object_is_doubted_and_the_hit_after_it_is_not():
    """A limb that looks a little like a shuttle does so in every frame."""
    sport = find_sports()["badminton"]
    rng = np.random.default_rng(102)
    scene, rally = usual_view(sport), play_rally(sport, 3, rng)
    candidates = observe_rally(scene, rally, rng, clutter=0.0)
    hits = [t for kind, t in zip(rally.kinds, rally.t, strict=True) if kind == "hit"]
    time = rally.frame_t[np.searchsorted(frames_of(rally), candidates.frame)]
    doubtful = (time > hits[1]) & (time < hits[2])
    faint = replace(candidates, score=np.where(doubtful, 0.2, candidates.score))
    explained = explain_rally(scene, faint, frames_of(rally), rally.frame_t, ignore_progress)
    chances = [
        max((event.probability for event in explained.events if abs(event.t - hit) < 0.05), default=0.0) for hit in hits
    ]
    assert chances[1] < 0.7
    assert chances[2] > 0.85
