"""Billiards behind the interface of the diagnosis."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import SIGMA, TABLE, numbers, opening

from diagnosis.fitting.diagnosis_windows import fit_adaptively, split_into_segments
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, can_simulate, fit_effects
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from diagnosis.selection.hypothesis_trials import find_added_effects
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene
from models.estimation.gap_scenes.gap_scene import neutral_values
from models.estimation.multiple_shooting.shooting_windows import drop_shared_jacobian
from models.estimation.whole_shot.shot_segments import estimate_initial_states, find_shot_rows
from models.physics.billiards.simulation.parametrised_shot import (
    SHOT_PARAMETERS,
    ContactModels,
    pack_start,
    simulate_start,
)

WAIT = 20
"""frames before the strike"""


def simulate_recording(
    seed: int, values: np.ndarray, seconds: float = 1.0, laws: ContactModels | None = None
) -> Recording:
    """Simulate a shot that is filmed from before the strike."""
    rng = np.random.default_rng(seed)
    start, moving = opening(rng)
    t = np.arange(WAIT + round(60 * seconds)) / 60
    run = simulate_start(pack_start(start, moving), moving, TABLE, values, laws or ContactModels(), seconds)
    since = t - t[WAIT] + 0.007
    xy = np.where((since > 0)[:, None, None], run.states_at(np.maximum(since, 0.0))[..., :2], start[:, :2])
    xy += SIGMA * rng.normal(size=xy.shape)
    return Recording(3, np.arange(len(t)), t, ("a", "b", "c"), xy, np.full(xy.shape[:2], SIGMA), TABLE_PLANE)


def test_a_segment_begins_with_the_first_frame_after_the_strike() -> None:
    for seed in range(8):
        shot = simulate_recording(seed, numbers())
        pieces = build_billiards_scene(TABLE, (shot,)).split_recording(shot)
        assert [int(piece.frame[0]) - WAIT in (0, 1) for piece in pieces] == [True]
        assert pieces[0].frame[-1] == shot.frame[-1]


def test_a_resting_ball_is_no_segment_and_has_no_velocity() -> None:
    rng = np.random.default_rng(1)
    xy, sigma = 0.5 + SIGMA * rng.normal(size=(60, 2, 2)), np.full((60, 2), SIGMA)
    assert find_shot_rows(xy, sigma) == []
    start, moving = estimate_initial_states(np.arange(60) / 60, xy, sigma)
    assert not moving.any()
    np.testing.assert_allclose(start[:, :2], 0.5, atol=5 * SIGMA)
    assert np.all(start[:, 2:] == 0)


def test_an_initial_velocity_uses_no_frames_after_a_contact() -> None:
    t = np.arange(20) / 60
    x = np.where(t < 0.1, 2.0 * t, 0.2 - 1.0 * (t - 0.1))
    xy = np.stack([x, np.full(20, 0.3)], axis=1)[:, None]
    start, moving = estimate_initial_states(t, xy, np.full((20, 1), SIGMA))
    assert moving[0]
    np.testing.assert_allclose(start[0, :4], [0, 0.3, 2.0, 0.0], atol=0.05)


def test_a_ball_that_was_never_observed_touches_nothing() -> None:
    shot = simulate_recording(2, numbers())
    places = shot.positions.copy()
    places[:, 2] = np.nan
    hidden = Recording(3, shot.frame, shot.t, shot.bodies, places, shot.sigma, TABLE_PLANE)
    scene = build_billiards_scene(TABLE, (hidden,))
    model = scene.build_model(scene.split_recording(hidden), ("mirror", "inelastic"))
    flow = model.linearize(0, model.windows[0].start, neutral_values(scene))
    assert np.all(np.isfinite(flow.residual))
    assert np.all(np.isfinite(model.windows[0].sigma[-2:]))


def test_the_model_has_all_effects_and_its_positions_are_its_predictions() -> None:
    shot = simulate_recording(5, numbers())
    scene = build_billiards_scene(TABLE, (shot,))
    forms = tuple(choice.simulator_form for choice in scene.alternatives)
    pieces = scene.split_recording(shot)
    model = scene.build_model(pieces, forms)
    shared = neutral_values(scene)
    assert len(model.unknowns) == len(shared)
    assert set(scene.simulator_effects) <= {effect.name for effect in scene.effects}
    start = model.windows[0].start
    rows, balls = np.nonzero(pieces[0].is_observed)
    places = scene.predict_positions(pieces[0], start, shared, forms)[rows, balls]
    flow = model.linearize(0, start, shared)
    np.testing.assert_allclose(flow.residual, (places - pieces[0].positions[rows, balls]) / SIGMA, atol=1e-6)


def test_covariates_contain_the_last_contact_of_a_ball() -> None:
    shot = simulate_recording(5, numbers())
    scene = build_billiards_scene(TABLE, (shot,))
    forms = tuple(choice.simulator_form for choice in scene.alternatives)
    piece = scene.split_recording(shot)[0]
    model = scene.build_model((piece,), forms)
    fitted = scene.observation_covariates(piece, model.windows[0].start, neutral_values(scene), forms)
    rows, balls = np.nonzero(piece.is_observed)
    assert len(fitted.phase) == len(rows) == len(fitted.since_contact)
    lying = (balls == 2) & np.isnan(fitted.since_contact)
    assert {phase for phase, lies in zip(fitted.phase, lying, strict=True) if lies} <= {"rest"}
    touched = np.isfinite(fitted.since_contact) & (fitted.since_contact < 0.2)
    assert touched.any()
    assert {phase for phase, was in zip(fitted.phase, touched, strict=True) if was} <= {
        "ball_contact", "cushion_contact", "rest",
    }  # fmt: skip


def test_spin_continues_between_consecutive_segments() -> None:
    shot = simulate_recording(5, numbers())
    scene = build_billiards_scene(TABLE, (shot,))
    piece = scene.split_recording(shot)[0]
    parts = (piece.select_rows(0, 30), piece.select_rows(30, len(piece.t)))
    model = scene.build_model(parts, ("mirror", "inelastic"))
    assert model.windows[0].link_sigma is None
    assert model.windows[1].link_sigma is not None
    flow = model.linearize(0, model.windows[0].start, neutral_values(scene))
    assert flow.end.shape == model.windows[1].start.shape


def test_a_missing_frame_is_where_the_effect_acts() -> None:
    shot = simulate_recording(5, numbers())
    selected = np.r_[0:36, 38 : len(shot.t)]
    cut = Recording(
        3,
        shot.frame[: len(selected)],
        shot.t[: len(selected)],
        shot.bodies,
        shot.positions[selected],
        shot.sigma[selected],
        TABLE_PLANE,
    )
    scene = build_billiards_scene(TABLE, (cut,))
    assert [(number, round(60 * t)) for number, t, _ in scene.jumps] == [(3, 36)]


def test_windows_grow_to_whole_shots_where_all_is_explained() -> None:
    absent = {"cushion_friction__mu": 0.0, "ball_friction__mu": 0.0}
    recordings = tuple(replace(simulate_recording(seed, numbers(**absent), 1.5), shot=seed) for seed in (5, 4))
    scene = build_billiards_scene(TABLE, recordings)
    result = fit_adaptively(build_diagnosis_problem(scene, WHITE_NOISE), recordings)
    assert [piece.shot for piece in result.segments] == [5, 4]
    assert 0.8 < result.cost / result.value_count < 1.2
    fitted = dict(
        zip((prior.name for prior in build_diagnosis_problem(scene, WHITE_NOISE).priors), result.shared, strict=True)
    )
    assert abs(fitted["cushion_restitution.e"] - numbers()[SHOT_PARAMETERS.index("cushion_restitution.e")]) < 0.01


def test_windows_stay_short_where_a_contact_model_is_wrong() -> None:
    recordings = tuple(replace(simulate_recording(seed, numbers(), 1.5), shot=seed) for seed in (5, 4))
    lossless = ("rolling_resistance", "sliding_friction", "spin_decay", "ball_restitution")
    scene = build_billiards_scene(TABLE, recordings, simulator_effects=lossless)
    result = fit_adaptively(build_diagnosis_problem(scene, WHITE_NOISE), recordings)
    assert len(result.segments) > 2
    assert sum(len(piece.t) for piece in result.segments) == sum(
        len(one.t) for one in split_into_segments(build_diagnosis_problem(scene, WHITE_NOISE), recordings)
    )


def test_a_published_cushion_includes_the_friction_that_it_needs() -> None:
    truth = numbers(ball_friction__mu=0.0)
    recordings = tuple(
        replace(simulate_recording(seed, truth, 1.0, ContactModels("han_2005")), shot=seed) for seed in (5, 4)
    )
    question = build_diagnosis_problem(build_billiards_scene(TABLE, recordings), WHITE_NOISE)
    pieces = split_into_segments(question, recordings)
    with_friction = find_added_effects(question, frozenset({"cushion_law"}))
    assert with_friction == ("cushion_friction", "cushion_cloth")
    assert find_added_effects(question, frozenset({"slope"})) == ("slope",)
    bare, whole = (fit_effects(question, pieces, names, ("han_2005", "inelastic")) for names in ((), with_friction))
    assert whole.cost < 1.3 * whole.value_count
    assert bare.cost > whole.cost + 100


def test_states_are_fitted_without_jacobians_that_they_do_not_need() -> None:
    shot = simulate_recording(5, numbers())
    scene = build_billiards_scene(TABLE, (shot,))
    model = scene.build_model(scene.split_recording(shot), ("mirror", "inelastic"))
    start = model.windows[0].start
    shared = np.array([numbers()[SHOT_PARAMETERS.index(prior.name)] for prior in model.unknowns])
    whole, narrow = model.linearize(0, start, shared), drop_shared_jacobian(model).linearize(0, start, shared)
    np.testing.assert_allclose(narrow.residual, whole.residual, atol=1e-9)
    np.testing.assert_allclose(narrow.start_jacobian, whole.start_jacobian, rtol=1e-12, atol=1e-9)
    assert whole.shared_jacobian.any()
    assert not narrow.shared_jacobian.any()


def test_a_nap_that_would_accelerate_balls_is_impossible() -> None:
    """It may brake less in one direction than in the other, never accelerate."""
    shot = simulate_recording(5, numbers())
    question = build_diagnosis_problem(build_billiards_scene(TABLE, (shot,)), WHITE_NOISE)
    result = fit_effects(question, split_into_segments(question, (shot,)))
    names = [prior.name for prior in question.priors]
    resistance, nap = names.index("rolling_resistance.mu"), names.index("nap.mu")
    gentle, driving = result.shared.copy(), result.shared.copy()
    gentle[nap], driving[nap] = 0.5 * result.shared[resistance], 2.0 * result.shared[resistance]
    assert can_simulate(question, result, result.forms, gentle)
    assert not can_simulate(question, result, result.forms, driving)


def test_an_absent_height_of_the_cushion_is_that_of_each_contact_model() -> None:
    recordings = (simulate_recording(5, numbers(), 1.0),)
    mirror, han = (
        build_diagnosis_problem(build_billiards_scene(TABLE, recordings, laws=ContactModels(law)), WHITE_NOISE)
        for law in ("mirror", "han_2005")
    )
    height = [prior.name for prior in mirror.priors].index("cushion_height.ratio")
    assert mirror.priors[height].value == 1.0
    assert han.priors[height].value == 1.27
    assert mirror.neutral(("han_2005", "inelastic"))[height] == 1.27
    other = fit_effects(mirror, split_into_segments(mirror, recordings), (), ("han_2005", "inelastic"))
    assert other.shared[height] == 1.27


def test_the_height_of_a_cushion_shows_where_the_nose_rubs_or_leans() -> None:
    """Its derivative at an absent height: that of a published law, and none for a mirror without friction."""
    slopes = {}
    for law, mu in (("han_2005", 0.2), ("han_2005", 0.0), ("mirror", 0.2), ("mirror", 0.0)):
        values = numbers(cushion_friction__mu=mu)
        shot = simulate_recording(0, values, 1.0, ContactModels(law))
        scene = build_billiards_scene(TABLE, (shot,), laws=ContactModels(law))
        model = scene.build_model(scene.split_recording(shot), (law, "inelastic"))
        shared = np.array([values[SHOT_PARAMETERS.index(prior.name)] for prior in model.unknowns])
        height = [prior.name for prior in model.unknowns].index("cushion_height.ratio")
        slopes[law, mu] = model.linearize(0, model.windows[0].start, shared).shared_jacobian[..., height]
    assert slopes["han_2005", 0.2].any()
    assert slopes["han_2005", 0.0].any()
    assert slopes["mirror", 0.2].any()
    assert not slopes["mirror", 0.0].any()


def test_a_parameter_that_a_contact_model_leaves_open_is_no_cause() -> None:
    scene = build_billiards_scene(TABLE, (simulate_recording(5, numbers(), 1.0),))
    question = build_diagnosis_problem(scene, WHITE_NOISE)
    assert "cushion_cloth" not in question.candidates
    assert question.mask(("cushion_cloth",)).sum() == 1
