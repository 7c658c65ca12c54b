"""Billiards as the diagnosis asks for it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import SIGMA, TABLE, numbers, opening

from diagnosis.fitting.diagnosis_windows import fit_adaptively, stretches
from diagnosis.fitting.hypothesis_fits import allowed, fit, question_of
from diagnosis.selection.hypothesis_trials import effects_of
from models.estimation.gap_scenes.billiards_scene import billiards_scene
from models.estimation.gap_scenes.gap_scene import Recording, neutral_values
from models.estimation.multiple_shooting.shooting_windows import narrowed
from models.estimation.whole_shot.initial_states import beginning, strikes
from models.physics.billiards.simulation.parametrised_shot import NUMBERS, Laws, packed, played

WAIT = 20
"""pictures before the strike"""


def recorded(seed: int, values: np.ndarray, seconds: float = 1.0, laws: Laws | None = None) -> Recording:
    """A shot of the engine that is filmed from before the strike."""
    rng = np.random.default_rng(seed)
    start, moving = opening(rng)
    t = np.arange(WAIT + round(60 * seconds)) / 60
    run = played(packed(start, moving), moving, TABLE, values, laws or Laws(), seconds)
    since = t - t[WAIT] + 0.007
    xy = np.where((since > 0)[:, None, None], run.at(np.maximum(since, 0.0))[..., :2], start[:, :2])
    xy += SIGMA * rng.normal(size=xy.shape)
    return Recording(3, np.arange(len(t)), t, ("a", "b", "c"), xy, np.full(xy.shape[:2], SIGMA))


def test_a_stretch_begins_with_the_first_picture_after_the_strike() -> None:
    for seed in range(8):
        shot = recorded(seed, numbers())
        pieces = billiards_scene(TABLE, (shot,)).stretches(shot)
        assert [int(piece.frame[0]) - WAIT in (0, 1) for piece in pieces] == [True]
        assert pieces[0].frame[-1] == shot.frame[-1]


def test_a_ball_that_lies_is_no_stretch_and_has_no_velocity() -> None:
    rng = np.random.default_rng(1)
    xy, sigma = 0.5 + SIGMA * rng.normal(size=(60, 2, 2)), np.full((60, 2), SIGMA)
    assert strikes(xy, sigma) == []
    start, moving = beginning(np.arange(60) / 60, xy, sigma)
    assert not moving.any()
    np.testing.assert_allclose(start[:, :2], 0.5, atol=5 * SIGMA)
    assert np.all(start[:, 2:] == 0)


def test_a_first_velocity_stops_where_the_ball_is_struck() -> None:
    t = np.arange(20) / 60
    x = np.where(t < 0.1, 2.0 * t, 0.2 - 1.0 * (t - 0.1))
    xy = np.stack([x, np.full(20, 0.3)], axis=1)[:, None]
    start, moving = beginning(t, xy, np.full((20, 1), SIGMA))
    assert moving[0]
    np.testing.assert_allclose(start[0, :4], [0, 0.3, 2.0, 0.0], atol=0.05)


def test_a_ball_that_was_never_seen_is_out_of_the_way() -> None:
    shot = recorded(2, numbers())
    places = shot.places.copy()
    places[:, 2] = np.nan
    hidden = Recording(3, shot.frame, shot.t, shot.bodies, places, shot.sigma)
    scene = billiards_scene(TABLE, (hidden,))
    model = scene.model(scene.stretches(hidden), ("mirror", "inelastic"))
    flow = model.flow(0, model.windows[0].start, neutral_values(scene))
    assert np.all(np.isfinite(flow.misfit))
    assert np.all(np.isfinite(model.windows[0].sigma[-2:]))


def test_the_model_holds_all_effects_and_its_places_are_its_predictions() -> None:
    shot = recorded(5, numbers())
    scene = billiards_scene(TABLE, (shot,))
    forms = tuple(choice.assumed for choice in scene.alternatives)
    pieces = scene.stretches(shot)
    model = scene.model(pieces, forms)
    shared = neutral_values(scene)
    assert len(model.unknowns) == len(shared)
    assert set(scene.assumed) <= {effect.name for effect in scene.effects}
    start = model.windows[0].start
    rows, balls = np.nonzero(pieces[0].seen)
    places = scene.predict(pieces[0], start, shared, forms)[rows, balls]
    flow = model.flow(0, start, shared)
    np.testing.assert_allclose(flow.misfit, (places - pieces[0].places[rows, balls]) / SIGMA, atol=1e-6)


def test_covariates_say_what_a_ball_did_last() -> None:
    shot = recorded(5, numbers())
    scene = billiards_scene(TABLE, (shot,))
    forms = tuple(choice.assumed for choice in scene.alternatives)
    piece = scene.stretches(shot)[0]
    model = scene.model((piece,), forms)
    told = scene.covariates(piece, model.windows[0].start, neutral_values(scene), forms)
    rows, balls = np.nonzero(piece.seen)
    assert len(told.phase) == len(rows) == len(told.since_contact)
    lying = (balls == 2) & np.isnan(told.since_contact)
    assert {phase for phase, lies in zip(told.phase, lying, strict=True) if lies} <= {"rest"}
    touched = np.isfinite(told.since_contact) & (told.since_contact < 0.2)
    assert touched.any()
    assert {phase for phase, was in zip(told.phase, touched, strict=True) if was} <= {
        "ball_contact", "cushion_contact", "rest",
    }  # fmt: skip


def test_pieces_that_follow_each_other_hand_their_spin_over() -> None:
    shot = recorded(5, numbers())
    scene = billiards_scene(TABLE, (shot,))
    piece = scene.stretches(shot)[0]
    parts = (piece.rows(0, 30), piece.rows(30, len(piece.t)))
    model = scene.model(parts, ("mirror", "inelastic"))
    assert model.windows[0].link is None
    assert model.windows[1].link is not None
    flow = model.flow(0, model.windows[0].start, neutral_values(scene))
    assert flow.end.shape == model.windows[1].start.shape


def test_a_missing_picture_is_where_the_effect_acts() -> None:
    shot = recorded(5, numbers())
    kept = np.r_[0:36, 38 : len(shot.t)]
    cut = Recording(3, shot.frame[: len(kept)], shot.t[: len(kept)], shot.bodies, shot.places[kept], shot.sigma[kept])
    scene = billiards_scene(TABLE, (cut,))
    assert [(number, round(60 * t)) for number, t, _ in scene.jumps] == [(3, 36)]


def test_windows_grow_to_whole_shots_where_all_is_explained() -> None:
    absent = {"cushion_friction__mu": 0.0, "ball_friction__mu": 0.0}
    recordings = tuple(replace(recorded(seed, numbers(**absent), 1.5), shot=seed) for seed in (5, 4))
    scene = billiards_scene(TABLE, recordings)
    found = fit_adaptively(question_of(scene, 0.0), recordings)
    assert [piece.shot for piece in found.pieces] == [5, 4]
    assert 0.8 < found.cost / found.observations < 1.2
    told = dict(zip((prior.name for prior in question_of(scene, 0.0).priors), found.shared, strict=True))
    assert abs(told["cushion_restitution.e"] - numbers()[NUMBERS.index("cushion_restitution.e")]) < 0.01


def test_windows_stay_short_where_a_law_is_wrong() -> None:
    recordings = tuple(replace(recorded(seed, numbers(), 1.5), shot=seed) for seed in (5, 4))
    lossless = ("rolling_resistance", "sliding_friction", "spin_decay", "ball_restitution")
    scene = billiards_scene(TABLE, recordings, assumed=lossless)
    found = fit_adaptively(question_of(scene, 0.0), recordings)
    assert len(found.pieces) > 2
    assert sum(len(piece.t) for piece in found.pieces) == sum(
        len(one.t) for one in stretches(question_of(scene, 0.0), recordings)
    )


def test_a_published_cushion_brings_the_friction_that_makes_it_one() -> None:
    truth = numbers(ball_friction__mu=0.0)
    recordings = tuple(replace(recorded(seed, truth, 1.0, Laws("han_2005")), shot=seed) for seed in (5, 4))
    question = question_of(billiards_scene(TABLE, recordings), 0.0)
    pieces = stretches(question, recordings)
    with_friction = effects_of(question, frozenset({"cushion_law"}))
    assert with_friction == ("cushion_friction", "cushion_cloth")
    assert effects_of(question, frozenset({"slope"})) == ("slope",)
    bare, whole = (fit(question, pieces, names, ("han_2005", "inelastic")) for names in ((), with_friction))
    assert whole.cost < 1.3 * whole.observations
    assert bare.cost > whole.cost + 100


def test_states_are_sought_without_the_slopes_that_they_do_not_need() -> None:
    shot = recorded(5, numbers())
    scene = billiards_scene(TABLE, (shot,))
    model = scene.model(scene.stretches(shot), ("mirror", "inelastic"))
    start = model.windows[0].start
    shared = np.array([numbers()[NUMBERS.index(prior.name)] for prior in model.unknowns])
    whole, narrow = model.flow(0, start, shared), narrowed(model).flow(0, start, shared)
    np.testing.assert_allclose(narrow.misfit, whole.misfit, atol=1e-9)
    np.testing.assert_allclose(narrow.by_start, whole.by_start, rtol=1e-12, atol=1e-9)
    assert whole.by_shared.any()
    assert not narrow.by_shared.any()


def test_a_nap_that_would_drive_balls_is_forbidden_by_nature() -> None:
    """It may brake less one way than the other, never push."""
    shot = recorded(5, numbers())
    question = question_of(billiards_scene(TABLE, (shot,)), 0.0)
    found = fit(question, stretches(question, (shot,)))
    names = [prior.name for prior in question.priors]
    resistance, nap = names.index("rolling_resistance.mu"), names.index("nap.mu")
    gentle, driving = found.shared.copy(), found.shared.copy()
    gentle[nap], driving[nap] = 0.5 * found.shared[resistance], 2.0 * found.shared[resistance]
    assert allowed(question, found, found.forms, gentle)
    assert not allowed(question, found, found.forms, driving)


def test_what_a_law_leaves_open_is_no_cause() -> None:
    question = question_of(billiards_scene(TABLE, (recorded(5, numbers(), 1.0),)), 0.0)
    assert "cushion_cloth" not in question.candidates
    assert question.mask(("cushion_cloth",)).sum() == 1
