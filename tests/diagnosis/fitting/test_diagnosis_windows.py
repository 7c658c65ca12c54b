"""Shots are split only where every body has enough observations in each part, and not where frames are missing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.pucks import Pucks
from support.simulated_shots import TABLE

from diagnosis.fitting.diagnosis_windows import (
    MIN_ROWS,
    _find_split_rows,
    fit_adaptively,
    fit_initial_windows,
    thin_out_windows,
)
from diagnosis.fitting.hypothesis_fits import build_diagnosis_problem, linearize_fit
from diagnosis.fitting.shot_preparation import WHITE_NOISE
from models.core.recording import Recording
from models.core.tracks import TABLE_PLANE
from models.estimation.gap_scenes.billiards_scene import build_billiards_scene


def test_a_body_that_was_seen_at_the_beginning_alone_is_no_stumbling_block() -> None:
    t = np.arange(90) / 30
    rng = np.random.default_rng(4)
    places = np.stack([np.outer(t, [1.0, 0.2]) + 0.3 * np.sin(9 * t)[:, None], np.outer(t, [-0.5, 0.4])], axis=1)
    places += rng.normal(0, 1e-3, places.shape)
    places[10:, 1] = np.nan
    recording = Recording(0, np.arange(90), t, ("a", "b"), places, np.full((90, 2), 1e-3), TABLE_PLANE)
    fitted = fit_adaptively(build_diagnosis_problem(Pucks(), WHITE_NOISE), (recording,))
    assert all((segment.is_observed.sum(axis=0) >= 2).all() for segment in fitted.segments)


def test_a_misfit_of_many_sigmas_that_is_small_against_the_motion_splits_nothing() -> None:
    t, rng = np.arange(90) / 30, np.random.default_rng(5)
    places = np.stack([0.3 * t, 0.05 * np.sin(4 * t)], axis=1)[:, None] + rng.normal(0, 1e-4, (90, 1, 2))
    recording = Recording(0, np.arange(90), t, ("a",), places, np.full((90, 1), 1e-4), TABLE_PLANE)
    fitted = fit_initial_windows(build_diagnosis_problem(Pucks(), WHITE_NOISE), (recording,))
    assert fitted.lack_of_fit > 60**2  # far more than 30 standard deviations, far less than the motion of 9000
    assert len(fitted.segments) == 1


def record_rolling_ball(shot: int, lost_after: int, lost: int, fps: float = 60.0) -> Recording:
    """Record a ball for 2 s at 60 fps; from a row on, it is seen `lost` frames later than stated."""
    t, rng = np.arange(round(2 * fps)) / fps, np.random.default_rng(shot)
    late = t + np.where(np.arange(len(t)) >= lost_after, lost, 0) / fps
    heading = np.array([np.cos(shot), 0.5 * np.sin(shot)])
    xy = np.array([1.27, 0.635]) + np.outer(0.4 * late - 0.05 * late**2, heading) + rng.normal(0, 5e-4, (len(t), 2))
    return Recording(shot, np.arange(len(t)), t, ("cue",), xy[:, None], np.full((len(t), 1), 5e-4), TABLE_PLANE)


class SplitScene(Pucks):
    """A scene with windows of 24 rows in which something is observed."""

    def split_recording(self, recording: Recording) -> tuple[Recording, ...]:
        parts = (recording.select_rows(first, first + 24) for first in range(0, len(recording.t), 24))
        return tuple(part for part in parts if part.is_observed.any())


@pytest.mark.parametrize("lost_after", [29, 30, 47])
def test_missing_frames_show_also_where_a_window_would_begin_after_them(lost_after: int) -> None:
    """Windows of half a second began at the first frame after them, and no fit could tell."""
    shots = tuple(record_rolling_ball(shot, lost_after, 4) for shot in range(3))
    scene = build_billiards_scene(TABLE, shots)
    assert {round(60 * t) for _, t, _ in scene.jumps} == {lost_after}
    problem = build_diagnosis_problem(scene, WHITE_NOISE)
    fitted = fit_initial_windows(problem, shots)
    information = linearize_fit(problem, fitted).shot_information.information
    (k,) = np.flatnonzero(problem.mask(("dropped_frames",)))
    assert (4 * np.sqrt(information[:, k, k]) > 10).all()  # standard deviations of four lost frames


@pytest.mark.parametrize("fps", [10, 30, 60, 240])
def test_windows_reach_across_a_row_and_stay_long_enough(fps: int) -> None:
    segment = record_rolling_ball(0, 0, 0, fps)
    for row in range(1, len(segment.t)):
        firsts = _find_split_rows(segment, 0.5, (row,))
        assert firsts[0] == 0
        assert firsts[-1] == len(segment.t)
        assert np.diff(firsts).min() >= MIN_ROWS
        assert np.abs(firsts[1:-1] - row).min(initial=MIN_ROWS) >= MIN_ROWS
        assert len(firsts) >= len(_find_split_rows(segment, 0.5)) - 1


def test_long_recordings_keep_as_many_windows_as_decide() -> None:
    """They are spread over all recordings, each of which keeps one."""
    scene = SplitScene()
    shots = tuple(record_rolling_ball(shot, 0, 0, fps) for shot, fps in enumerate((240.0, 120.0, 12.0)))
    problem = replace(build_diagnosis_problem(Pucks(), WHITE_NOISE), scene=scene)
    kept = [scene.split_recording(one) for one in thin_out_windows(problem, shots, 12)]
    assert [len(scene.split_recording(one)) for one in shots] == [20, 10, 1]
    assert [len(one) for one in kept] == [8, 4, 1]
    assert kept[0][-1].t[-1] > 1.5
    assert thin_out_windows(problem, shots, 100) is shots
