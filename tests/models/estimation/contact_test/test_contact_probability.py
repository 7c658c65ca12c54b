"""The contact test: its physics, and its results on samples of an independent simulator."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm
from support.filmed_shots import RADIUS, film

from models.estimation.contact_test.contact_motion import (
    SHARED_COUNT,
    CushionLine,
    PossibleContact,
    make_ball_window,
    predict_contact_paths,
    predict_free_paths,
    predict_nearest_approach,
)
from models.estimation.contact_test.contact_probability import evaluate_contact, predict_gap
from models.estimation.segmentation.contact_classification import INWARD_NORMALS
from models.estimation.segmentation.track_segmentation import BallSamples

REACH = 2 * RADIUS
SLIPS = np.array([[0.3, -0.1], [0.0, 0.2]])


def pair(rolls: bool = False) -> tuple[PossibleContact, np.ndarray]:
    """Two moving balls, and parameters under which they meet obliquely at 0.2 s."""
    t = np.arange(0.003, 0.4, 1 / 60)  # none at the moment of contact, where velocities jump
    samples_of_balls = [
        BallSamples(t, np.outer(t, v) + x, np.full(len(t), 1e-3))
        for x, v in (((0, 0), (1, 0)), ((0.3, 0.02), (-0.2, 0)))
    ]
    contact = PossibleContact(tuple(make_ball_window(samples, 0.2, 0.0) for samples in samples_of_balls), REACH, 1e-4)
    p = np.array([0.0, 0.0, 1.0, 0.1, *SLIPS[0], 0.3, 0.05, -0.2, 0.0, *SLIPS[1], 0.01, 0.02, np.log(0.2), np.log(0.01),
                  0.2, 0.94, 0.03, 0.02])  # fmt: skip
    return contact, p


@pytest.mark.parametrize("model", [predict_free_paths, predict_contact_paths])
def test_derivatives_are_those_of_finite_differences(model) -> None:  # type: ignore[no-untyped-def]
    contact, p = pair()
    p = p if model is predict_contact_paths else p[: contact.common_column + SHARED_COUNT]
    exact, step = model(contact, p), 1e-6
    for k in range(len(p)):
        shift = step * np.eye(len(p))[k]
        up, down = model(contact, p + shift), model(contact, p - shift)
        np.testing.assert_allclose((up.xy - down.xy) / (2 * step), exact.jacobian[:, :, k], atol=2e-6)
        if model is predict_contact_paths:
            assert (up.gap - down.gap) / (2 * step) == pytest.approx(exact.gap_gradient[k], abs=1e-6)
            assert (up.closing - down.closing) / (2 * step) == pytest.approx(exact.closing_gradient[k], abs=1e-5)


def test_a_contact_keeps_momentum_and_gives_back_its_share_of_the_closing_speed() -> None:
    contact, p = pair()
    p[-2:] = 0.0  # no friction between the balls
    just = 1e-7
    t = np.array([0.2 - 2 * just, 0.2 - just, 0.2 + just, 0.2 + 2 * just])
    balls = tuple(
        type(ball)(ball.begin, t, np.zeros((4, 2)), np.ones(4), ball.start_state, ball.through_state, ball.rests)
        for ball in contact.balls
    )
    paths = predict_contact_paths(PossibleContact(balls, REACH, 1e-4), p)
    a, b = paths.xy.reshape(2, 4, 2)
    before, after = ((np.array([a[k + 1] - a[k], b[k + 1] - b[k]]) / just) for k in (0, 2))
    np.testing.assert_allclose(before.sum(axis=0), after.sum(axis=0), atol=1e-5)
    n = (b[1] - a[1]) / np.hypot(*(b[1] - a[1]))
    closing, parting = (before[0] - before[1]) @ n, (after[1] - after[0]) @ n
    assert parting == pytest.approx(0.94 * closing, abs=1e-5)
    assert paths.closing == pytest.approx(closing, abs=1e-5)


def test_paths_are_nearest_where_their_distance_is_least() -> None:
    contact, p = pair()
    p = p[: contact.common_column + SHARED_COUNT]
    prediction = predict_nearest_approach(contact, p)
    fine = np.linspace(0, 0.35, 20001)
    balls = tuple(
        type(ball)(
            ball.begin,
            fine,
            np.zeros((len(fine), 2)),
            np.ones(len(fine)),
            ball.start_state,
            ball.through_state,
            ball.rests,
        )
        for ball in contact.balls
    )
    a, b = predict_free_paths(PossibleContact(balls, REACH, 1e-4), p).xy.reshape(2, -1, 2)
    gaps = np.hypot(*(b - a).T) - REACH
    assert prediction.gap == pytest.approx(gaps.min(), abs=1e-6)
    assert prediction.t == pytest.approx(fine[np.argmin(gaps)], abs=2e-4)


def passing(gap: float, seed: int, ar: float = 0.0, speed: float = 1.5) -> tuple[PossibleContact, float, float]:
    """A rolling ball that passes a resting one at `gap` m: the possible contact, the time of nearest approach, the true
    contact.
    """
    x = np.array([[0.8, 0.6], [1.3, 0.6 + REACH + gap]])
    v = np.array([[speed, 0.0], [0.0, 0.0]])
    w = np.array([[0.0, speed / RADIUS, 0.0], [0.0, 0.0, 0.0]])
    shot = film(x, v, w, np.random.default_rng(seed), fps=60, noise_px=0.0, seconds=1.2, missing=0.0, mu_r=0.01)
    rng, sigma = np.random.default_rng([seed, 1]), 1e-3
    error = rng.normal(size=shot.xy.shape)
    for k in range(1, len(error)):
        error[k] = ar * error[k - 1] + np.sqrt(1 - ar**2) * error[k]
    middle = shot.strike + 0.5 / speed
    rows = np.abs(shot.tracks.t - middle) < 0.3
    t = shot.tracks.t[rows]
    samples_of_balls = [BallSamples(t, (shot.xy + sigma * error)[rows, k], np.full(len(t), sigma)) for k in (0, 1)]
    touched = [when for when, kind, *_ in shot.contacts if kind == "ball"]
    question = PossibleContact(
        tuple(make_ball_window(samples, middle, float(t[0])) for samples in samples_of_balls), REACH, 2e-5
    )
    return question, middle, touched[0] if touched else float("nan")


@pytest.mark.parametrize(("gap_mm", "ar"), [(-0.3, 0.0), (-0.3, 0.6), (-10.0, 0.0)])
def test_an_overlap_of_a_third_of_a_millimetre_is_a_touch(gap_mm: float, ar: float) -> None:
    for seed in range(2):
        question, middle, touched = passing(1e-3 * gap_mm, seed, ar)
        verdict = evaluate_contact(question, middle)
        assert verdict.probability > 0.99
        assert abs(verdict.t - touched) < 4 * verdict.t_sigma
        assert abs(verdict.gap - 1e-3 * gap_mm) < 4 * verdict.gap_sigma


@pytest.mark.parametrize("ar", [0.0, 0.6])
def test_a_pass_at_a_tenth_of_a_millimetre_is_no_contact_though_geometry_is_undecided(ar: float) -> None:
    unsure = 0
    for seed in range(4):
        question, middle, _ = passing(1e-4, seed, ar)
        assert evaluate_contact(question, middle).probability < 0.15
        gap, sigma = predict_gap(question, middle)
        unsure += bool(0.02 < norm.cdf(-gap / sigma) < 0.98)
    assert unsure >= 2


def test_a_graze_can_never_be_ruled_out_as_a_clear_miss_can() -> None:
    """An overlap of a micrometre changes velocities by less than can be measured."""
    graze, miss = (evaluate_contact(*passing(gap, 0)[:2]).probability for gap in (0.0, 3e-3))
    assert miss < 1e-6
    assert graze > 10 * miss
    assert graze > 1e-5


def test_a_mirrored_pass_has_the_same_probability() -> None:
    question, middle, _ = passing(-3e-5, 5)
    flip = np.array([1.0, -1.0])
    mirrored = PossibleContact(
        tuple(
            make_ball_window(BallSamples(ball.t, ball.xy * flip, ball.sigma), middle, ball.begin)
            for ball in question.balls
        ),
        question.reach,
        question.reach_sigma,
    )
    one, two = evaluate_contact(question, middle), evaluate_contact(mirrored, middle)
    assert one.probability == pytest.approx(two.probability, abs=0.02)
    assert one.t == pytest.approx(two.t, abs=0.05 * one.t_sigma)


def test_errors_of_contact_times_are_honest() -> None:
    pulls = []
    for seed in range(8):
        question, middle, touched = passing(-0.02, seed, speed=1.2)
        verdict = evaluate_contact(question, middle, (0.0,))
        pulls.append((verdict.t - touched) / verdict.t_sigma)
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.6


@pytest.mark.parametrize(("speed", "touches"), [(1.0, True), (0.0, False)])
def test_a_ball_that_turns_back_at_a_cushion_met_it_and_one_that_runs_along_did_not(
    speed: float, touches: bool
) -> None:
    t = np.arange(0, 0.5, 1 / 60)
    into = np.where(t < 0.25, speed * (0.25 - t), 0.8 * speed * (t - 0.25))
    rng = np.random.default_rng(0)
    xy = np.stack([RADIUS + 2e-4 + into, 0.3 + 0.9 * t], axis=1) + rng.normal(0, 1e-3, (len(t), 2))
    ball = make_ball_window(BallSamples(t, xy, np.full(len(t), 1e-3)), 0.25, 0.0)
    verdict = evaluate_contact(PossibleContact((ball,), RADIUS, 1e-3, CushionLine(INWARD_NORMALS[0], RADIUS)), 0.25)
    assert (verdict.probability > 0.99) if touches else (verdict.probability < 0.5)
    if touches:
        assert verdict.t == pytest.approx(0.25, abs=3e-3)


def test_too_few_samples_are_refused() -> None:
    t = np.array([0.1, 0.2])
    ball = make_ball_window(BallSamples(t, np.array([[0.1, 0.1], [0.2, 0.1]]), np.full(2, 1e-3)), 0.15, 0.0)
    with pytest.raises(ValueError, match="at least"):
        evaluate_contact(PossibleContact((ball,), RADIUS, 1e-3, CushionLine(INWARD_NORMALS[0], RADIUS)), 0.15)
    with pytest.raises(ValueError, match="before"):
        make_ball_window(BallSamples(t, np.zeros((2, 2)), np.ones(2)), 0.05, 0.0)
