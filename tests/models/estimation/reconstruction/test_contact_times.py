"""A contact has one time: that of its event is where the paths of its balls bend."""

from __future__ import annotations

import numpy as np
import pytest
from support import staged_shot
from support.contact_graphs import moving, resting, start_search
from support.filmed_shots import RADIUS, film, random_shot
from support.frame_rates import convert_rate

from benchmarks.fitting.path_bends import measure_bends
from models.core.contact_graph import Contact, JointSolution, Observations, layout_parameters
from models.core.corrections import HAND_TIME_FRAMES, BallPlace, ContactCorrection
from models.core.fit_result import MarkOutcome
from models.core.shot import ContactTestResult
from models.estimation.hand_marks.graph_marks import combine_marked_times
from models.estimation.hand_marks.resolved_marks import ResolvedMark
from models.estimation.joint_fit.fit_solution import end_state
from models.estimation.joint_fit.joint_refinement import add_covariance, condition_on_contact_times
from models.estimation.reconstruction import contact_times
from models.estimation.reconstruction.explain_shot import explain
from models.estimation.reconstruction.shot_views import view_shot

SCENE = staged_shot.scene()


@pytest.mark.parametrize("drops_frames", [False, True])
@pytest.mark.parametrize("seed", [3, 5])
def test_pieces_of_the_trajectory_begin_and_end_at_contacts(seed: int, drops_frames: bool) -> None:
    shot = random_shot(seed, missing=0.0)
    fit = view_shot(explain(convert_rate(shot.tracks) if drops_frames else shot.tracks, shot.scene))
    events, motion = fit.events, fit.trajectory
    assert (motion.clock is not None) == drops_frames
    physical = np.array([phase != "measured" for phase in motion.phase])
    checked = 0
    for kind, t, *names in zip(events.kind, events.t, events.a, events.b, strict=True):
        for name in {*names} & {*motion.ids} if kind in ("ball", "cushion") else ():
            rows = (motion.ball == motion.ids.index(name)) & physical
            assert np.abs(motion.start[rows] - t).min() < 1e-6
            assert np.abs(motion.end[rows] - t).min() < 1e-6
            checked += 1
    assert checked >= 3


@pytest.mark.parametrize("seed", [1, 3, 5])
def test_the_bend_of_a_sampled_path_is_at_the_time_of_its_contact(seed: int) -> None:
    shot = random_shot(seed, missing=0.0)
    fit = view_shot(explain(shot.tracks, shot.scene))
    t = np.arange(5000) / 1000
    bends = measure_bends(fit.events, t, np.round(fit.trajectory.at(t).xy, 6), fit.trajectory.ids)
    assert np.sum(np.isfinite(bends)) >= 3
    assert np.nanmax(np.abs(bends)) < 1e-4


def test_the_gap_of_a_timed_contact_is_that_of_the_exact_physics_that_timed_it() -> None:
    shot = film(
        np.array([[0.5, 0.6], [1.1, 0.61]]), np.array([[1.5, 0.0], [0, 0]]), np.zeros((2, 3)),
        np.random.default_rng(2), seconds=1.4, missing=0.0,
    )  # fmt: skip
    explained = explain(shot.tracks, shot.scene)
    events = view_shot(explained).events
    (contact,) = (k for k in range(len(events)) if events.kind[k] == "ball")
    (timed,) = explained.gaps[np.isfinite(explained.gaps[:, 0])]
    assert (events.gap[contact], events.gap_sigma[contact]) == tuple(timed)
    true = 0.01 - 2 * RADIUS  # the free path passes the resting ball at 10 mm
    assert abs(events.gap[contact] - true) < 4 * events.gap_sigma[contact] < 4e-3


def collision() -> tuple[JointSolution, Observations]:
    """A struck ball hits another one; with its covariance."""
    shot = film(
        np.array([[0.5, 0.6], [1.1, 0.61]]), np.array([[1.5, 0.0], [0, 0]]), np.zeros((2, 3)),
        np.random.default_rng(0), seconds=1.6,
    )  # fmt: skip
    (hit,) = [t for t, kind, *_ in shot.contacts if kind == "ball"]
    place = 1.1 - 2 * RADIUS, 0.6
    segments = [
        resting(0, (0.5, 0.6), 0), resting(1, (1.1, 0.61), 1), moving(0, 0, 1, shot.strike, (0.5, 0.6), (1.5, 0.0)),
        moving(0, 1, None, hit, place, (0.1, 0.0)), moving(1, 1, None, hit, (1.1, 0.61), (1.0, 0.0)),
    ]  # fmt: skip
    contacts = [Contact("strike", shot.strike, (0,), (2,)), Contact("ball", hit, (2, 1), (3, 4))]
    solution, search = start_search(shot, segments, contacts)
    observations = search.observations
    return add_covariance(solution, observations, shot.scene.table), observations


def test_conditioning_replaces_the_distribution_of_a_time_and_keeps_paths_continuous() -> None:
    solution, observations = collision()
    column = layout_parameters(solution.graph).contact + 1
    wanted, sigma = solution.graph.contacts[1].t + 5e-4, 1e-4
    after = condition_on_contact_times(solution, {1: (wanted, sigma)}, observations, SCENE.table)
    free = add_covariance(after, observations, SCENE.table).covariance
    assert after.graph.contacts[1].t == wanted
    assert after.covariance[column, column] == pytest.approx(sigma**2, rel=1e-6)
    gain = np.delete(free[:, column], column) / free[column, column]
    assert np.delete(after.covariance[:, column], column) == pytest.approx(gain * sigma**2, rel=1e-6, abs=1e-16)
    assert np.linalg.eigvalsh(after.covariance).min() > -1e-12
    assert measure_jump(after) < 5e-6
    assert measure_jump(after) < 0.1 * measure_jump(solution)


def measure_jump(solution: JointSolution) -> float:
    """The largest jump of a path at the contact, m."""
    graph = solution.graph
    contact = graph.contacts[1]
    pairs = zip(contact.before, contact.after, strict=True)
    return max(float(np.hypot(*(end_state(solution, a) - graph.segments[b].state[:6])[:2])) for a, b in pairs)


def test_times_between_which_a_segment_would_not_last_stay() -> None:
    solution, observations = collision()
    strike, hit = (contact.t for contact in solution.graph.contacts)
    after = condition_on_contact_times(
        solution, {0: (hit + 0.1, 1e-3), 1: (hit + 1e-3, 1e-3)}, observations, SCENE.table
    )
    assert [contact.t for contact in after.graph.contacts] == pytest.approx([strike, hit], abs=5e-3)


def test_a_time_set_by_hand_is_combined_with_the_refined_one_as_an_independent_measurement() -> None:
    solution, observations = collision()
    t, sigma = solution.graph.contacts[1].t, HAND_TIME_FRAMES / 30
    places = BallPlace(0, 0.0, 0.0, "cue"), BallPlace(0, 0.0, 0.0, "solid-1")
    mark = ResolvedMark(ContactCorrection("mark", "ball", 30 * t, *places), 0, 1, t + 4e-3, t + 4e-3, 0.08)
    outcome = MarkOutcome("mark", "confirmed", ("cue", "solid-1"), "", mark.t)
    times, (outcome,) = combine_marked_times(solution, {1: (t, sigma)}, [mark], (outcome,), observations)
    assert times[1] == pytest.approx((t + 2e-3, sigma / np.sqrt(2)), rel=1e-6)
    certain, (contradicted,) = combine_marked_times(solution, {1: (t - 0.06, 1e-4)}, [mark], (outcome,), observations)
    assert certain == {1: (t - 0.06, 1e-4)}, "the motion contradicts the mark"
    assert contradicted.code == "other_time"


@pytest.mark.parametrize(("chi2", "is_refined"), [(1.4, True), (1.85, False)])
def test_exact_physics_times_a_contact_only_where_it_explains_the_samples(
    chi2: float, is_refined: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Samples err by a quarter more than stated where tracks lag; by a third where balls are not ideal."""
    solution, observations = collision()
    t = solution.graph.contacts[1].t + 1e-4
    result = ContactTestResult(0.99, t, 1e-3, -1e-3, 1e-4, chi2, 0.0, 0.5)
    monkeypatch.setattr(contact_times, "estimate_contact_time", lambda *_: result)
    tests = contact_times.refine_contact_times(solution, observations, SCENE)
    assert list(tests) == ([1] if is_refined else [])
    for one in tests.values():
        assert (one.t, one.gap) == (t, -1e-3)
        assert (one.t_sigma, one.gap_sigma) == pytest.approx((1e-3 * np.sqrt(chi2), 1e-4 * np.sqrt(chi2)))
