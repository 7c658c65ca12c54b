"""Windows of hold-out shots, also of recordings that leave out what does not move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import TABLE

from diagnosis.fitting.diagnosis_windows import split_into_segments
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, fit_effects
from diagnosis.fitting.prediction_windows import build_prediction_windows, select_predictable
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene

T = np.arange(200) / 50


def record_two_balls() -> Recording:
    """Record a ball that rolls all the time and one that rests."""
    positions = np.stack([np.stack([0.3 + 0.5 * T, 0.4 + 0.1 * T], axis=1), np.full((len(T), 2), 1.2)], axis=1)
    return Recording(0, np.arange(len(T)), T, ("cue", "red"), positions, np.full((len(T), 2), 1e-3), TABLE_PLANE)


def test_a_ball_that_is_recorded_only_while_it_moves_is_predicted_like_any_other() -> None:
    whole = record_two_balls()
    thinned = replace(whole, positions=whole.positions.copy())
    thinned.positions[1:-1, 1] = np.nan
    firsts = []
    for shot in (whole, thinned):
        problem = build_diagnosis_problem(build_billiards_scene(TABLE, (shot,)), WHITE_NOISE)
        windows = build_prediction_windows(problem, (shot,))
        firsts.append([float(one.segment.t[0]) for one in windows])
        assert all(one.segment.is_observed[: one.start_rows].any(axis=0).all() for one in windows)
    assert firsts[0] == firsts[1]
    assert len(firsts[0]) > 3


def test_errors_of_what_was_not_observed_have_no_effect() -> None:
    """A shot states none, a table may: a single missing sample must not end a prediction."""
    whole = record_two_balls()
    thinned = replace(whole, positions=whole.positions.copy())
    thinned.positions[50::20, 1] = np.nan
    problem = build_diagnosis_problem(build_billiards_scene(TABLE, (whole,)), WHITE_NOISE)
    like = fit_effects(problem, split_into_segments(problem, (whole,)))
    selected = []
    for sigma in (thinned.sigma, np.where(thinned.is_observed, thinned.sigma, np.nan)):
        windows = build_prediction_windows(problem, (replace(thinned, sigma=sigma),))
        predictable = select_predictable(problem, windows, like, np.random.default_rng(0))
        selected.append([one.segment.positions for one in predictable])
    assert selected[0]
    assert all(np.array_equal(one, other, equal_nan=True) for one, other in zip(*selected, strict=True))
