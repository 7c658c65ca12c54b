"""Windows of hold-out shots, also of recordings that leave out what does not move."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.simulated_shots import TABLE

from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem
from diagnosis.fitting.prediction_windows import build_prediction_windows
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
        problem = build_diagnosis_problem(build_billiards_scene(TABLE, (shot,)), 0.0)
        windows = build_prediction_windows(problem, (shot,))
        firsts.append([float(one.segment.t[0]) for one in windows])
        assert all(one.segment.is_observed[: one.start_rows].any(axis=0).all() for one in windows)
    assert firsts[0] == firsts[1]
    assert len(firsts[0]) > 3
